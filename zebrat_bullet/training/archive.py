"""A folder of results that is kept as one zip file, read as if it were the folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import MB, is_file, open_zip

MOST_BYTES = 2000 * MB
"""What an archive may unpack to."""


@contextmanager
def as_folder(path: Path) -> Iterator[Path]:
    """Yield a folder as it is; a zip file unpacked into a temporary folder, for as long as this lasts.

    Raises:
        ConfigError: a file is no zip archive, or one of its members would lie outside the folder.
    """
    if not is_file(path):
        yield path
        return
    with TemporaryDirectory(prefix="zebrat-") as folder:
        with open_zip(path, ConfigError, MOST_BYTES) as archive:
            archive.extractall(folder)
        yield Path(folder)
