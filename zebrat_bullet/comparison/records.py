"""Judged episodes that are kept as tables: what is in them is not driven again."""

import hashlib
import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from zebrat_bullet.comparison.tables import COLUMNS, read_tables

_DIGITS = 16
_PATH_OF = tuple(name for name, kind in COLUMNS["paths"].items() if kind != "float32s")


def digest(made_by: Mapping[str, Any]) -> str:
    """Return the column `made_by` of what a judgement's outputs depend on: how the SHA-256 of its JSON begins."""
    return hashlib.sha256(json.dumps(made_by, sort_keys=True).encode()).hexdigest()[:_DIGITS]


@dataclass(frozen=True, slots=True)
class Records:
    """Rows of the tables `episodes` and `paths`.

    Attributes:
        episodes: by `made_by` and place.
        paths: by what tells an episode from all others.
    """

    episodes: Mapping[tuple[str, str], list[dict[str, Any]]]
    paths: Mapping[tuple[Any, ...], dict[str, Any]]

    def rows(
        self, made_by: str, place: str, n_episodes: int, who: dict[str, Any]
    ) -> Iterator[tuple[dict[str, Any], dict[str, Any] | None]]:
        """Yield a row of `episodes` and, in a world, one of `paths` for each kept episode of a judgement.

        Args:
            made_by: its digest.
            place: where.
            n_episodes: those that count, in the world or in each track, from the first.
            who: the columns that all rows share, as they are called now.
        """
        for row in self.episodes.get((made_by, place), ()):
            if row["episode"] < n_episodes:
                path = self.paths.get(tuple(row[name] for name in _PATH_OF))
                yield row | who, None if path is None else path | {name: (row | who)[name] for name in _PATH_OF}


@cache
def read_records(folder: Path) -> Records:
    """Read the judged episodes in a folder of tables.

    Raises:
        ConfigError: it lacks a table, one is damaged, or pyarrow is not installed.
    """
    tables = read_tables(folder, ("episodes", "paths"))
    episodes: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for row in tables["episodes"].to_pylist():
        episodes[row["made_by"], row["place"]].append(row)
    paths = {tuple(row[name] for name in _PATH_OF): row for row in tables["paths"].to_pylist()}
    return Records(episodes=dict(episodes), paths=paths)
