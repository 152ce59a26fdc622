"""Exported policies, and what a car of PyBullet senses on its way, for the tests of `deploy`."""

import json
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.policy import PolicyAgent, save_policy
from zebrat_bullet.config import LidarConfig, TaskConfig
from zebrat_bullet.deploy.definition import digest_of
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.observation import ObservationSpec
from zebrat_bullet.types import FlatScan, PointCloud
from zebrat_bullet.world import load_world

GRID = ((-1.0, -0.4, 0.4, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0))
SPEC = ObservationSpec(n_rays=32, range_max_m=6.0, max_speed_mps=0.6, max_steering_rad=0.6)


@dataclass(frozen=True)
class Way:
    """What the shipped policy sensed in `track_2`: scans and clouds of the same sweeps."""

    scans: list[FlatScan]
    clouds: list[PointCloud]


@cache
def way() -> Way:
    """Drive once, for all tests of a process."""
    task = TaskConfig(lidar=LidarConfig(caster="embree"))
    drive, agent, rng = Drive(task, load_world("track_2")), load_agent("shipped", task), np.random.default_rng(0)
    reading, outcome = drive.reset(rng), None
    scans, clouds = [reading.scan], [drive.lidar.cloud(drive.lidar.sweep(drive.state, rng))]
    while outcome is None:
        step = drive.step(agent.act(reading))
        reading, outcome = step.reading, step.outcome
        scans.append(reading.scan)
        clouds.append(drive.lidar.cloud(drive.lidar.sweep(drive.state, rng)))
    drive.close()
    return Way(scans, clouds)


def random_policy(head: str, activation: str, folder: Path, **provenance: object) -> Path:
    """Save a small random network that observes 34 numbers, and return its file."""
    rng = np.random.default_rng(len(head) + 10 * len(activation))
    grid = GRID if head == "grid" else ((), ())
    sizes = (34, 24, 16, {"argmax": 6, "grid": sum(map(len, GRID))}.get(head, 2))
    layers = [
        (rng.normal(0.0, 0.4, (n, m)).astype(np.float32), rng.normal(0.0, 0.1, n).astype(np.float32))
        for m, n in pairwise(sizes)
    ]
    path = folder / f"{head}_{activation}.safetensors"
    save_policy(PolicyAgent(path.stem, layers, SPEC, provenance, head, activation, grid), path)
    return path


def change(path: Path, *keys: str | int, to: object) -> None:
    """Write another value into a `policy.json`, as if it had been exported so."""
    data = json.loads(path.read_text(encoding="utf-8"))
    at = data
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = to
    if keys[0] != "sha256":
        data["sha256"] = digest_of({key: value for key, value in data.items() if key != "sha256"})
    path.write_text(json.dumps(data), encoding="utf-8")
