"""Times thousands of planar cars beside one car of PyBullet, each in turn, so that other load meets all alike."""

import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from zebrat_bullet.arrays import like
from zebrat_bullet.config import EpisodeConfig, LidarConfig, ObservationConfig, TaskConfig
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.planar.simulation import device_name
from zebrat_bullet.world import World, generate_tracks

N_TRACKS = 100
FIRST_SEED = 0
CARS_A_STEP = 20
"""A step of all planar cars is timed for so many of a single car."""


def bench_planar(n_steps: int, n_cars: int, device: str, rounds: int, seed: int) -> dict[str, dict[str, Any]]:
    """Return medians over rounds, in each of which planar cars and both casters of PyBullet drive in turn.

    All drive generated tracks from anywhere, forward while they steer at random, and begin anew where they hit a wall.

    Args:
        n_steps: control steps of the car in PyBullet in each round; the planar cars all drive a twentieth of them.
        n_cars: planar cars.
        device: of the planar cars.
        rounds: how often.
        seed: of starts and steering.

    Returns:
        "planar": `steps_per_s`, `n_cars`, `device`, and where the time of a step of one car goes: `drive_us` (motion
        and contact), `look_us` (rays), `resets_us`, `rest_us` (rules, reward, observation); "embree" and "bullet":
        `steps_per_s`; "hardware": `cpu`, `cores`, `threads` in use.

    Raises:
        ConfigError: there is nothing to time, or no such device.
    """
    if n_steps < CARS_A_STEP or rounds < 1:
        raise ConfigError(f"steps must be at least {CARS_A_STEP} and rounds 1, got {n_steps} and {rounds}")
    worlds = list(generate_tracks(range(FIRST_SEED, FIRST_SEED + N_TRACKS)))
    task = TaskConfig(episode=EpisodeConfig(start="anywhere"), observation=ObservationConfig(log_gaps=True))
    fleet = _Fleet(PlanarDrive(task, worlds, n_cars, device=device, seed=seed), seed)
    singles = {caster: _Single(task, worlds, caster, seed) for caster in ("embree", "bullet")}
    rates: dict[str, list[float]] = {name: [] for name in ("planar", *singles)}
    splits: list[dict[str, float]] = []
    fleet.run(CARS_A_STEP)
    for single in singles.values():
        single.run(CARS_A_STEP)
    for _ in range(rounds):
        rates["planar"].append(fleet.run(n_steps // CARS_A_STEP))
        splits.append(fleet.split(n_steps // CARS_A_STEP))
        for name, single in singles.items():
            rates[name].append(single.run(n_steps))
    for single in singles.values():
        single.close()
    steps = {name: {"steps_per_s": median(values)} for name, values in rates.items()}
    split = {name: median(part[name] for part in splits) for name in splits[0]}
    there = {"n_cars": n_cars, "device": device_name(device)}
    return steps | {"planar": steps["planar"] | there | split, "hardware": hardware()}


def planar_text(result: dict[str, dict[str, Any]]) -> str:
    """Return the figures of `bench_planar` for people."""
    planar, machine = result["planar"], result["hardware"]
    parts = ", ".join(f"{name.removesuffix('_us')} {planar[name]:.2f}" for name in planar if name.endswith("_us"))
    return "\n".join(
        [
            f"{machine['cpu']}, {machine['cores']} cores, one thread; planar cars on {planar['device']}",
            "| | control steps/s |\n|---|---|",
            f"| {planar['n_cars']:,} planar cars | {planar['steps_per_s']:,.0f} |",
            *(f"| one car, {name} caster | {result[name]['steps_per_s']:,.0f} |" for name in ("embree", "bullet")),
            f"\nus of a planar car's step: {parts}",
        ]
    )


def hardware() -> dict[str, str | int]:
    """Return what this runs on: the processor's name, its cores, and the threads that are used."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {"cpu": names[0] if names else platform.processor(), "cores": os.cpu_count() or 1, "threads": 1}


class _Fleet:
    """Planar cars, timed."""

    def __init__(self, drive: PlanarDrive, seed: int) -> None:
        self._drive, self._rng = drive, np.random.default_rng(seed)

    def run(self, n: int) -> float:
        """Drive so many steps of every car; return how many steps of one car that makes a second."""
        batches = self._actions(n)
        began = time.perf_counter()
        for actions in batches:
            self._drive.step(actions)
        self._drive.sim.wait()
        return n * self._drive.n_cars / (time.perf_counter() - began)

    def split(self, n: int) -> dict[str, float]:
        """Drive so many steps; return where their time goes, in us of a step of one car."""
        drive, batches, took = self._drive, self._actions(n), {"drive": 0.0, "look": 0.0, "resets": 0.0}
        with self._timed(drive.sim, "step", "drive", took), self._timed(drive.sim, "look", "look", took):  # noqa: SIM117
            with self._timed(drive, "_begin", "resets", took):
                began = time.perf_counter()
                for actions in batches:
                    drive.step(actions)
                drive.sim.wait()
                took["rest"] = time.perf_counter() - began - sum(took.values())
        return {f"{name}_us": 1e6 * seconds / (n * drive.n_cars) for name, seconds in took.items()}

    @contextmanager
    def _timed(self, owner: object, method: str, name: str, took: dict[str, float]) -> Iterator[None]:
        call: Callable[..., Any] = getattr(owner, method)

        def timed(*arguments: object) -> None:
            self._drive.sim.wait()
            began = time.perf_counter()
            call(*arguments)
            self._drive.sim.wait()
            took[name] += time.perf_counter() - began

        setattr(owner, method, timed)
        yield
        delattr(owner, method)

    def _actions(self, n: int) -> list[Any]:
        actions = np.full((n, self._drive.n_cars, 2), 0.8, dtype=np.float32)
        actions[..., 1] = self._rng.uniform(-1.0, 1.0, actions.shape[:2])
        return [like(each, self._drive.sim.pose) for each in actions]


class _Single:
    """One car of PyBullet, timed."""

    def __init__(self, task: TaskConfig, worlds: list[World], caster: str, seed: int) -> None:
        lidar = LidarConfig(caster=caster)
        self._env = ZebratEnv(worlds, task=TaskConfig(episode=task.episode, observation=task.observation, lidar=lidar))
        self._rng = np.random.default_rng(seed)
        self._env.reset(seed=seed)

    def run(self, n: int) -> float:
        """Drive so many steps, resets not timed; return steps a second."""
        took = 0.0
        for _ in range(n):
            action = np.array([0.8, self._rng.uniform(-1.0, 1.0)], dtype=np.float32)
            began = time.perf_counter()
            _, _, terminated, truncated, _ = self._env.step(action)
            took += time.perf_counter() - began
            if terminated or truncated:
                self._env.reset()
        return n / took

    def close(self) -> None:
        self._env.close()
