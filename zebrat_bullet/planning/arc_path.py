"""Paths of circular arcs and straights, forward and backward: what a car with a steered axle can follow."""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Pose2


@dataclass(frozen=True)
class ArcPath:
    """Poses of the rear axle, each joined to the next by one circular arc or straight of less than half a turn.

    Attributes:
        poses_world: (N, 3) float64, x and y in m, yaw in rad and continuous (not wrapped).
        directions: (N - 1,) int, 1 where the car drives forward to the next pose, -1 where it reverses.
    """

    poses_world: NDArray[np.float64]
    directions: NDArray[np.int64]

    @property
    def turns_rad(self) -> NDArray[np.float64]:
        """(N - 1,) change of yaw along each arc, left positive."""
        return np.diff(self.poses_world[:, 2])

    @property
    def lengths_m(self) -> NDArray[np.float64]:
        """(N - 1,) length of each arc, from its chord: chord = length sin(turn / 2) / (turn / 2)."""
        chords = np.hypot(*np.diff(self.poses_world[:, :2], axis=0).T)
        return chords / np.sinc(self.turns_rad / (2.0 * math.pi))

    @property
    def curvatures(self) -> NDArray[np.float64]:
        """(N - 1,) signed curvature of each arc in 1/m, that of the wheels: positive where they are turned left."""
        return self.directions * self.turns_rad / self.lengths_m

    @property
    def n_reversals(self) -> int:
        """How often the car changes between forward and backward."""
        return int((np.diff(self.directions) != 0).sum())

    def lateral_errors_m(self) -> NDArray[np.float64]:
        """Return (N - 1,) m, how far each pose lies beside an arc from the pose before it: 0 but for rounding.

        A car that does not slip moves along its own heading: the chord of an arc points along the mean of the headings
        at its ends.
        """
        steps = np.diff(self.poses_world[:, :2], axis=0)
        middle = self.poses_world[:-1, 2] + self.turns_rad / 2.0
        ahead = steps[:, 0] * np.cos(middle) + steps[:, 1] * np.sin(middle)
        aside = -steps[:, 0] * np.sin(middle) + steps[:, 1] * np.cos(middle)
        return np.where(ahead * self.directions > 0.0, np.abs(aside), np.hypot(ahead, aside))

    def sample(self, spacing_m: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return poses along the path, at most `spacing_m` apart, its own among them.

        Returns:
            (M, 3) poses like `poses_world`; (M,) the number of the arc that leads to each, 0 for the first.
        """
        lengths = self.lengths_m
        counts = np.maximum(1, np.ceil(lengths / spacing_m - 1e-9).astype(np.int64))
        arcs = np.repeat(np.arange(len(lengths)), counts)
        steps = np.arange(1, len(arcs) + 1) - np.repeat(counts.cumsum() - counts, counts)
        poses = self.at(arcs, lengths[arcs] * steps / counts[arcs])
        return np.concatenate([self.poses_world[:1], poses]), np.concatenate([np.zeros(1, dtype=np.int64), arcs])

    def at(self, arcs: NDArray[np.int64], distances_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (M, 3) poses like `poses_world`, at (M,) distances from the beginnings of (M,) arcs."""
        begin, driven = self.poses_world[arcs], self.directions[arcs] * distances_m
        return _moved(begin, driven, (self.turns_rad / self.lengths_m)[arcs] * distances_m)


def along_arc(pose: NDArray[np.float64], distances_m: NDArray[np.float64], turn_rad: float) -> NDArray[np.float64]:
    """Return (M, 3) poses at signed distances from a pose, along an arc that has turned by `turn_rad` at the last."""
    return _moved(pose[None], distances_m, turn_rad * distances_m / distances_m[-1])


def _moved(
    poses: NDArray[np.float64], distances_m: NDArray[np.float64], turns_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    chords = distances_m * np.sinc(turns_rad / (2.0 * math.pi))
    headings = poses[:, 2] + turns_rad / 2.0
    return poses + np.column_stack([chords * np.cos(headings), chords * np.sin(headings), turns_rad])


def axle_pose(base: Pose2, robot: RobotModel) -> NDArray[np.float64]:
    """Return the (3,) pose of the rear axle of a car whose base frame is at `base`."""
    x = robot.rear_axle_x_m
    return np.array([base.x + x * math.cos(base.yaw), base.y + x * math.sin(base.yaw), base.yaw])


def footprint_about_axle(robot: RobotModel) -> NDArray[np.float64]:
    """Return the (K, 2) corners of the footprint in m as seen from the rear axle."""
    return robot.footprint_base - (robot.rear_axle_x_m, 0.0)


def outlines(axle_poses: NDArray[np.float64], robot: RobotModel) -> NDArray[np.object_]:
    """Return (M,) polygons: the footprints of cars whose rear axles are at (M, 3) poses."""
    x, y = footprint_about_axle(robot).T
    c, s = np.cos(axle_poses[:, 2:]), np.sin(axle_poses[:, 2:])
    corners = np.stack([axle_poses[:, :1] + c * x - s * y, axle_poses[:, 1:2] + s * x + c * y], axis=-1)
    return shapely.polygons(corners)


def clearances(axle_poses: NDArray[np.float64], robot: RobotModel, walls: shapely.MultiPolygon) -> NDArray[np.float64]:
    """Return the (M,) distances in m between footprint and walls; 0 where they touch or overlap, inf without walls."""
    if walls.is_empty:
        return np.full(len(axle_poses), np.inf)
    shapely.prepare(walls)
    return shapely.distance(walls, outlines(axle_poses, robot))


def sweep_factor(robot: RobotModel, curvature: float) -> float:
    """Return how many metres the fastest point of the footprint moves for a metre of the rear axle on an arc."""
    x, y = footprint_about_axle(robot).T
    return float(np.hypot(1.0 + abs(curvature) * np.abs(y), curvature * x).max())
