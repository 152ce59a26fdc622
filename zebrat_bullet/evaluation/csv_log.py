"""Tables that grow by a row at a time and survive a kill."""

import csv
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.files import MB, is_file, refusing, require_file
from zebrat_bullet.outputs import written_whole

_MOST_BYTES = 1000 * MB
Row = TypeVar("Row")


def read_rows(path: Path, last_bytes: int | None = None) -> list[dict[str, str]]:
    """Return the whole rows of a table as strings by column, none if it is not there; another may be writing to it.

    Args:
        path: the table.
        last_bytes: read only the rows within so many bytes of its end; None for all.
    """
    if not is_file(path):
        return []
    require_file(path, ZebratError, _MOST_BYTES)
    refuses = refusing(path, ZebratError, "is not a table of a run", "restore it, or move its folder away")
    with refuses, path.open("rb") as file:
        header = file.readline()
        if last_bytes is not None and path.stat().st_size - last_bytes > len(header):
            file.seek(-last_bytes, os.SEEK_END)
            file.readline()  # begins within a row
        whole = [line.decode() for line in (header, *file) if line.endswith(b"\n")]
        return [row for row in csv.DictReader(whole) if None not in row and None not in row.values()]


def read_as(kind: type[Row], path: Path) -> Iterator[Row]:
    """Yield the whole rows of a table as instances of a dataclass whose fields are its columns.

    Raises:
        ZebratError: one is of another kind.
    """
    for row in read_rows(path):
        what = f"holds a row of another kind, {','.join(row.values())}"
        with refusing(path, ZebratError, what, "restore it, or move its folder away"):
            made = kind(**{field.name: field.type(row[field.name]) for field in fields(kind)})  # type: ignore
        yield made


class CsvLog:
    """A CSV file that grows by a row at a time and survives a kill.

    Args:
        path: the file; a header is written when it is new.
        columns: names of the columns.
    """

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        self._path, self._columns, self._mended = path, columns, False
        if not path.exists():
            self._write(path, "w", [])

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row; a kill of this process does not lose it, and what a kill has left of a row makes way for it."""
        if not self._mended:
            self._mend()
        self._write(self._path, "a", [row])

    def rows(self) -> list[dict[str, str]]:
        """Return every row as strings by column."""
        return read_rows(self._path)

    def cut_after(self, episode: int) -> None:
        """Drop the rows of episodes after `episode`, which a resumed run drives again."""
        with refusing(self._path, ZebratError, "is not the log of this run", "restore it, or begin the run anew"):
            kept = [row for row in self.rows() if int(row["episode"]) <= episode]
        with written_whole(self._path) as part:
            self._write(part, "w", kept)

    def _mend(self) -> None:
        with self._path.open("r+b") as file:
            whole = file.truncate(file.read().rfind(b"\n") + 1)
        if whole == 0:
            self._write(self._path, "w", [])
        self._mended = True

    def _write(self, path: Path, mode: str, rows: Sequence[Mapping[str, Any]]) -> None:
        with path.open(mode, newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self._columns)
            if mode == "w":
                writer.writeheader()
            writer.writerows(rows)
