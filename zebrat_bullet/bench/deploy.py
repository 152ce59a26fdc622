"""Times an exported policy on one core: what its car's lidar says in, a command out."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.export import export_policy
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.deploy import Driver
from zebrat_bullet.deploy.supervisor import MARGIN_M, Supervisor
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import PointCloud, Reading
from zebrat_bullet.world import load_world

WARMUP_CALLS = 50
NEVER_FREE_M = 1.0
"""Margin of a supervisor that refuses every command in a narrow passage, and has to look at every return."""


def bench_deploy(policy: str, world: str, n_calls: int, seed: int) -> dict[str, float]:
    """Return how long an exported policy takes for a cloud and for a 2D scan that the lidar recorded on its way.

    Args:
        policy: as `export_policy` takes it.
        world: where it drives.
        n_calls: times that each is timed, the recorded ones by turns.
        seed: of the episode.

    Returns:
        points of a cloud, the mean number of returns in it, and in ms the median, 99th percentile and longest of
        `cloud` (checking, flattening and the network together), of its part `network` (encoding too) and of `scan`; of
        the supervisor's check as it is by default, `check`, and of one that refuses everything, `refusal`;
        `_cpu_` is the time of the core, free of what other processes took of it.
    """
    if n_calls < 1:
        raise ConfigError(f"steps must be at least 1, got {n_calls}")
    with tempfile.TemporaryDirectory() as folder:
        export_policy(policy, Path(folder))
        driver = Driver.load(folder)
    clouds, readings = _record(policy, world, seed)
    scans = [reading.scan for reading in readings]
    # What a real lidar sends where there was no return.
    points = [np.where(cloud.valid[:, None], cloud.points_lidar, np.float32(np.inf)) for cloud in clouds]
    step_s = driver.definition.control_step_s
    usual, strict = (Supervisor(driver.car, step_s, margin_m) for margin_m in (MARGIN_M, NEVER_FREE_M))

    def check(supervisor: Supervisor) -> Callable[[Reading], object]:
        return lambda seen: supervisor.check(seen.last_command, seen.scan, seen.speed_mps, None)

    with threadpool_limits(1):
        took = {
            "cloud": _timed(driver.drive_cloud, points, n_calls),
            "network": _timed(driver._drive, scans, n_calls),
            "scan": _timed(driver.drive_scan, [scan.ranges_m for scan in scans], n_calls),
            "check": _timed(check(usual), readings, n_calls),
            "refusal": _timed(check(strict), readings, n_calls),
        }
    result: dict[str, float] = {
        "points": len(points[0]),
        "returns": float(np.mean([cloud.valid.sum() for cloud in clouds])),
    }
    for name, both in took.items():
        for clock, values in zip(("", "cpu_"), both, strict=True):
            numbers = np.percentile(values, (50, 99, 100)).tolist()
            names = (f"{name}_{clock}{what}_ms" for what in ("p50", "p99", "longest"))
            result |= dict(zip(names, numbers, strict=True))
    return result


def _record(policy: str, world: str, seed: int) -> tuple[list[PointCloud], list[Reading]]:
    """Drive an episode of the policy in PyBullet and return what its lidar saw and it read."""
    task, _ = as_trained(TaskConfig(), policy, own_robot=True)
    drive, agent = Drive(task, load_world(world, robot=load_robot(task.robot))), load_agent(policy, task)
    reading, outcome = drive.reset(np.random.default_rng(seed)), None
    clouds, readings = [], []
    while outcome is None:
        clouds.append(drive.lidar.cloud(drive.sweep))
        readings.append(reading)
        step = drive.step(agent.act(reading))
        reading, outcome = step.reading, step.outcome
    drive.close()
    return clouds, readings


def _timed(call: Callable[[Any], object], given: list[Any], n_calls: int) -> tuple[list[float], list[float]]:
    """Return wall-clock and processor time in ms of each call but the first few."""
    wall, processor = [], []
    for i in range(n_calls + WARMUP_CALLS):
        began, began_processor = time.perf_counter(), time.thread_time()
        call(given[i % len(given)])
        processor.append(1e3 * (time.thread_time() - began_processor))
        wall.append(1e3 * (time.perf_counter() - began))
    return wall[WARMUP_CALLS:], processor[WARMUP_CALLS:]
