"""How an agent does on many tracks of a kind: success over all of them, and over the worst tenth."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import TaskConfig, with_engine
from zebrat_bullet.evaluation.endings import Endings, as_policy, engine_endings, in_order, planar_endings
from zebrat_bullet.evaluation.metrics import tracks_interval
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import generate_tracks


@dataclass(frozen=True, kw_only=True)
class TracksScore:
    """How an agent did on many tracks.

    Attributes:
        tracks, starts: so many tracks, so many episodes in each.
        success, success_ci: share of the episodes, and its 95 % interval over all such tracks (`tracks_interval`).
        worst_tenth, worst_tenth_ci: success on the tenth of the tracks where it is lowest, and its 95 % percentile
            bootstrap interval over tracks.
        causes: episodes by outcome.
        time_s: mean simulated time of the successes; None when nothing succeeded.
        by_track: (tracks,) successes of each.
    """

    tracks: int
    starts: int
    success: float
    success_ci: tuple[float, float]
    worst_tenth: float
    worst_tenth_ci: tuple[float, float]
    causes: dict[str, int]
    time_s: float | None
    by_track: tuple[int, ...]

    def as_dict(self) -> dict[str, object]:
        """Return the score as plain values for JSON."""
        return asdict(self)


def judge_generated(
    agent: str,
    seeds: Sequence[int],
    starts: int,
    task: TaskConfig,
    *,
    sim: str = "planar",
    seed: int = 0,
    action_noise: float = 0.0,
    workers: int = 1,
) -> TracksScore:
    """Drive an agent out of one generated track for each seed, several times.

    Args:
        agent: its name, file or run folder.
        seeds: of the tracks.
        starts: episodes in each track.
        task: the task.
        sim: "planar" for policies, the engines "bullet" and "mujoco" for any agent.
        seed: of the episodes in an engine, of noise and dynamics.
        action_noise: Gaussian noise on the commands, as a fraction of the limits.
        workers: processes that draw the tracks, and drive in an engine.

    Raises:
        ConfigError: there are no seeds or starts, or the policy observes what this car does not.
        PolicyError: the agent is no policy and is to drive planar cars.
    """
    loaded = load_agent(agent, task)
    policy = as_policy(loaded, agent) if sim == "planar" else None
    worlds = list(generate_tracks(seeds, robot=load_robot(task.robot), workers=workers))
    if policy is not None:
        return tracks_score(planar_endings(policy, task, worlds, starts, seed=seed, action_noise=action_noise))
    task = with_engine(task, sim)
    driven = engine_endings(agent, task, worlds, starts, seed=seed, action_noise=action_noise, workers=workers)
    return tracks_score(in_order(dict(driven)))


def tracks_score(endings: Endings) -> TracksScore:
    """Summarise the episodes in some tracks."""
    success = endings.success
    tracks, starts = success.shape
    by_track = success.sum(axis=1)
    return TracksScore(
        tracks=tracks,
        starts=starts,
        success=float(success.mean()),
        success_ci=tracks_interval(by_track, starts),
        worst_tenth=float(_worst_tenth(by_track) / starts),
        worst_tenth_ci=_worst_tenth_interval(by_track, starts),
        causes=endings.causes(),
        time_s=float(endings.time_s[success].mean()) if success.any() else None,
        by_track=tuple(by_track.tolist()),
    )


def _worst_tenth(by_track: NDArray, axis: int = -1) -> NDArray:
    n = max(by_track.shape[axis] // 10, 1)
    return np.sort(by_track, axis=axis).take(range(n), axis=axis).mean(axis=axis)


def _worst_tenth_interval(by_track: NDArray, starts: int) -> tuple[float, float]:
    if len(by_track) < 2:
        return 0.0, 1.0
    found = bootstrap((by_track,), _worst_tenth, n_resamples=2000, method="percentile", rng=0).confidence_interval
    return float(found.low) / starts, float(found.high) / starts
