"""The band itself: poses of the rear axle and the time between them; begun, pruned and resized, not optimised."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.geometry import wrap_angle
from zebrat_bullet.planning.teb.config import TebConfig
from zebrat_bullet.planning.teb.costs import Costs


@dataclass
class Band:
    """A timed elastic band; its first and last pose are fixed.

    Attributes:
        poses: (N, 3) float64, x, y in m and yaw in rad, world frame, rear axle.
        dt_s: (N - 1,) float64, time from each pose to the next.
    """

    poses: NDArray[np.float64]
    dt_s: NDArray[np.float64]


def begin(path: NDArray[np.float64], start: NDArray[np.float64], goal_yaw: float, costs: Costs) -> Band:
    """Return a band along a path, each pose heading for the next, or away from it where the goal lies behind the start.

    Args:
        path: (M, 2) float64, m, M >= 2; its first point gives way to the start.
        start: (3,) float64, the pose that the band begins at.
        goal_yaw: heading in rad at the end of the path.
    """
    inner = path[1:-1]
    ahead = np.diff(path[1:], axis=0)
    behind = np.dot(path[-1] - start[:2], (math.cos(start[2]), math.sin(start[2]))) < 0.0
    yaws = np.arctan2(ahead[:, 1], ahead[:, 0]) + (math.pi if behind else 0.0)
    poses = np.vstack([start, np.column_stack([inner, yaws]), [*path[-1], goal_yaw]])
    while len(poses) < 4:
        poses = np.insert(poses, 1, _between(poses[0], poses[1]), axis=0)
    steps = np.diff(poses, axis=0)
    turns = np.array([wrap_angle(turn) for turn in steps[:, 2]])
    duration = np.maximum(
        np.hypot(steps[:, 0], steps[:, 1]) / costs.max_vel_x_mps, np.abs(turns) / costs.max_vel_theta_radps
    )
    return Band(poses, np.maximum(duration, 1e-3))


def prune(band: Band, start: NDArray[np.float64], goal: NDArray[np.float64], min_samples: int) -> Band:
    """Return the band from the pose nearest to the new start on, with its ends moved to the new start and goal."""
    last = min(len(band.poses) - 1 - min_samples, 10)
    distance = np.hypot(*(band.poses[: max(last, 0) + 1, :2] - start[:2]).T)
    nearer = np.diff(distance) < 0.0
    n_passed = len(nearer) if nearer.all() else int(np.argmin(nearer))
    poses, dt_s = band.poses[n_passed:].copy(), band.dt_s[n_passed:].copy()
    poses[0], poses[-1] = start, goal
    return Band(poses, dt_s)


def resize(band: Band, config: TebConfig) -> Band:
    """Return the band with poses put in and taken out until its time steps are near `dt_ref_s`."""
    poses, dt_s = list(band.poses), [float(dt) for dt in band.dt_s]
    longest, shortest = config.dt_ref_s + config.dt_hysteresis_s, config.dt_ref_s - config.dt_hysteresis_s
    for _ in range(100):  # splitting and merging may chase each other
        if not _resize_once(poses, dt_s, config, longest, shortest):
            break
    return Band(np.array(poses), np.array(dt_s))


def _resize_once(
    poses: list[NDArray[np.float64]], dt_s: list[float], config: TebConfig, longest: float, shortest: float
) -> bool:
    """Go once along the band, splitting and merging steps in place; return whether any pose came or went."""
    modified = False
    i = 0
    while i < len(dt_s):
        if dt_s[i] > longest and len(dt_s) < config.max_samples:
            if dt_s[i] > 2.0 * config.dt_ref_s:
                dt_s[i] *= 0.5
                dt_s.insert(i + 1, dt_s[i])
                poses.insert(i + 1, _between(poses[i], poses[i + 1]))
                modified = True
                continue
            if i + 1 < len(dt_s):
                dt_s[i + 1] += dt_s[i] - config.dt_ref_s
            dt_s[i] = config.dt_ref_s
        elif dt_s[i] < shortest and len(dt_s) > config.min_samples:
            modified = True
            dt = dt_s.pop(i)
            if i < len(dt_s):
                dt_s[i] += dt
                poses.pop(i + 1)
                continue
            dt_s[i - 1] += dt
            poses.pop(i)
        i += 1
    return modified


def _between(pose: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    yaw = math.atan2(math.sin(pose[2]) + math.sin(other[2]), math.cos(pose[2]) + math.cos(other[2]))
    return np.array([*(0.5 * (pose[:2] + other[:2])), yaw])
