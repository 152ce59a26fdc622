"""The files that are written: whole or not at all, and known to be writable before the work that they are to hold."""

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a file's name until it is whole, and give it its own at the end; what fails leaves the folder as it was.

    Args:
        path: the file; its folder is made.

    Yields:
        A hidden name in the same folder that no other file has, for the block to write.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = _part_of(path)
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def require_writable(path: Path, *, folder: bool = False) -> None:
    """Raise unless a file of this name can be written, by writing an empty one beside it; missing folders are made.

    Args:
        path: the file.
        folder: it is a folder, into which files are to be written.

    Raises:
        OSError: it cannot; its `filename` is the path, or the folder above it that is none.
    """
    if not folder and path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    (path if folder else path.parent).mkdir(parents=True, exist_ok=True)
    part = _part_of(path / "file" if folder else path)
    try:
        part.open("xb").close()
        part.unlink()
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def _part_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
