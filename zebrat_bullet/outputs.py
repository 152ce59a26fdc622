"""The files that are written: whole or not at all, and known to be writable before the work that they are to hold."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_MOST_BYTES = 240
"""Of a file's name in that of its unfinished one: file systems take 255."""


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a file's name until it is whole, and give it its own at the end; what fails leaves the folder as it was.

    What a kill leaves of it, the next to write the file takes away.

    Args:
        path: the file; its folder is made.

    Yields:
        A hidden name in the same folder, of this file alone, for the block to write.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = _part_of(path)
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def require_writable(path: Path, *, folder: bool = False) -> None:
    """Raise unless a file of this name can be written, by writing an empty one beside it; nothing stays.

    Args:
        path: the file.
        folder: it is a folder, into which files are to be written.

    Raises:
        OSError: it cannot; its `filename` is the path, or the folder above it that is none.
    """
    if not folder and path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    inside = path if folder else path.parent
    missing = [at for at in (inside, *inside.parents) if not at.exists()]
    inside.mkdir(parents=True, exist_ok=True)
    part = _part_of(path / "file" if folder else path)
    try:
        part.open("wb").close()
        part.unlink()
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        for made in missing:
            with suppress(OSError):  # another has put something there
                made.rmdir()


def _part_of(path: Path) -> Path:
    return path.with_name(f".{os.fsdecode(os.fsencode(path.name)[:_MOST_BYTES])}.part")
