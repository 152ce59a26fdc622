"""From the messages of any lidar to the flat scan that a policy was trained with."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.deploy.driver import Limits
from zebrat_bullet.deploy.senses import MOST_HEIGHT_M, ScanReader, cloud_of, turned_rays
from zebrat_bullet.errors import ConfigError, SensorError
from zebrat_bullet.files import shown
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.ros.messages import cloud_points, scan_ranges
from zebrat_bullet.sensing.flatten import flatten_cloud
from zebrat_bullet.types import FlatScan

_NO_SENSOR = ("map", "odom", "world", "earth", "base_link", "base_footprint", "base")
"""Frames by convention (REP 105) of the world or of the car, whose origin is not the lidar's."""


@dataclass(frozen=True, kw_only=True)
class Mount:
    """How the recorded lidar was mounted.

    Attributes:
        height_m: above the floor.
        rpy_rad: fixed-axis turns of its frame against the level car.
        frame: the `frame_id` that its messages have; empty: any one but those of the world and the car.
    """

    height_m: float
    rpy_rad: tuple[float, float, float]
    frame: str = ""

    def __post_init__(self) -> None:
        if not (0.0 <= self.height_m <= MOST_HEIGHT_M and np.isfinite(self.rpy_rad).all()):
            raise ConfigError(
                f"a lidar is mounted 0 to {MOST_HEIGHT_M:g} m high, turned by finite angles, got {self.height_m} and "
                f"{self.rpy_rad}"
            )


class Eyes:
    """Flattens recorded clouds and scans as an exported policy's driver does on the car.

    Args:
        task: the lidar and the height band of the policy's training.
        mount: of the recorded lidar.
        needed: (R,) indices of the bearings that must be known.
        limits: of what is refused; None: the driver's own.
    """

    def __init__(self, task: TaskConfig, mount: Mount, needed: NDArray[np.intp], limits: Limits | None = None) -> None:
        self._task, self._mount, self._limits = task, mount, limits or Limits()
        self._rotation = rotation_from_rpy(*mount.rpy_rad)
        lidar = task.lidar
        self._scans = ScanReader(lidar.n_bearings, needed, lidar.range_max_m, self._limits.least_share)
        self.frame = mount.frame

    def cloud(self, message: Any) -> FlatScan:
        """Return the flat scan of a `PointCloud2`.

        Raises:
            SensorError: it contradicts itself, is of another frame, or holds too little.
        """
        self._check_frame(message)
        lidar = self._task.lidar
        points = cloud_points(message)
        fewest = self._limits.least_points, self._limits.least_sector_points
        cloud = cloud_of(points, self._rotation, self._mount.height_m, lidar.range_max_m, *fewest)
        return flatten_cloud(cloud, self._task.flatten, lidar.n_bearings, lidar.range_max_m)

    def scan(self, message: Any) -> FlatScan:
        """Return the flat scan of a `LaserScan`, whose lidar stands level, upright or upside down.

        Raises:
            SensorError: as `cloud`.
        """
        self._check_frame(message)
        rays = turned_rays(self._rotation, float(message.angle_min), float(message.angle_increment))
        return self._scans.read(scan_ranges(message), *rays)

    def _check_frame(self, message: Any) -> None:
        frame = str(message.header.frame_id).lstrip("/")
        if not self.frame and frame in _NO_SENSOR:
            raise SensorError(
                f"what was seen is told in the frame {frame!r}, by its name not the lidar's own; record the lidar's "
                f"topic, or give --lidar-frame {frame} if that is where the lidar stands"
            )
        self.frame = self.frame or frame
        if frame != self.frame:
            raise SensorError(f"what was seen is told in the frame {shown(frame)!r}, expected {shown(self.frame)!r}")
