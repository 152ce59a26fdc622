"""The numbers of a planar car, as kernels want them: read from the robot, its senses and its physics, none typed."""

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from zebrat_bullet.config import LidarConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planar.kernels.data import CarData
from zebrat_bullet.planar.kernels.look import N_RAYS_ABREAST
from zebrat_bullet.planar.margins import NEAR_M
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_bearings, beam_elevations
from zebrat_bullet.sensing.flatten import LEVEL_TILT_RAD
from zebrat_bullet.sensing.sight import check_sight

N_CHANNEL_SLOTS = 256
WALL_M = 0.8
"""Lowest wall of a world that the planar car takes; the height band sees it whole."""
MASS_FACTOR, INERTIA_FACTOR, GRIP = 1.005, 1.12, 0.48
"""What Bullet's contact solver makes of mass, inertia and friction, fitted to its motion at 120 Hz, 20 iterations."""
ROLLING = 0.998
"""How much of a wheel's radius it rolls on: Bullet's contacts let it stand 0.3 mm deep in the floor."""


@dataclass(frozen=True)
class PlanarCar:
    """One car as arrays.

    Attributes:
        data: scalars for the kernels.
        corners: (K, 2) float32, m, base frame, counter-clockwise.
        sides: (K, 3) float32, outward normal of each side and its distance from the base frame's origin.
        rays: (R, 2) float32, direction of each ray in the lidar's frame, then zeros up to a multiple of N_RAYS_ABREAST.
        channels: (N_CHANNEL_SLOTS,) float32, how many lidar channels meet a wall at each part of the reach.
        circumradius_m: of the outline about the base frame's origin.
    """

    data: CarData
    corners: NDArray[np.float32]
    sides: NDArray[np.float32]
    rays: NDArray[np.float32]
    channels: NDArray[np.float32]
    circumradius_m: float


def planar_car(robot: RobotModel, task: TaskConfig, indices: NDArray[np.intp]) -> PlanarCar:
    """Return the numbers of a car that looks along the bearings of these ascending scan indices.

    Args:
        robot: the car.
        task: its physics and senses.
        indices: (B,) where it looks.

    Raises:
        ConfigError: some range of a wall is met by no lidar channel within the height band, the lidar is mounted at a
            tilt.
    """
    if np.abs(robot.lidar_rpy[:2]).max() > LEVEL_TILT_RAD:
        raise ConfigError(
            f"{robot.urdf_path}: the lidar is mounted with roll and pitch {robot.lidar_rpy[:2].round(4).tolist()} rad, "
            "and a plane has neither; mount it level, or use PyBullet"
        )
    check_sight(robot, task.lidar, task.flatten)
    physics, lidar, noise = task.physics, task.lidar, task.noise
    outline = np.asarray(robot.footprint_base)
    along = np.roll(outline, -1, axis=0) - outline
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    bearings = beam_bearings(lidar.n_bearings)[indices]
    directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    channels, reach = _channels(robot, task)
    data = CarData()
    data.dt, data.n_substeps = 1.0 / physics.rate_hz, physics.n_substeps
    data.wheelbase, data.half_track, data.axle_x = robot.wheelbase_m, robot.track_m / 2, robot.rear_axle_x_m
    data.half_hinges, data.beside = robot.hinge_track_m / 2, robot.hinge_offset_m
    least_radius, greatest_radius = sorted((robot.wheel_radius_m, robot.front_radius_m))
    data.top = min(robot.wheel_speed_radps * least_radius, 1e6)
    data.farthest = float(np.hypot(*(outline - (robot.rear_axle_x_m, 0.0)).T).max())
    data.n_corners = len(outline)
    data.inverse_mass = 1.0 / (MASS_FACTOR * robot.rolling_mass_kg)
    data.inverse_inertia = 1.0 / (INERTIA_FACTOR * robot.yaw_inertia_kgm2)
    data.motor_impulse = robot.wheel_effort_nm / greatest_radius / physics.rate_hz
    data.grip_impulse = GRIP * robot.weight_n / 4.0 / physics.rate_hz
    data.hinge_step = robot.hinge_speed_radps / physics.rate_hz
    data.near = NEAR_M
    data.lidar_x = float(robot.lidar_xyz_base[0]) + noise.mount_xyz_m[0]
    data.lidar_y = float(robot.lidar_xyz_base[1]) + noise.mount_xyz_m[1]
    data.lidar_yaw = noise.mount_yaw_rad
    data.reach, data.horizon = lidar.range_max_m, reach
    data.n_rays = len(indices)
    data.sigma, data.dropout = noise.range_sigma_m, noise.dropout
    return PlanarCar(
        data=data,
        corners=outline.astype(np.float32),
        sides=np.column_stack([normals, (normals * outline).sum(axis=1)]).astype(np.float32),
        rays=np.pad(directions, ((0, -len(directions) % N_RAYS_ABREAST), (0, 0))).astype(np.float32),
        channels=channels,
        circumradius_m=float(np.hypot(*outline.T).max()),
    )


def _channels(robot: RobotModel, task: TaskConfig) -> tuple[NDArray[np.float32], float]:
    """Return how many channels return a wall of `WALL_M` from each part of the reach, and the farthest such range in m.

    Raises:
        ConfigError: within that range some part is met by none.
    """
    lidar, height = task.lidar, float(robot.lidar_xyz_base[2])
    band = task.flatten
    elevations = beam_elevations(lidar)
    ranges = (np.arange(N_CHANNEL_SLOTS) + 0.5) / N_CHANNEL_SLOTS * lidar.range_max_m
    at = height + ranges[:, None] * np.tan(elevations)
    meets = (at >= band.height_min_m) & (at <= min(band.height_max_m, WALL_M))
    meets &= ranges[:, None] <= lidar.range_max_m * np.cos(elevations)
    n = meets.sum(axis=1)
    farthest = _horizon(lidar, height, band.height_min_m, min(band.height_max_m, WALL_M))
    unseen = (n == 0) & ((ranges < farthest) | (farthest == 0.0))
    if unseen.any():
        raise ConfigError(
            f"at {ranges[unseen][0]:.2f} m no lidar channel meets a wall of {WALL_M} m within the height band, so the "
            "planar car would see what this lidar does not; change lidar or flatten, or use PyBullet"
        )
    return np.maximum(n, 1).astype(np.float32), farthest


def _horizon(lidar: LidarConfig, height: float, low: float, high: float) -> float:
    """Return the greatest horizontal range in m from which some channel returns a wall that fills the band; 0 if none.

    A channel meets the band from where it comes into it, until it leaves it or its reach ends.
    """
    elevations = beam_elevations(lidar)
    slopes = np.where(np.abs(elevations) < 1e-12, 1e-12, np.tan(elevations))
    into, out = np.sort([(low - height) / slopes, (high - height) / slopes], axis=0)
    last = np.minimum(out, lidar.range_max_m * np.cos(elevations))
    return float(last[last >= np.maximum(into, 0.0)].max(initial=0.0))


def to_device(values: NDArray, dtype: type, device: str) -> wp.array:
    """Return a copy of an array on a device."""
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)
