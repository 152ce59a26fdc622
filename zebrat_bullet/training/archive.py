"""A folder of results that is kept as one zip file, read as if it were the folder."""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from zebrat_bullet.errors import ConfigError


@contextmanager
def as_folder(path: Path) -> Iterator[Path]:
    """Yield a folder as it is; a zip file unpacked into a temporary folder, for as long as this lasts.

    Raises:
        ConfigError: a file is no zip archive, or one of its members would lie outside the folder.
    """
    if not path.is_file():
        yield path
        return
    with TemporaryDirectory(prefix="zebrat-") as folder:
        _unpack(path, folder)
        yield Path(folder)


def _unpack(path: Path, folder: str) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            for name in map(PurePosixPath, archive.namelist()):
                if name.is_absolute() or ".." in name.parts:
                    raise ConfigError(
                        f"{path} holds {str(name)!r}, which lies outside the archive; nothing was unpacked"
                    )
            archive.extractall(folder)
    except zipfile.BadZipFile as error:
        raise ConfigError(f"{path} is neither a folder nor a zip archive of one: {error}") from error
