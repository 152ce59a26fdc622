"""Times the full environment step beside the bare cost of what it cannot do without: rays and physics."""

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
import pybullet

from zebrat_bullet.config import LidarConfig, PhysicsConfig, TaskConfig
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError

WARMUP_STEPS = 50


def run_bench(world: str, n_steps: int, seed: int, rate_hz: float | None = None) -> dict[str, dict[str, float]]:
    """Return, for each ray caster, medians over interleaved control steps of a car that steers at random.

    Args:
        world: where it drives.
        n_steps: control steps timed, a third of the number driven.
        seed: of start and steering.
        rate_hz: physics rate; None for the task's.

    Returns:
        For "embree" and "bullet": `steps_per_s` and `rtf` (simulated seconds a second) of the full step; `overhead`,
        full step / (bare ray cast + bare physics); and the split in ms: full, physics, rays, flatten, rest, beside
        bare_rays (the caster's own call) and bare_physics (`stepSimulation` alone).
    """
    if n_steps < 1:
        raise ConfigError(f"steps must be at least 1, got {n_steps}")
    physics = PhysicsConfig() if rate_hz is None else PhysicsConfig(rate_hz=rate_hz)
    return {
        caster: _bench(world, n_steps, seed, TaskConfig(physics=physics, lidar=LidarConfig(caster=caster)))
        for caster in ("embree", "bullet")
    }


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
    samples: dict[str, list[float]] = {}

    def timed(name: str, call: Callable[..., Any], *arguments: object) -> Any:
        began = time.perf_counter()
        answer = call(*arguments)
        samples.setdefault(name, []).append(time.perf_counter() - began)
        return answer

    def bare_physics() -> None:
        for _ in range(task.physics.n_substeps):
            pybullet.stepSimulation(physicsClientId=drive.sim.client_id)

    for _ in range(n_steps + WARMUP_STEPS):
        action = np.array([0.8, rng.uniform(-1.0, 1.0)], dtype=np.float32)
        command = env.spec_observation.decode(action)
        _, _, terminated, truncated, _ = timed("full", env.step, action)
        timed("bare_rays", drive.lidar.caster.trace)
        timed("physics", drive.sim.step, command)
        sweep = timed("rays", drive.lidar.sweep, drive.state, rng)
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
