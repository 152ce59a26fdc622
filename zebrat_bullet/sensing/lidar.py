"""The 3D lidar: from the state of the car to ranges, a point cloud and a flat scan."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import FlattenConfig, LidarConfig, NoiseConfig
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_directions
from zebrat_bullet.sensing.casters import RayCaster, make_caster
from zebrat_bullet.sensing.dark_walls import DarkWalls
from zebrat_bullet.sensing.flatten import LEVEL_TILT_RAD, LevelFlattener, flatten_cloud
from zebrat_bullet.sensing.noise import NoiseModel
from zebrat_bullet.sensing.sight import check_sight
from zebrat_bullet.types import FlatScan, PointCloud, RobotState
from zebrat_bullet.world.world import World

_LEVEL = np.eye(3)


@dataclass(frozen=True, slots=True)
class Sweep:
    """One revolution, noise included: all that cloud and flat scan are made from.

    Attributes:
        ranges_m: (N,) float32, channel-major; the lidar's reach where there was no return.
        rotation_level: (3, 3) float64, turns lidar-frame vectors into the gravity-levelled frame at the lidar, whose x
            axis points along the car's heading.
        height_m: height of the lidar above the floor, as the car believes it.
        bearings: (W,) the bearings that were cast, so that N is W in each channel; None for all.
    """

    ranges_m: NDArray[np.float32]
    rotation_level: NDArray[np.float64]
    height_m: float
    bearings: NDArray[np.intp] | None = None


class Lidar:
    """Sweeps the world from the car's mount. `scan` is what a control step needs; `cloud` costs only who asks for it.

    Args:
        robot: says where the lidar is mounted.
        config: beams, reach and ray caster.
        noise: imperfections; its mount error moves the beams, while cloud and scan are read as if the URDF were right.
        flatten: height band of the scan.
        client: of the simulation, whose walls and floor its engine's own caster looks at.
        watched: (W,) the bearings to which a sweep may be confined, by their scan indices; None for all.

    Attributes:
        caster: the ray caster, whose `trace` is the bare library call.

    Raises:
        ConfigError: an engine's caster got no client of that engine.
        RobotError: the lidar, where it is mounted, does not see walls beside the car.
    """

    def __init__(
        self,
        robot: RobotModel,
        config: LidarConfig,
        noise: NoiseConfig,
        flatten: FlattenConfig,
        client: object = None,
        watched: NDArray[np.intp] | None = None,
    ) -> None:
        check_sight(robot, config, flatten)
        self._config = config
        self._flatten_config = flatten
        self._directions = beam_directions(config)
        self._flattener = LevelFlattener(config, flatten)
        self._mount_xyz = np.asarray(robot.lidar_xyz_base)
        self._mount_rotation = rotation_from_rpy(*robot.lidar_rpy)
        self.disturb(noise)
        self._watched = watched
        channels = np.arange(0, len(self._directions), config.n_bearings)
        self._watched_beams = None if watched is None else np.add.outer(channels, watched).ravel()
        self.caster: RayCaster = make_caster(config.caster, self._directions, config.range_max_m, client)

    def set_world(self, world: World) -> None:
        """Look at this world from now on."""
        self.caster.set_world(world)

    def disturb(self, noise: NoiseConfig, dark_walls: DarkWalls | None = None) -> None:
        """Have these imperfections from now on, instead of those before; walls that give no return are one of them."""
        self._noise, self._dark_walls = NoiseModel(noise), dark_walls
        self._true_xyz = self._mount_xyz + noise.mount_xyz_m
        self._true_rotation = rotation_from_rpy(0.0, 0.0, noise.mount_yaw_rad) @ self._mount_rotation

    def scan(self, state: RobotState, rng: np.random.Generator, *, watched_only: bool = False) -> FlatScan:
        """Return the flattened scan of one `sweep`."""
        return self.flat(self.sweep(state, rng, watched_only=watched_only))

    def sweep(self, state: RobotState, rng: np.random.Generator, *, watched_only: bool = False) -> Sweep:
        """Cast the beams from `state`.

        Args:
            state: where the car stands.
            rng: draws the noise, if there is any, for every beam, cast or not.
            watched_only: cast the watched bearings alone. In them the scan is the same as if all were cast: tilted, a
                lidar sees into a bearing from its neighbours too, and then all are cast.
        """
        pose = state.pose
        base = (pose.x, pose.y, state.height_m)
        body = rotation_from_rpy(state.roll, state.pitch, pose.yaw)
        tilt = rotation_from_rpy(state.roll, state.pitch, 0.0)
        rotation_level = tilt @ self._mount_rotation
        height = state.height_m + float(tilt[2] @ self._mount_xyz)
        part = watched_only and _is_level(rotation_level)
        beams = self._watched_beams if part else None
        origin, rotation = base + body @ self._true_xyz, body @ self._true_rotation
        ranges = self.caster.cast(origin, rotation, beams)
        if self._dark_walls is not None:
            directions = self._directions if beams is None else self._directions[beams]
            ranges = self._dark_walls.apply(ranges, origin, directions @ rotation.T, self._config.range_max_m)
        return Sweep(self._with_noise(ranges, beams, rng), rotation_level, height, self._watched if part else None)

    def _with_noise(
        self, ranges_m: NDArray[np.float32], beams: NDArray[np.intp] | None, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        reach = self._config.range_max_m
        if beams is None or not self._noise.draws:
            return self._noise.apply(ranges_m, reach, rng)
        every = np.full(len(self._directions), reach, np.float32)
        every[beams] = ranges_m
        return self._noise.apply(every, reach, rng)[beams]

    def flat(self, sweep: Sweep) -> FlatScan:
        """Return the flattened scan of a sweep, about the lidar's origin, index 0 straight back of the car."""
        if _is_level(sweep.rotation_level):
            return self._flattener.flatten(sweep.ranges_m, sweep.height_m, sweep.bearings)
        return flatten_cloud(self.cloud(sweep), self._flatten_config, self._config.n_bearings, self._config.range_max_m)

    def cloud(self, sweep: Sweep) -> PointCloud:
        """Return the point cloud of a sweep, of the beams that were cast."""
        directions = self._directions if sweep.bearings is None else self._directions[self._watched_beams]
        return PointCloud(
            points_lidar=sweep.ranges_m[:, None] * directions,
            valid=sweep.ranges_m < self._config.range_max_m,
            rotation_level=sweep.rotation_level,
            height_m=sweep.height_m,
        )


def _is_level(rotation_level: NDArray[np.float64]) -> bool:
    """Return whether a rotation is closer to none at all than `LEVEL_TILT_RAD` about every axis."""
    return bool(np.abs(rotation_level - _LEVEL).max() < LEVEL_TILT_RAD)
