"""Planar cars for tests that work their numbers out by hand, and rays cast by brute force."""

from collections.abc import Sequence

import numpy as np
from boxes import box_world
from numpy.typing import ArrayLike, NDArray

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.geometry import wall_segments
from zebrat_bullet.planar.simulation import PlanarSimulation
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world.world import World

AS_BUILT = (1.0, 1.0, 0.0, 1.0, 0.0)
"""Factors on torque and hinge speed, steering offset, factor on speed, delay: a car as its URDF says."""
FIELD = box_world(((20.0, 21.0), (-1.0, 1.0), (0.0, 1.0)), ((-21.0, -20.0), (-1.0, 1.0), (0.0, 1.0)))
"""Nothing within 20 m of the origin."""


def planar(
    worlds: World | Sequence[World],
    n_cars: int = 1,
    task: TaskConfig | None = None,
    *,
    indices: NDArray[np.intp] | None = None,
    margin_m: float = 0.0,
) -> PlanarSimulation:
    """Return a simulation of the task's robot, which looks along all bearings unless some are named."""
    task, worlds = task or TaskConfig(), [worlds] if isinstance(worlds, World) else worlds
    looks = np.arange(task.lidar.n_bearings) if indices is None else indices
    sim = PlanarSimulation(load_robot(task.robot), task, looks, worlds, n_cars)
    sim.margin[:] = margin_m
    return sim


def stand(sim: PlanarSimulation, poses_world: ArrayLike, worlds: ArrayLike = 0, dynamics: ArrayLike = AS_BUILT) -> None:
    """Stand all cars at these (N, 3) or (3,) poses of the world frame, at rest."""
    n = len(sim.pose)
    in_world = np.broadcast_to(np.asarray(worlds, np.int32), n)
    poses = np.broadcast_to(np.asarray(poses_world, np.float64), (n, 3)).copy()
    poses[:, :2] -= sim.origin[in_world]
    rows = np.broadcast_to(np.asarray(dynamics, np.float32), (n, 5))
    sim.place(np.arange(n), in_world, poses.astype(np.float32), rows)
    sim.command[:] = 0.0


def drive(sim: PlanarSimulation, commands: ArrayLike) -> NDArray[np.float64]:
    """Drive (T, 2) commands in m/s and rad, or (T, N, 2), and return the (T + 1, N, 3) poses, world frame."""
    poses = [world_poses(sim)]
    for command in np.asarray(commands):
        sim.command[:] = command
        sim.step()
        poses.append(world_poses(sim))
    return np.array(poses)


def world_poses(sim: PlanarSimulation) -> NDArray[np.float64]:
    """Return the (N, 3) poses of all cars in the world frame."""
    poses = sim.pose.astype(np.float64)
    poses[:, :2] += sim.origin[sim.world]
    return poses


def brute_ranges(
    world: World, points: NDArray[np.float64], bearings: NDArray[np.float64], reach_m: float
) -> NDArray[np.float64]:
    """Return the (P, B) ranges in m from (P, 2) free points along (P, B) bearings of the world frame to any wall."""
    ends = wall_segments(world.walls)
    a, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    found = np.empty_like(bearings)
    for i, point in enumerate(points):
        ray = np.stack([np.cos(bearings[i]), np.sin(bearings[i])], axis=1)[:, None]
        to = a - point
        across = ray[..., 0] * along[:, 1] - ray[..., 1] * along[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (to[:, 0] * along[:, 1] - to[:, 1] * along[:, 0]) / across
            part = (to[:, 0] * ray[..., 1] - to[:, 1] * ray[..., 0]) / across
        met = (at > 0) & (part >= -1e-12) & (part <= 1 + 1e-12)
        found[i] = np.where(met, at, np.inf).min(axis=1)
    return np.minimum(found, reach_m)
