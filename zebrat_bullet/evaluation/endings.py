"""How an agent's episodes end in worlds held in memory, many at once: on planar cars, or in an engine."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.agents import Agent
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import ENGINES, TaskConfig
from zebrat_bullet.errors import ConfigError, PolicyError
from zebrat_bullet.evaluation.planar_policy import cars_for
from zebrat_bullet.evaluation.rollout import drive_episodes
from zebrat_bullet.evaluation.workers import worker_pool
from zebrat_bullet.geometry import driven_forward
from zebrat_bullet.planar.drive import N_STARTS
from zebrat_bullet.planar.trial import drive_out
from zebrat_bullet.task.episode import OUTCOMES, Outcome
from zebrat_bullet.world import World

SIMULATORS = ("planar", *ENGINES)
BACKED_M = 0.05
"""A car has backed up if it drove back so far in one go; a command alone need not move it."""


@dataclass(frozen=True, slots=True)
class Endings:
    """How E episodes in each of W worlds ended.

    Attributes:
        outcome: (W, E) int8, codes of `Outcome`.
        time_s: (W, E) float64, simulated time that each took.
        n_reversals: (W, E) int64, how often the commanded speed changed its sign.
        backed_m: (W, E) float64, the longest way in m that the car drove back in one go.
    """

    outcome: NDArray[np.int8]
    time_s: NDArray[np.float64]
    n_reversals: NDArray[np.int64]
    backed_m: NDArray[np.float64]

    @property
    def success(self) -> NDArray[np.bool_]:
        """Return (W, E) which episodes succeeded."""
        return self.outcome == Outcome.SUCCESS.code

    @property
    def backed_up(self) -> NDArray[np.bool_]:
        """Return (W, E) in which episodes the car drove back at least `BACKED_M` in one go, to 0.1 mm."""
        return self.backed_m.round(4) >= BACKED_M

    def causes(self) -> dict[str, int]:
        """Return the number of episodes by outcome."""
        return {str(each): int((self.outcome == each.code).sum()) for each in OUTCOMES}


def as_policy(agent: Agent, name: str) -> PolicyAgent:
    """Return an agent that can drive planar cars.

    Raises:
        PolicyError: it is no policy.
    """
    if not isinstance(agent, PolicyAgent):
        raise PolicyError(
            f"planar cars are driven by trained policies, {name!r} is none; drive it in PyBullet: "
            "--sim bullet with --set, or --worlds"
        )
    return agent


def planar_endings(
    policy: PolicyAgent,
    task: TaskConfig,
    worlds: Sequence[World],
    episodes: int,
    *,
    seed: int = 0,
    action_noise: float = 0.0,
    on_end: Callable[[int], None] = lambda n: None,
) -> Endings:
    """Drive a policy's episodes in all worlds at once, on planar cars.

    A world's start poses are a function of its name alone, the same for every policy.

    Args:
        policy: the driver.
        task: the task, which says where they begin; it shows what the policy observes.
        worlds: W worlds.
        episodes: E in each, at most `N_STARTS`.
        seed: of noise and dynamics, where they are drawn.
        action_noise: Gaussian noise on the commands, as a fraction of the limits.
        on_end: called with the number of episodes that have just ended.

    Raises:
        ConfigError: no worlds or episodes, too many of these, or the policy observes what this car does not.
    """
    if not worlds or not 1 <= episodes <= N_STARTS:
        raise ConfigError(f"name at least 1 world and 1 to {N_STARTS} episodes in each, got {len(worlds)}, {episodes}")
    drive = cars_for(policy, task, worlds, len(worlds) * episodes, seed)
    where = np.repeat(np.arange(len(worlds), dtype=np.int32), episodes)
    poses = drive.starts[where, np.tile(np.arange(episodes), len(worlds))]
    rng = np.random.default_rng(seed)

    def act(observations: NDArray[np.float32]) -> NDArray[np.float32]:
        actions = policy.action(observations)
        if action_noise == 0.0:
            return actions
        return actions + rng.normal(0.0, action_noise, actions.shape).astype(np.float32)

    trial = drive_out(drive, act, where, poses, on_end)
    time_s = trial.n_steps.astype(np.float64) * task.physics.control_step_s
    shape = (len(worlds), episodes)
    return Endings(
        trial.outcome.reshape(shape),
        time_s.reshape(shape),
        trial.n_reversals.reshape(shape),
        trial.backed_m.reshape(shape),
    )


def engine_endings(
    agent: str,
    task: TaskConfig,
    worlds: Sequence[World],
    episodes: int,
    *,
    seed: int = 0,
    action_noise: float = 0.0,
    supervised_m: float | None = None,
    workers: int | None = None,
) -> Iterator[tuple[int, Endings]]:
    """Drive an agent's episodes in each world in the task's engine; yield place and endings of each that is done.

    Args:
        agent: its name, policy file or run folder.
        task, worlds: what it drives in.
        episodes: in each world.
        seed: first part of every episode's seed; episode k of a world starts the same for every agent.
        action_noise: Gaussian noise on the commands, as a fraction of the limits.
        supervised_m: margin of the supervisor that the commands go through; None: there is none.
        workers: processes; None takes one a core.

    Raises:
        ConfigError: no worlds or episodes.
        ZebratError: the agent cannot be loaded.
    """
    if not worlds or episodes < 1:
        raise ConfigError(f"name at least 1 world and 1 episode in each, got {len(worlds)}, {episodes}")
    with worker_pool(workers, len(worlds)) as pool:
        jobs = {
            pool.submit(_drive_world, agent, task, world, seed, episodes, action_noise, supervised_m): i
            for i, world in enumerate(worlds)
        }
        for job in as_completed(jobs):
            yield jobs[job], job.result()


def in_order(found: Mapping[int, Endings]) -> Endings:
    """Return the endings of all worlds in one, by their places."""
    each = [found[i] for i in sorted(found)]
    parts = ([getattr(at, name) for at in each] for name in ("outcome", "time_s", "n_reversals", "backed_m"))
    return Endings(*(np.concatenate(part) for part in parts))


def _drive_world(
    agent: str,
    task: TaskConfig,
    world: World,
    seed: int,
    episodes: int,
    action_noise: float,
    supervised_m: float | None,
) -> Endings:
    records = list(drive_episodes(agent, task, world, seed, range(episodes), action_noise, supervised_m))
    outcome = np.array([[Outcome(record.outcome).code for record in records]], dtype=np.int8)
    time_s = np.array([[record.duration_s for record in records]])
    n_reversals = np.array([[count_reversals(record.command[:, 0]) for record in records]])
    return Endings(outcome, time_s, n_reversals, np.array([[longest_way_back(record.pose) for record in records]]))


def count_reversals(speeds_mps: NDArray[np.float64]) -> int:
    """Return how often (T,) commanded speeds change their sign, however briefly; standing still is no sign."""
    signs = np.sign(speeds_mps[speeds_mps != 0.0])
    return int((signs[1:] != signs[:-1]).sum())


def longest_way_back(poses: NDArray[np.float64]) -> float:
    """Return how far in m a car drove back in one go.

    Args:
        poses: (T, 3) x, y in m and yaw in rad, a control step apart.
    """
    reached = np.concatenate([[0.0], np.cumsum(driven_forward(poses[:-1], poses[1:]))])
    return float((np.maximum.accumulate(reached) - reached).max())
