"""Where many cars begin: poses drawn for a world, and worlds and poses that users name."""

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from zebrat_bullet.config import EpisodeConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown
from zebrat_bullet.geometry import to_world_all
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.task.episode import draw_poses
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World
from zebrat_bullet.world.poses import pose_from, require_inside


def places_of(
    worlds: ArrayLike,
    poses: Sequence[Pose2] | NDArray[np.float64],
    n_cars: int,
    there: Sequence[World],
    footprint_base: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return (N,) worlds, by their place in `there`, and (N, 3) poses at which cars stand free in them.

    Args:
        worlds, poses: what a user named: x, y in m and yaw in rad, world frame.
        n_cars: N.
        there: the worlds that there are.
        footprint_base: (K, 2) outline of the car in m.

    Raises:
        ConfigError: they are not of these shapes and kinds; or a car would stand in a wall or off the ground.
    """
    which = np.asarray(worlds)
    if which.shape != (n_cars,) or which.dtype.kind not in "iu":
        raise ConfigError(f"worlds must be {n_cars} whole numbers, one for each car, got {shown(repr(worlds))}")
    if n_cars and not (which.min() >= 0 and which.max() < len(there)):
        raise ConfigError(f"worlds must be 0 to {len(there) - 1}, got {which.min()} to {which.max()}")
    try:
        rows = np.asarray(poses if isinstance(poses, np.ndarray) else list(poses), dtype=np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.shape != (n_cars, 3):
        raise ConfigError(
            f"poses must be {n_cars}, one for each car, each a Pose2 or (x, y, yaw) in m and rad, got "
            f"{shown(repr(poses))}"
        )
    if not np.isfinite(rows).all():
        car = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
        pose_from(rows[car].tolist(), f"the pose of car {car}")
    for i in np.unique(which):
        _require_free(np.flatnonzero(which == i), rows, there[i], footprint_base)
    return which.astype(np.int32), rows


def starts_of(world: World, robot: RobotModel, episode: EpisodeConfig, n: int) -> NDArray[np.float64]:
    """Return poses at which episodes begin, (n, 3) x, y in m and yaw in rad: a function of the world alone."""
    rng = np.random.default_rng(np.frombuffer(world.name.encode(), dtype=np.uint8))
    return draw_poses(world, robot, episode, rng, n)


def _require_free(
    cars: NDArray[np.intp], poses: NDArray[np.float64], world: World, footprint_base: NDArray[np.float64]
) -> None:
    x0, y0, x1, y1 = shapely.GeometryCollection([world.walls, world.free_space]).bounds
    x, y = poses[cars, 0], poses[cars, 1]
    for car in cars[(x < x0) | (x > x1) | (y < y0) | (y > y1)][:1]:
        require_inside(Pose2(*poses[car].tolist()), world, f"the pose of car {car}")
    shapely.prepare(world.walls)  # kept in the geometry: only its first call costs
    outlines = shapely.polygons(to_world_all(footprint_base, poses[cars]))
    for car in cars[shapely.intersects(world.walls, outlines)][:1]:
        raise ConfigError(
            f"the pose of car {car} {tuple(poses[car].tolist())} puts it into a wall of {world.name!r}; move it"
        )
