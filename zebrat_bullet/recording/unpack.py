"""Unpacking that stops: rosbags unpacks whatever a file holds, and a few kB can hold many GB."""

import bz2
from collections.abc import Callable
from typing import TypeVar

import lz4.frame
import zstandard
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import storage_mcap

from zebrat_bullet.files import MB

MOST_BYTES = 512 * MB
"""Of a piece of a file, unpacked."""
_PIECE_BYTES = MB
_Bytes = TypeVar("_Bytes", bytes, bytearray)


def unzstd(data: bytes, most_bytes: int = MOST_BYTES) -> bytes:
    """Unpack zstd.

    Raises:
        ValueError: it holds more than so many bytes.
        zstandard.ZstdError: it is damaged.
    """
    unpacked = bytearray()
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as stream:
        # Piece by piece: a reader makes room for all that it may read before it reads.
        while len(unpacked) <= most_bytes and (piece := stream.read(_PIECE_BYTES)):
            unpacked += piece
    return bytes(_within(unpacked, most_bytes))


def _unlz4(data: bytes, most_bytes: int = MOST_BYTES) -> bytes:
    return _within(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most_bytes + 1), most_bytes)


def _unbz2(data: bytes) -> bytes:
    return _within(bz2.BZ2Decompressor().decompress(data, MOST_BYTES + 1), MOST_BYTES)


def _within(unpacked: _Bytes, most_bytes: int) -> _Bytes:
    if len(unpacked) > most_bytes:
        raise ValueError(f"a piece unpacks to more than the {most_bytes} bytes that it may")
    return unpacked


def _as_declared(unpack: Callable[[bytes, int], bytes]) -> Callable[[bytes, int], bytes]:
    """Return an unpacking up to what the piece itself declares, which rosbags passes along."""
    return lambda data, declared: unpack(data, min(declared, MOST_BYTES))


def bound_unpacking() -> None:
    """Give rosbags decompressors with a bound."""
    storage_mcap.DECOMPRESSORS.update(zstd=_as_declared(unzstd), lz4=_as_declared(_unlz4))
    rosbag1_reader.decompressors.update(bz2=_unbz2, lz4=_unlz4)
