"""How the episodes of a policy end in PyBullet and with planar cars that begin at the same poses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.evaluation.planar_policy import cars_for
from zebrat_bullet.evaluation.rollout import drive_episodes
from zebrat_bullet.planar.trial import drive_out
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.world import World, load_world


@dataclass(frozen=True, kw_only=True)
class EpisodeJob:
    """Some episodes of a policy in one world; start pose and chance of each as the judge's."""

    world: str
    agent: str
    episodes: range
    seed: int
    task: TaskConfig


@dataclass(frozen=True, kw_only=True)
class Ending:
    """How one episode went.

    Attributes:
        outcome: a value of `Outcome`.
        duration_s: simulated time.
        start: x, y in m and yaw in rad, world frame.
    """

    outcome: str
    duration_s: float
    start: tuple[float, ...]


def drive_bullet_episodes(job: EpisodeJob) -> list[Ending]:
    """Drive a job in PyBullet."""
    world = load_world(job.world, robot=load_robot(job.task.robot))
    return [
        Ending(outcome=record.outcome, duration_s=record.duration_s, start=tuple(record.pose[0].tolist()))
        for record in drive_episodes(job.agent, job.task, world, job.seed, job.episodes)
    ]


def drive_planar_episodes(
    policy: PolicyAgent,
    task: TaskConfig,
    worlds: Sequence[World],
    starts: NDArray[np.float64],
    on_end: Callable[[int], None] = lambda n: None,
) -> list[list[Ending]]:
    """Drive an episode from each of (W, E, 3) start poses, all at once; return E endings a world.

    Args:
        policy: who drives.
        task: the task, whose observation gives way to the policy's.
        worlds: W worlds.
        starts: x, y in m and yaw in rad, world frame.
        on_end: called with the number of episodes that have just ended.

    Raises:
        ConfigError: the policy observes what this car does not.
    """
    n_worlds, n_episodes = starts.shape[:2]
    drive = cars_for(policy, task, worlds, n_worlds * n_episodes)
    where = np.repeat(np.arange(n_worlds, dtype=np.int32), n_episodes)
    trial = drive_out(drive, policy.action, where, starts.reshape(-1, 3), on_end)
    durations = trial.n_steps * task.physics.control_step_s
    rows = starts.reshape(-1, 3).tolist()
    endings = [
        Ending(outcome=str(Outcome.of(int(code))), duration_s=float(duration), start=tuple(start))
        for code, duration, start in zip(trial.outcome, durations, rows, strict=True)
    ]
    return [endings[i : i + n_episodes] for i in range(0, len(endings), n_episodes)]
