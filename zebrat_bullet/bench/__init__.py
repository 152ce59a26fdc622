"""Times the full environment step beside the bare cost of rays and physics, and how long an agent thinks."""

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import numpy as np
import pybullet

from zebrat_bullet.agents import Agent, load_agent
from zebrat_bullet.config import LidarConfig, PhysicsConfig, TaskConfig
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command, Reading
from zebrat_bullet.world import load_world

WARMUP_STEPS = 50


def run_bench(
    world: str,
    n_steps: int,
    seed: int,
    rate_hz: float | None = None,
    bearings: str = "all",
    robot: str = "zebrat",
) -> dict[str, dict[str, float]]:
    """Return, for each ray caster, medians over interleaved control steps of a car that steers at random.

    Args:
        world: where it drives.
        n_steps: control steps timed, a third of the number driven.
        seed: of start and steering.
        rate_hz: physics rate; None for the task's.
        bearings: what a step casts, as `LidarConfig.bearings`.
        robot: the car, a name or a file.

    Returns:
        For "embree" and "bullet": `steps_per_s` and `rtf` (simulated seconds a second) of the full step; `overhead`,
        full step / (bare ray cast + bare physics); and the split in ms: full, physics, rays, flatten, rest, beside
        bare_rays (the caster's own call) and bare_physics (`stepSimulation` alone).
    """
    if n_steps < 1:
        raise ConfigError(f"steps must be at least 1, got {n_steps}")
    physics = PhysicsConfig() if rate_hz is None else PhysicsConfig(rate_hz=rate_hz)
    return {
        caster: _bench(
            world,
            n_steps,
            seed,
            TaskConfig(robot=robot, physics=physics, lidar=LidarConfig(caster=caster, bearings=bearings)),
        )
        for caster in ("embree", "bullet")
    }


def bench_agent(name: str, world: str, seed: int, robot: str = "zebrat") -> dict[str, float]:
    """Return how long an agent thinks in one episode, embree caster: processor time of each `act` in ms.

    Args:
        name: as `load_agent` takes it.
        world: where it drives.
        seed: of the episode.
        robot: the car, a name or a file.

    Returns:
        steps driven, the median (`p50_ms`), the 95th percentile (`p95_ms`) and the longest of all but the first, and
        the `first_ms`, in which planners plan the whole way.
    """
    task = TaskConfig(robot=robot, lidar=LidarConfig(caster="embree"))
    agent = _Timed(load_agent(name, task))
    drive = Drive(task, load_world(world, robot=load_robot(robot)))
    run_episode(drive, agent, seed, 0)  # compiles and warms what can be
    agent.took_ms.clear()
    run_episode(drive, agent, seed, 0)
    drive.close()
    first, *later = agent.took_ms
    p50, p95, longest = np.percentile(later or [first], (50, 95, 100))
    return {"steps": len(agent.took_ms), "p50_ms": p50, "p95_ms": p95, "longest_ms": longest, "first_ms": first}


class _Timed:
    """Another agent, its time taken."""

    def __init__(self, agent: Agent) -> None:
        self.name, self.privileged = agent.name, agent.privileged
        self._agent = agent
        self.took_ms: list[float] = []

    def reset(self, seed: int) -> None:
        self._agent.reset(seed)

    def act(self, reading: Reading) -> Command:
        began = time.process_time()
        command = self._agent.act(reading)
        self.took_ms.append(1e3 * (time.process_time() - began))
        return command


def bench_text(result: dict[str, dict[str, float]]) -> str:
    """Return the figures of `run_bench` as a Markdown table."""
    names = list(next(iter(result.values())))
    rows = ["| | " + " | ".join(result) + " |", "|---" * (len(result) + 1) + "|"]
    rows += [f"| {name} | " + " | ".join(f"{part[name]:.3g}" for part in result.values()) + " |" for name in names]
    return "\n".join(rows)


def _bench(world: str, n_steps: int, seed: int, task: TaskConfig) -> dict[str, float]:
    env = ZebratEnv(world, task=task)
    drive, rng = env.drive, np.random.default_rng(seed)
    env.reset(seed=seed)
    sweep_as_the_step = partial(drive.lidar.sweep, watched_only=True)
    samples: dict[str, list[float]] = {}

    def timed(name: str, call: Callable[..., Any], *arguments: object) -> Any:
        began = time.perf_counter()
        answer = call(*arguments)
        samples.setdefault(name, []).append(time.perf_counter() - began)
        return answer

    def bare_physics() -> None:
        for _ in range(task.physics.n_substeps):
            pybullet.stepSimulation(physicsClientId=drive.sim.client)

    for _ in range(n_steps + WARMUP_STEPS):
        action = np.array([0.8, rng.uniform(-1.0, 1.0)], dtype=np.float32)
        command = env.spec_observation.decode(action)
        _, _, terminated, truncated, _ = timed("full", env.step, action)
        timed("bare_rays", drive.lidar.caster.trace)
        timed("physics", drive.sim.step, command)
        sweep = timed("rays", sweep_as_the_step, drive.state, rng)
        timed("flatten", drive.lidar.flat, sweep)
        timed("bare_physics", bare_physics)
        if terminated or truncated:
            env.reset()
    env.close()
    ms = {name: 1e3 * median(values[WARMUP_STEPS:]) for name, values in samples.items()}
    ms["rest"] = ms["full"] - ms["physics"] - ms["rays"] - ms["flatten"]
    return {
        "steps_per_s": 1e3 / ms["full"],
        "rtf": task.physics.control_step_s * 1e3 / ms["full"],
        "overhead": ms["full"] / (ms["bare_rays"] + ms["bare_physics"]),
    } | {f"{name}_ms": value for name, value in ms.items()}
