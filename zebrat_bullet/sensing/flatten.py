"""From 3D to 2D: the nearest return of every bearing within a height band, as ROS pointcloud_to_laserscan does.

Bearings are about the lidar's origin, in the gravity-levelled frame. The ROS node bins by floor; here a point goes to
the nearest bearing, for the beams lie exactly on the bearings and none should lose its own beam to rounding.

An obstacle of height h falls below the lowest beam where it is nearer than (lidar height - h) / tan(lowest elevation),
for ZebraT (0.75 - h) / tan 15 degrees: inside this blind zone the scan does not show it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import FlattenConfig, LidarConfig
from zebrat_bullet.sensing.beams import beam_elevations
from zebrat_bullet.types import FlatScan, PointCloud

LEVEL_TILT_RAD = 1e-3
"""Below this tilt the lidar counts as level: heights then err by 6 mm at 6 m, bearings by a sixtieth of a degree."""


def flatten_cloud(cloud: PointCloud, config: FlattenConfig, n_bearings: int, range_max_m: float) -> FlatScan:
    """Flatten any cloud, however tilted.

    Args:
        cloud: the returns, in the lidar frame.
        config: height band above the floor.
        n_bearings: bearings of the scan, from -pi counter-clockwise.
        range_max_m: range that stands for a bearing without any return.
    """
    points = cloud.points_lidar[cloud.valid] @ cloud.rotation_level.T
    height = points[:, 2] + cloud.height_m
    points = points[(height >= config.height_min_m) & (height <= config.height_max_m)]
    bearing = np.arctan2(points[:, 1], points[:, 0])
    index = np.rint((bearing + math.pi) * (n_bearings / (2.0 * math.pi))).astype(np.intp) % n_bearings
    ranges = np.full(n_bearings, range_max_m, np.float32)
    np.minimum.at(ranges, index, np.hypot(points[:, 0], points[:, 1]).astype(np.float32))
    return FlatScan(ranges, range_max_m)


class LevelFlattener:
    """Flattens sweeps of a level lidar: every beam keeps its bearing, so a scan is one minimum over the channels."""

    def __init__(self, lidar: LidarConfig, config: FlattenConfig) -> None:
        elevation = beam_elevations(lidar)[:, None]
        self._n_channels, self._n_bearings = lidar.n_channels, lidar.n_bearings
        self._config = config
        self._range_max_m = lidar.range_max_m
        self._cos = np.cos(elevation).astype(np.float32)
        self._sin = np.sin(elevation).astype(np.float32)

    def flatten(
        self, ranges_m: NDArray[np.float32], height_m: float, bearings: NDArray[np.intp] | None = None
    ) -> FlatScan:
        """Flatten a sweep of a lidar `height_m` above the floor.

        Args:
            ranges_m: (N,) range in m of each beam, channel-major.
            height_m: of the lidar above the floor.
            bearings: (W,) the bearings that were cast; the scan is nan in the others. None for all.
        """
        ranges = ranges_m.reshape(self._n_channels, -1)
        rise = ranges * self._sin
        outside = rise < self._config.height_min_m - height_m
        outside |= rise > self._config.height_max_m - height_m
        outside |= ranges >= self._range_max_m
        horizontal = ranges * self._cos
        horizontal[outside] = self._range_max_m
        nearest = horizontal.min(axis=0)
        if bearings is None:
            return FlatScan(nearest, self._range_max_m)
        whole = np.full(self._n_bearings, np.nan, np.float32)
        whole[bearings] = nearest
        return FlatScan(whole, self._range_max_m)
