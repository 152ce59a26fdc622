"""Pure planar and spatial geometry: angles, rotations, outlines."""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.types import Pose2


def wrap_angle(angle_rad: float) -> float:
    """Return the same direction in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def rotation_2d(yaw_rad: float) -> NDArray[np.float64]:
    """Return the (2, 2) rotation that turns vectors left by `yaw_rad`."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s], [s, c]])


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return the (3, 3) rotation of fixed-axis roll, pitch, yaw (URDF and ROS convention)."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def driven_forward(before: NDArray[np.floating], after: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return how far in m cars moved along their headings, (N,): (N, 3) poses before and after; negative is back."""
    moved, yaw = after[:, :2] - before[:, :2], before[:, 2]
    return moved[:, 0] * np.cos(yaw) + moved[:, 1] * np.sin(yaw)


def to_world(points_base: NDArray[np.float64], pose: Pose2) -> NDArray[np.float64]:
    """Move (K, 2) points in m from the base frame of a car at `pose` into the world frame."""
    return np.asarray(points_base) @ rotation_2d(pose.yaw).T + (pose.x, pose.y)


def to_world_all(points_base: NDArray[np.float64], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move (K, 2) points in m from the base frame of each of n cars at (n, 3) poses; return (n, K, 2), world frame."""
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    x, y = points_base.T
    return np.stack([poses[:, 0, None] + c * x - s * y, poses[:, 1, None] + s * x + c * y], axis=-1)


def wall_segments(walls: shapely.Geometry) -> NDArray[np.float64]:
    """Return the edges of all outlines as (S, 2, 2) end points."""
    coordinates, owner = shapely.get_coordinates(shapely.get_rings(shapely.get_parts(walls)), return_index=True)
    same = owner[1:] == owner[:-1]
    return np.stack([coordinates[:-1][same], coordinates[1:][same]], axis=1)


def footprint_hits(walls: shapely.Geometry, footprint_base: NDArray[np.float64], pose: Pose2) -> bool:
    """Return whether a (K, 2) outline in m, base frame, of a car at `pose` touches the walls."""
    shapely.prepare(walls)  # kept in the geometry: only its first call costs
    return bool(shapely.intersects(walls, shapely.Polygon(to_world(footprint_base, pose))))
