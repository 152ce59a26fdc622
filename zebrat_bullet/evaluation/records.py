"""The record of an episode: enough to replay it exactly, to judge it and to draw it. A numpy .npz without pickles."""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.npz import DAMAGE, load_npz, save_npz

SCHEMA = "zebrat-episode-1"


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

    @property
    def duration_s(self) -> float:
        """Simulated length of the episode."""
        return float(self.time_s[-1])

    @property
    def min_gap_m(self) -> float:
        """Smallest V_obs - V_range of the episode."""
        return float((self.obs_m - self.range_m).min())


def save_record(record: EpisodeRecord, path: Path) -> None:
    """Write a record as .npz, whole or not at all."""
    save_npz(path, SCHEMA, {field.name: getattr(record, field.name) for field in fields(record)})


def load_record(path: Path) -> EpisodeRecord:
    """Read a record; nothing in the file can run code.

    Raises:
        ZebratError: the file is missing, damaged or of another schema.
    """
    try:
        values = load_npz(path, SCHEMA)
        return EpisodeRecord(**values | {name: tuple(values.get(name, ())) for name in ("term_names", "privileged")})
    except DAMAGE as error:
        raise ZebratError(
            f"{path} is not an episode record ({error}); name an .npz that `zebrat evaluate` wrote"
        ) from error
