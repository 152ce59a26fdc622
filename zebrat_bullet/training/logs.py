"""The run folder's tables: one CSV row an episode and one an evaluation; cut back when a run resumes."""

import csv
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

EPISODE_COLUMNS = (
    "episode", "total_steps", "wall_s", "env", "world", "outcome", "return", "steps", "epsilon",
)  # fmt: skip
EVALUATION_COLUMNS = ("episode", "total_steps", "wall_s", "success", "collision", "fail", "time_s", "best")


def rank(evaluation: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return the order in which policies are better, given their evaluations: success, then collisions, then time."""
    success, collision, time_s = (evaluation[name] for name in ("success", "collision", "time_s"))
    return float(success), -float(collision), -float(time_s or math.inf)


def read_rows(path: Path, last_bytes: int | None = None) -> list[dict[str, str]]:
    """Return the whole rows of a table as strings by column, none if it is not there; another may be writing to it.

    Args:
        path: the table.
        last_bytes: read only the rows within so many bytes of its end; None for all.
    """
    try:
        with path.open("rb") as file:
            header = file.readline()
            if last_bytes is not None and path.stat().st_size - last_bytes > len(header):
                file.seek(-last_bytes, os.SEEK_END)
                file.readline()  # begins within a row
            whole = [line.decode() for line in (header, *file) if line.endswith(b"\n")]
    except FileNotFoundError:
        return []
    return [row for row in csv.DictReader(whole) if None not in row and None not in row.values()]


class CsvLog:
    """A CSV file that grows by a row at a time and survives a kill.

    Args:
        path: the file; a header is written when it is new.
        columns: names of the columns.
    """

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        self._path, self._columns = path, columns
        if not path.exists():
            self._write(path, "w", [])

    def append(self, row: dict[str, Any]) -> None:
        """Add a row; a kill of this process does not lose it."""
        self._write(self._path, "a", [row])

    def rows(self) -> list[dict[str, str]]:
        """Return every row as strings by column."""
        return read_rows(self._path)

    def cut_after(self, episode: int) -> None:
        """Drop the rows of episodes after `episode`, which a resumed run drives again."""
        kept = [row for row in self.rows() if int(row["episode"]) <= episode]
        part = self._path.with_suffix(".part")
        self._write(part, "w", kept)
        part.replace(self._path)

    def _write(self, path: Path, mode: str, rows: list[dict[str, Any]]) -> None:
        with path.open(mode, newline="") as file:
            writer = csv.DictWriter(file, self._columns)
            if mode == "w":
                writer.writeheader()
            writer.writerows(rows)
