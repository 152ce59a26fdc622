"""The episodes of a judgement on a held-out set on disk: how each ended, with the facts of its track."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.endings import Endings
from zebrat_bullet.evaluation.npz import load_npz, save_npz
from zebrat_bullet.evaluation.track_set import SetTrack
from zebrat_bullet.files import refusing
from zebrat_bullet.task.episode import OUTCOMES

SCHEMA = "zebrat-set-episodes-2"
_KINDS = {"family": "U", "track_seed": "i", "difficulty": "f", "reversals": "i"}
_ENDING_KINDS = {"outcome": "U", "time_s": "f", "n_reversals": "i", "backed_m": "f"}


@dataclass(frozen=True, kw_only=True)
class SetEpisodes:
    """E episodes of one agent in each of W tracks.

    Attributes:
        agent, set, sim: who drove where, as `zebrat evaluate` was told.
        seed: of the episodes in an engine, and of the draw of the tracks.
        family, track_seed, difficulty, reversals: (W,) of the tracks, as `SetTrack` has them.
        outcome: (W, E) names of outcomes.
        time_s: (W, E) simulated time.
        n_reversals: (W, E) how often the commanded speed changed its sign.
        backed_m: (W, E) the longest way in m that the car drove back in one go.
    """

    agent: str
    set: str
    sim: str
    seed: int
    family: NDArray[np.str_]
    track_seed: NDArray[np.int64]
    difficulty: NDArray[np.float64]
    reversals: NDArray[np.int64]
    outcome: NDArray[np.str_]
    time_s: NDArray[np.float64]
    n_reversals: NDArray[np.int64]
    backed_m: NDArray[np.float64]


def set_episodes(
    agent: str, set_name: str, sim: str, seed: int, tracks: Sequence[SetTrack], endings: Endings
) -> SetEpisodes:
    """Join how an agent's episodes ended with the tracks that they were driven in."""
    names = {each.code: str(each) for each in OUTCOMES}
    return SetEpisodes(
        agent=agent,
        set=set_name,
        sim=sim,
        seed=seed,
        family=np.array([track.family for track in tracks]),
        track_seed=np.array([track.seed for track in tracks]),
        difficulty=np.array([track.difficulty for track in tracks]),
        reversals=np.array([track.reversals for track in tracks]),
        outcome=np.array([[names[int(code)] for code in row] for row in endings.outcome]),
        time_s=endings.time_s,
        n_reversals=endings.n_reversals,
        backed_m=endings.backed_m,
    )


def save_set_episodes(episodes: SetEpisodes, path: Path) -> None:
    """Write them as .npz, whole or not at all."""
    save_npz(path, SCHEMA, vars(episodes))


def load_set_episodes(path: Path) -> SetEpisodes:
    """Read them.

    Raises:
        ZebratError: the file is missing, damaged or of another schema, or its arrays do not fit together.
    """
    with refusing(path, ZebratError, "holds no episodes of a set", "name a file that `zebrat evaluate --set` wrote"):
        made = SetEpisodes(**load_npz(path, SCHEMA))
        n_tracks, n_episodes = made.outcome.shape
        expected = dict.fromkeys(_KINDS, (n_tracks,)) | dict.fromkeys(_ENDING_KINDS, (n_tracks, n_episodes))
        for name, kind in (_KINDS | _ENDING_KINDS).items():
            array = getattr(made, name)
            if array.shape != expected[name] or array.dtype.kind != kind:
                raise ValueError(f"{name} is {array.dtype} {array.shape}, not {expected[name]}")
        return made
