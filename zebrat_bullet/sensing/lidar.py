"""The 3D lidar: from the state of the car to ranges, a point cloud and a flat scan."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import FlattenConfig, LidarConfig, NoiseConfig
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_directions
from zebrat_bullet.sensing.casters import RayCaster, make_caster
from zebrat_bullet.sensing.flatten import LEVEL_TILT_RAD, LevelFlattener, flatten_cloud
from zebrat_bullet.sensing.noise import NoiseModel
from zebrat_bullet.types import FlatScan, PointCloud, RobotState
from zebrat_bullet.world.world import World


@dataclass(frozen=True, slots=True)
class Sweep:
    """One revolution, noise included: all that cloud and flat scan are made from.

    Attributes:
        ranges_m: (N,) float32, channel-major; the lidar's reach where there was no return.
        rotation_level: (3, 3) float64, turns lidar-frame vectors into the gravity-levelled frame at the lidar, whose x
            axis points along the car's heading.
        height_m: height of the lidar above the floor, as the car believes it.
    """

    ranges_m: NDArray[np.float32]
    rotation_level: NDArray[np.float64]
    height_m: float


class Lidar:
    """Sweeps the world from the car's mount. `scan` is what a control step needs; `cloud` costs only who asks for it.

    Args:
        robot: says where the lidar is mounted.
        config: beams, reach and ray caster.
        noise: imperfections; its mount error moves the beams, while cloud and scan are read as if the URDF were right.
        flatten: height band of the scan.
        client_id: PyBullet client of the simulation, whose walls, floor and ray filter the "bullet" caster uses.

    Attributes:
        caster: the ray caster, whose `trace` is the bare library call.

    Raises:
        ConfigError: the "bullet" caster got no client.
    """

    def __init__(
        self,
        robot: RobotModel,
        config: LidarConfig,
        noise: NoiseConfig,
        flatten: FlattenConfig,
        client_id: int | None = None,
    ) -> None:
        self._config = config
        self._flatten_config = flatten
        self._noise = NoiseModel(noise)
        self._directions = beam_directions(config)
        self._flattener = LevelFlattener(config, flatten)
        self._mount_xyz = np.asarray(robot.lidar_xyz_base)
        self._mount_rotation = rotation_from_rpy(*robot.lidar_rpy)
        self._true_xyz = self._mount_xyz + noise.mount_xyz_m
        self._true_rotation = rotation_from_rpy(0.0, 0.0, noise.mount_yaw_rad) @ self._mount_rotation
        self.caster: RayCaster = make_caster(config.caster, self._directions, config.range_max_m, client_id)

    def set_world(self, world: World) -> None:
        """Look at this world from now on."""
        self.caster.set_world(world)

    def scan(self, state: RobotState, rng: np.random.Generator) -> FlatScan:
        """Return the flattened scan of one sweep from `state`; `rng` draws the noise."""
        return self.flat(self.sweep(state, rng))

    def sweep(self, state: RobotState, rng: np.random.Generator) -> Sweep:
        """Cast all beams from `state`; `rng` draws the noise, if there is any."""
        pose = state.pose
        base = (pose.x, pose.y, state.height_m)
        body = rotation_from_rpy(state.roll, state.pitch, pose.yaw)
        tilt = rotation_from_rpy(state.roll, state.pitch, 0.0)
        ranges = self.caster.cast(base + body @ self._true_xyz, body @ self._true_rotation)
        ranges = self._noise.apply(ranges, self._config.range_max_m, rng)
        height = state.height_m + float(tilt[2] @ self._mount_xyz)
        return Sweep(ranges, tilt @ self._mount_rotation, height)

    def flat(self, sweep: Sweep) -> FlatScan:
        """Return the flattened scan of a sweep, about the lidar's origin, index 0 straight back of the car."""
        if _is_level(sweep.rotation_level):
            return self._flattener.flatten(sweep.ranges_m, sweep.height_m)
        return flatten_cloud(self.cloud(sweep), self._flatten_config, self._config.n_bearings, self._config.range_max_m)

    def cloud(self, sweep: Sweep) -> PointCloud:
        """Return the point cloud of a sweep."""
        return PointCloud(
            points_lidar=sweep.ranges_m[:, None] * self._directions,
            valid=sweep.ranges_m < self._config.range_max_m,
            rotation_level=sweep.rotation_level,
            height_m=sweep.height_m,
        )


def _is_level(rotation_level: NDArray[np.float64]) -> bool:
    """Return whether a rotation is closer to none at all than `LEVEL_TILT_RAD` about every axis."""
    return bool(np.abs(rotation_level - np.eye(3)).max() < LEVEL_TILT_RAD)
