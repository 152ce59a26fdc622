"""The fourth representation: every point of the height band against the car's outline, all that the lidar can see."""

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import FlattenConfig
from zebrat_bullet.sensing.flatten import LEVEL_TILT_RAD
from zebrat_bullet.types import PointCloud


def cloud_gap(cloud: PointCloud, flatten: FlattenConfig, outline_lidar: NDArray[np.float64]) -> float:
    """Return how far in m the nearest point of the height band stands outside of a convex outline.

    Negative inside, infinite where the band holds no point. The outline enlarged by a margin with mitred sides, as the
    safety region enlarges it, is hit if and only if the gap is at most that margin.

    Args:
        cloud: one revolution.
        flatten: height band above the floor.
        outline_lidar: (K, 2) convex, m, counter-clockwise, about the lidar, x along the car's heading.
    """
    return float(side_distances(band_points(cloud, flatten), outline_lidar).min(initial=np.inf))


def band_points(cloud: PointCloud, flatten: FlattenConfig) -> NDArray[np.float32]:
    """Return the (P, 2) returns within the height band, in m about the lidar, gravity-levelled, x along the heading.

    A lidar that the scan takes as level (`LEVEL_TILT_RAD`) is taken as level here too, so both tell of the same points.
    """
    points = cloud.points_lidar
    if np.abs(cloud.rotation_level - np.eye(3)).max() >= LEVEL_TILT_RAD:
        points = points @ cloud.rotation_level.T.astype(np.float32)
    rise = points[:, 2]
    in_band = rise >= flatten.height_min_m - cloud.height_m
    in_band &= rise <= flatten.height_max_m - cloud.height_m
    in_band &= cloud.valid
    return points[in_band, :2]


def side_distances(points: NDArray[np.floating], outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (P,) signed distances in m of (P, 2) points to a convex (K, 2) counter-clockwise outline.

    The largest of the distances to the lines of its sides: negative inside, mitred (not round) at the corners.
    """
    sides = np.roll(outline, -1, axis=0) - outline
    normals = np.stack([sides[:, 1], -sides[:, 0]], axis=1) / np.hypot(*sides.T)[:, None]
    offsets = np.einsum("kd,kd->k", normals, outline)
    # Sides along the first axis: several times as fast as a maximum over the short last axis.
    return (normals @ points.T - offsets[:, None]).max(axis=0)
