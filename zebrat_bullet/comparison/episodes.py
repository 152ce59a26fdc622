"""Rows of the tables `episodes` and `paths` from what `zebrat evaluate` has written."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.endings import count_reversals, longest_way_back
from zebrat_bullet.evaluation.judge import record_path
from zebrat_bullet.evaluation.records import EpisodeRecord, load_record
from zebrat_bullet.evaluation.set_episodes import load_set_episodes
from zebrat_bullet.files import is_file, read_json

MOST_POINTS = 64
RECORDS = "records"


def record_rows(
    folder: Path, world: str, n_episodes: int, who: Mapping[str, Any]
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield a row of `episodes` and one of `paths` for each recorded episode of an agent in a world.

    Args:
        folder: that of the judgement.
        world: where.
        n_episodes: those that count, from the first; what a kill has left out is left out here too.
        who: the columns that all rows share.

    Raises:
        ZebratError: a record is damaged; the message names it.
    """
    for episode in range(n_episodes):
        path = record_path(folder / RECORDS, world, episode)
        if not is_file(path):
            continue
        record = load_record(path)
        which = {**who, "seed": record.seed, "episode": record.episode}
        yield which | _measured(record), which | _thinned(record)


def set_rows(folder: Path, who: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row of `episodes` for each episode of an agent on a held-out set.

    Args:
        folder: that of the judgement.
        who: the columns that all rows share.

    Raises:
        ZebratError: the file of the episodes is damaged; the message names it.
    """
    for path in sorted(folder.glob("episodes-*.npz")):
        made = load_set_episodes(path)
        for track, episode in np.ndindex(made.outcome.shape):
            yield {
                **who,
                "family": str(made.family[track]),
                "difficulty": float(made.difficulty[track]),
                "reversals": int(made.reversals[track]),
                "track_seed": int(made.track_seed[track]),
                "seed": made.seed,
                "episode": episode,
                "outcome": str(made.outcome[track, episode]),
                "duration_s": float(made.time_s[track, episode]),
                "n_reversals": int(made.n_reversals[track, episode]),
                "backed_m": round(float(made.backed_m[track, episode]), 4),
            }


def read_made_by(made_by: Path) -> dict[str, Any] | None:
    """Return what the outputs in the folder of a judgement depend on, as it says; None where nothing was driven.

    Raises:
        ZebratError: the file is damaged.
    """
    if not is_file(made_by):
        return None
    said = read_json(made_by, ZebratError)
    if not isinstance(said, dict) or not isinstance(said.get("agent"), str):
        raise ZebratError(f"{made_by}: does not say who drove; delete its folder, and judge again")
    return said


def _measured(record: EpisodeRecord) -> dict[str, Any]:
    (x0, y0, yaw0), (x1, y1, yaw1) = record.pose[0].tolist(), record.pose[-1].tolist()
    moved = np.diff(record.pose[:, :2], axis=0)
    return {
        "outcome": record.outcome,
        "duration_s": record.duration_s,
        "n_reversals": count_reversals(record.command[:, 0]),
        "min_gap_m": record.min_gap_m,
        "steering_effort_rad": float(np.abs(np.diff(record.command[:, 1])).sum()),
        "distance_m": float(np.hypot(moved[:, 0], moved[:, 1]).sum()),
        "backed_m": round(longest_way_back(record.pose), 4),
        **{"x0": x0, "y0": y0, "yaw0": yaw0, "x1": x1, "y1": y1, "yaw1": yaw1},
    }


def _thinned(record: EpisodeRecord) -> dict[str, Any]:
    n = len(record.pose)
    chosen = np.unique(np.linspace(0, n - 1, min(n, MOST_POINTS)).round().astype(int))
    x, y = record.pose[chosen, :2].T.round(2).tolist()  # centimetres make the table a fifth as large
    return {"x": x, "y": y}
