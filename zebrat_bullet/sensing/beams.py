"""The directions a lidar looks in."""

import math

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import LidarConfig


def beam_bearings(n_bearings: int) -> NDArray[np.float64]:
    """Return the (n_bearings,) bearings in rad, from -pi (straight back) counter-clockwise, as in ROS LaserScan."""
    return np.linspace(-math.pi, math.pi, n_bearings, endpoint=False, dtype=np.float64)


def side_bearings(n_bearings: int) -> tuple[int, int]:
    """Return the scan indices that count as right and left: exactly abeam where `n_bearings` is a multiple of 4."""
    return n_bearings // 4, 3 * n_bearings // 4


def beam_elevations(config: LidarConfig) -> NDArray[np.float64]:
    """Return the (n_channels,) elevations in rad, lowest first, evenly spaced from the lowest to the highest."""
    return np.linspace(config.elevation_min_rad, config.elevation_max_rad, config.n_channels)


def beam_directions(config: LidarConfig) -> NDArray[np.float32]:
    """Return the (N, 3) unit directions in the lidar frame, channel-major: all bearings of the lowest channel first."""
    elevation = beam_elevations(config)[:, None]
    bearing = beam_bearings(config.n_bearings)[None, :]
    x, y = np.cos(elevation) * np.cos(bearing), np.cos(elevation) * np.sin(bearing)
    z = np.broadcast_to(np.sin(elevation), x.shape)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
