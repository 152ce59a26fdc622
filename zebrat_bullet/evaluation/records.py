"""The record of an episode: enough to replay it exactly, to judge it and to draw it. A numpy .npz without pickles."""

import math
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_json
from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.npz import load_npz, save_npz
from zebrat_bullet.files import refusing

SCHEMA = "zebrat-episode-1"
_TEXTS = ("world", "agent", "caster", "outcome", "task")
_LISTS = ("term_names", "privileged", "reasons")
_MOST_NUMBER = 2**63
# T steps, S = T + 1 states, R rays, B beams, n terms, K refused commands.
_SHAPES: dict[str, tuple[str | int, ...]] = {
    **{"time_s": ("S",), "pose": ("S", 3), "speed_mps": ("S",), "steering_rad": ("S",)},
    **{"knuckle_rad": ("S", 2), "wheel_rad": ("S", 4), "command": ("T", 2), "terms": ("T", "n"), "reward": ("T",)},
    **{"obs_m": ("S", "R"), "range_m": ("R",), "scan_m": ("S", "B"), "refused": ("K", 4)},
}


@dataclass(frozen=True, kw_only=True)
class EpisodeRecord:
    """One episode of T control steps; row t of a (T+1, ...) array is the state before command t.

    Attributes:
        world, agent: names; `world` can be loaded again (a shipped name or the file's path).
        seed, episode: the episode is a pure function of these two, the world and the agent.
        caster: ray caster used.
        outcome: "success", "collision", "false_exit", "timeout" or "stall".
        unseen_contact: the collision was with a low obstacle in the lidar's blind zone.
        task: the TaskConfig as JSON.
        time_s: (T+1,) s.
        pose: (T+1, 3) x m, y m, yaw rad of the body centre, world frame.
        speed_mps: (T+1,) measured forward speed.
        steering_rad: (T+1,) measured virtual centre-wheel angle.
        knuckle_rad: (T+1, 2) left and right hinge.
        wheel_rad: (T+1, 4) rolling angle of rear-left, rear-right, front-left, front-right.
        command: (T, 2) speed m/s and steering rad.
        terms: (T, n) weighted reward terms, columns as in `term_names`.
        reward: (T,).
        obs_m: (T+1, R) V_obs; `range_m`: (R,) V_range.
        scan_m: (T+1, B) flattened scan, float32.
        term_names: names of the reward terms.
        privileged: what the agent was given beyond the lidar, sorted.
        supervised_m: margin of the supervisor, None where there was none.
        refused: (K, 4) the commands that it did not let through: the control step, speed, steering, and 1 where the
            car, had it obeyed for this control step and then braked, would have touched a wall, else 0. A command that
            was not finite is all 0.
        reasons: (K,) what the supervisor said of each.
    """

    world: str
    agent: str
    seed: int
    episode: int
    caster: str
    outcome: str
    unseen_contact: bool
    task: str
    term_names: tuple[str, ...]
    time_s: NDArray[np.float64]
    pose: NDArray[np.float64]
    speed_mps: NDArray[np.float64]
    steering_rad: NDArray[np.float64]
    knuckle_rad: NDArray[np.float64]
    wheel_rad: NDArray[np.float64]
    command: NDArray[np.float64]
    terms: NDArray[np.float64]
    reward: NDArray[np.float64]
    obs_m: NDArray[np.float32]
    range_m: NDArray[np.float32]
    scan_m: NDArray[np.float32]
    privileged: tuple[str, ...] = ()
    supervised_m: float | None = None
    refused: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4)))
    reasons: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """Simulated length of the episode."""
        return float(self.time_s[-1])

    @property
    def engine(self) -> str:
        """The engine that simulated it."""
        return from_json(TaskConfig, self.task).physics.engine

    @property
    def min_gap_m(self) -> float:
        """Smallest V_obs - V_range of the episode."""
        return float((self.obs_m - self.range_m).min())


def save_record(record: EpisodeRecord, path: Path) -> None:
    """Write a record as .npz, whole or not at all."""
    save_npz(path, SCHEMA, {each.name: getattr(record, each.name) for each in fields(record)})


def load_record(path: Path) -> EpisodeRecord:
    """Read a record; nothing in the file can run code.

    Raises:
        ZebratError: the file is missing, damaged or of another schema, or its arrays do not fit together.
    """
    with refusing(path, ZebratError, "is not an episode record", "name an .npz that `zebrat evaluate` wrote"):
        values = load_npz(path, SCHEMA)
        record = EpisodeRecord(**values | {name: tuple(values.get(name, ())) for name in _LISTS})
        _check(record)
        return record


def _check(record: EpisodeRecord) -> None:
    texts = (*record.term_names, *record.privileged, *record.reasons, *(getattr(record, name) for name in _TEXTS))
    if not all(isinstance(text, str) for text in texts) or not isinstance(record.unseen_contact, bool):
        raise ValueError("a text is none")
    if not all(isinstance(n, int) and 0 <= n < _MOST_NUMBER for n in (record.seed, record.episode)):
        raise ValueError(f"seed and episode are whole numbers from 0 up, got {record.seed!r} and {record.episode!r}")
    n_steps, n_rays, n_beams = len(record.command), len(record.range_m), record.scan_m.shape[-1]
    sizes: dict[str | int, int] = {
        "T": n_steps,
        "S": n_steps + 1,
        "R": n_rays,
        "B": n_beams,
        "n": len(record.term_names),
        "K": len(record.reasons),
    }
    for name, dimensions in _SHAPES.items():
        array, shape = getattr(record, name), tuple(sizes.get(d, d) for d in dimensions)
        if array.shape != shape or array.dtype.kind != "f" or not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite numbers of shape {shape}, got {array.dtype} {array.shape}")
    margin_m, steps = record.supervised_m, record.refused[:, 0]
    if margin_m is not None and not (isinstance(margin_m, float) and 0.0 <= margin_m < math.inf):
        raise ValueError(f"supervised_m is a margin of at least 0 m, got {margin_m!r}")
    if len(steps) and not (np.diff(steps, prepend=-1.0).min() > 0 and steps[-1] < n_steps):
        raise ValueError(f"refused must name steps of 0 to {n_steps - 1}, each once and in order")
    if n_steps == 0:
        raise ValueError("an episode without a step")
