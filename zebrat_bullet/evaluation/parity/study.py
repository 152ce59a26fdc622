"""The whole comparison of planar car and PyBullet, and its numbers."""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.parity.contacts import Contacts, compare_contacts
from zebrat_bullet.evaluation.parity.drives import DRIVERS, Comparison, DriveJob, compare, drive_in_bullet
from zebrat_bullet.evaluation.parity.episodes import Ending, EpisodeJob, drive_bullet_episodes, drive_planar_episodes
from zebrat_bullet.evaluation.workers import worker_pool
from zebrat_bullet.planar.simulation import require_planar
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import World, load_world

CHUNK = 5
SEEN_APART_M = 1e-4
"""Rays that differ by more are counted as different."""

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and how much there is."""


@dataclass(frozen=True, kw_only=True)
class ParityStudy:
    """What to compare.

    Attributes:
        worlds: names or files; each must have a centre line.
        agent: an unguided policy.
        drives: drives of 5 s by each of `DRIVERS` in each world.
        poses: poses near the walls of each world.
        episodes: episodes of the policy in each world, those of the judge.
        seed: of everything random.
        workers: processes; None takes one a core.
        task: the task driven; rays are cast with Embree, whose cloud is that of PyBullet's own rays.
    """

    worlds: tuple[str, ...]
    agent: str = "shipped"
    drives: int = 40
    poses: int = 200
    episodes: int = 70
    seed: int = 0
    workers: int | None = None
    task: TaskConfig

    def __post_init__(self) -> None:
        if not self.worlds:
            raise ConfigError("name at least one world")
        if min(self.drives, self.poses, self.episodes) < 1:
            raise ConfigError(f"drives, poses and episodes must be at least 1, got {self}")
        task = replace(self.task, lidar=replace(self.task.lidar, caster="embree"))
        object.__setattr__(self, "task", task)


@dataclass(frozen=True, kw_only=True)
class Parity:
    """How far planar cars and PyBullet's are apart.

    Attributes:
        study: what was compared.
        drives: by world, then by driver.
        contacts: by world.
        episodes: by world, each episode's endings in PyBullet and on the plane.
    """

    study: ParityStudy
    drives: Mapping[str, Mapping[str, Comparison]]
    contacts: Mapping[str, Contacts]
    episodes: Mapping[str, list[tuple[Ending, Ending]]]

    def row(self, world: str | None = None) -> dict[str, Any]:
        """Return the numbers of one world, or of all together, by name; None where there is nothing to count."""
        worlds = list(self.drives) if world is None else [world]
        drives = [drive for name in worlds for drive in self.drives[name].values()]
        return {
            "world": world or "all",
            **self._motion(drives),
            **_senses(drives),
            **_contact([self.contacts[name] for name in worlds]),
            **_endings([pair for name in worlds for pair in self.episodes[name]]),
        }

    def driver_row(self, driver: str) -> dict[str, Any]:
        """Return the numbers of one driver's drives in all worlds."""
        return {"driver": driver, **self._motion([self.drives[world][driver] for world in self.drives])}

    def apart_m(self, driver: str) -> NDArray[np.float64]:
        """Return the (D, S + 1) distances of one driver's drives in all worlds, as in `Comparison`."""
        return np.concatenate([self.drives[world][driver].apart_m for world in self.drives])

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers as plain values for JSON."""
        return {
            "all": self.row(),
            "worlds": {world: self.row(world) for world in self.drives},
            "drivers": {driver: self.driver_row(driver) for driver in DRIVERS},
        }

    def _motion(self, drives: list[Comparison]) -> dict[str, Any]:
        apart_mm = 1000.0 * np.concatenate([drive.apart_m for drive in drives])
        step_s = self.study.task.physics.control_step_s
        numbers: dict[str, Any] = {}
        for after_s in (1, 5):
            then = apart_mm[:, round(after_s / step_s)]
            then = then[np.isfinite(then)]
            numbers[f"drives_{after_s}s"] = len(then)
            numbers[f"apart_{after_s}s_median_mm"] = _percentile(then, 50)
            numbers[f"apart_{after_s}s_p95_mm"] = _percentile(then, 95)
        return numbers


def _percentile(values: NDArray[np.float64], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None


def _senses(drives: list[Comparison]) -> dict[str, Any]:
    level, rolling = (
        np.abs(np.concatenate([sight[np.isfinite(sight)] for sight in sights]))
        for sights in ([drive.sight_m for drive in drives], [drive.rolling_m for drive in drives])
    )
    return {
        "rays": len(level),
        "rays_differing": int((level > SEEN_APART_M).sum()),
        "rays_median_mm": 1000.0 * float(np.median(level)),
        "rays_worst_m": float(level.max()),
        "rolling_rays_median_mm": 1000.0 * float(np.median(rolling)),
        "rolling_rays_p95_mm": 1000.0 * float(np.percentile(rolling, 95)),
    }


def _contact(contacts: list[Contacts]) -> dict[str, Any]:
    exact, planar, bullet, close = (
        np.concatenate([getattr(one, name) for one in contacts]) for name in ("exact", "planar", "bullet", "close")
    )
    return {
        "poses": len(exact),
        "poses_touching": int(exact.sum()),
        "poses_close_call": int(close.sum()),
        "planar_wrong": int((planar != exact).sum()),
        "planar_wrong_clear": int(((planar != exact) & ~close).sum()),
        "bullet_wrong": int((bullet != exact).sum()),
        "bullet_wrong_clear": int(((bullet != exact) & ~close).sum()),
    }


def _endings(pairs: list[tuple[Ending, Ending]]) -> dict[str, Any]:
    alike = [bullet.outcome == planar.outcome for bullet, planar in pairs]
    apart_s = np.array(
        [abs(b.duration_s - p.duration_s) for (b, p), same in zip(pairs, alike, strict=True) if same], dtype=float
    )
    return {
        "episodes": len(pairs),
        "episodes_alike": sum(alike),
        "success_bullet": sum(bullet.outcome == "success" for bullet, _ in pairs),
        "success_planar": sum(planar.outcome == "success" for _, planar in pairs),
        "duration_apart_median_s": _percentile(apart_s, 50),
        "duration_apart_p95_s": _percentile(apart_s, 95),
    }


def measure(study: ParityStudy, on_progress: Progress = lambda doing, done, total: None) -> Parity:
    """Compare.

    Raises:
        ZebratError: the policy or a world cannot be loaded, or is not for planar cars; nothing was driven then.
    """
    policy = _unguided_policy(study)
    robot = load_robot(study.task.robot)
    worlds = {name: load_world(name, robot=robot) for name in study.worlds}
    for world in worlds.values():
        require_planar(world)
    drive_jobs = [
        DriveJob(world=name, driver=driver, agent=study.agent, n=study.drives, seed=study.seed, task=study.task)
        for name in worlds
        for driver in DRIVERS
    ]
    episode_jobs = [
        EpisodeJob(
            world=name,
            agent=study.agent,
            episodes=range(first, min(first + CHUNK, study.episodes)),
            seed=study.seed,
            task=study.task,
        )
        for name in worlds
        for first in range(0, study.episodes, CHUNK)
    ]
    with worker_pool(study.workers, len(drive_jobs) + len(episode_jobs)) as pool:
        driven = [pool.submit(drive_in_bullet, job) for job in drive_jobs]
        ended = [pool.submit(drive_bullet_episodes, job) for job in episode_jobs]
        _wait([*driven, *ended], on_progress)
    drives: dict[str, dict[str, Comparison]] = {name: {} for name in worlds}
    for job, future in zip(drive_jobs, driven, strict=True):
        drives[job.world][job.driver] = compare(future.result(), worlds[job.world], study.task)
    bullet: dict[str, list[Ending]] = {name: [] for name in worlds}
    for episode_job, chunk in zip(episode_jobs, ended, strict=True):
        bullet[episode_job.world] += chunk.result()
    contacts = {name: compare_contacts(world, study.task, study.poses, study.seed) for name, world in worlds.items()}
    return Parity(
        study=study, drives=drives, contacts=contacts, episodes=_pairs(bullet, policy, study, worlds, on_progress)
    )


def _unguided_policy(study: ParityStudy) -> PolicyAgent:
    agent = load_agent(study.agent, study.task)
    if not isinstance(agent, PolicyAgent) or agent.privileged:
        raise ConfigError(f"planar cars are driven by an unguided policy, {study.agent!r} is none; name another agent")
    return agent


def _wait(futures: list[Future], on_progress: Progress) -> None:
    for done, future in enumerate(as_completed(futures), start=1):
        future.result()
        on_progress("driving in PyBullet", done, len(futures))


def _pairs(
    bullet: dict[str, list[Ending]],
    policy: PolicyAgent,
    study: ParityStudy,
    worlds: dict[str, World],
    on_progress: Progress,
) -> dict[str, list[tuple[Ending, Ending]]]:
    """Drive the episodes on the plane, from where they began in PyBullet."""
    starts = np.array([[ending.start for ending in endings] for endings in bullet.values()])
    n_done, total = 0, starts.shape[0] * starts.shape[1]

    def on_end(n: int) -> None:
        nonlocal n_done
        n_done += n
        on_progress("driving on the plane", n_done, total)

    planar = drive_planar_episodes(policy, study.task, list(worlds.values()), starts, on_end)
    return {name: list(zip(bullet[name], planar[i], strict=True)) for i, name in enumerate(worlds)}
