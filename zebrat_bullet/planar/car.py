"""The numbers of a planar car, as kernels want them: read from the robot, its senses and its physics, none typed."""

import math
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from zebrat_bullet.config import LidarConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planar.kernels import CarData
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_bearings, beam_elevations

NEAR_M = 0.2
"""Walls farther from the outline than this are looked for anew: a car moves about so far in a control step."""
N_BUCKETS = 512
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
        rays: (B, 3) float32, direction of each ray in the lidar's frame, and its place in the order of bearings.
        first_ray: (N_BUCKETS,) int32, first ray that can lie in each part of the bearings.
        channels: (N_CHANNEL_SLOTS,) float32, how many lidar channels meet a wall at each part of the reach.
        circumradius_m: of the outline about the base frame's origin.
    """

    data: CarData
    corners: NDArray[np.float32]
    sides: NDArray[np.float32]
    rays: NDArray[np.float32]
    first_ray: NDArray[np.int32]
    channels: NDArray[np.float32]
    circumradius_m: float


def planar_car(robot: RobotModel, task: TaskConfig, indices: NDArray[np.intp], margin_m: float = 0.0) -> PlanarCar:
    """Return the numbers of a car that looks along the bearings of these ascending scan indices.

    Args:
        robot: the car.
        task: its physics and senses.
        indices: (B,) where it looks.
        margin_m: walls so near to the outline count as touched.

    Raises:
        ConfigError: some range of a wall is met by no lidar channel within the height band, or the margin is too wide.
    """
    if not 0.0 <= margin_m < NEAR_M:
        raise ConfigError(f"margin_m must be in [0, {NEAR_M}), got {margin_m}")
    physics, lidar, noise = task.physics, task.lidar, task.noise
    outline = np.asarray(robot.footprint_base)
    along = np.roll(outline, -1, axis=0) - outline
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    bearings = beam_bearings(lidar.n_bearings)[indices]
    directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    order = bearing_order(directions)
    order[bearings <= -math.pi + 1e-9] = -2.0
    channels, reach = _channels(robot, task)
    data = CarData()
    data.dt, data.n_substeps = 1.0 / physics.rate_hz, physics.n_substeps
    data.wheelbase, data.half_track, data.axle_x = robot.wheelbase_m, robot.track_m / 2, robot.rear_axle_x_m
    data.farthest = float(np.hypot(*(outline - (robot.rear_axle_x_m, 0.0)).T).max())
    data.n_corners = len(outline)
    data.inverse_mass = 1.0 / (MASS_FACTOR * robot.rolling_mass_kg)
    data.inverse_inertia = 1.0 / (INERTIA_FACTOR * robot.yaw_inertia_kgm2)
    data.motor_impulse = robot.wheel_effort_nm / robot.wheel_radius_m / physics.rate_hz
    data.grip_impulse = GRIP * robot.weight_n / 4.0 / physics.rate_hz
    data.hinge_step = robot.hinge_speed_radps / physics.rate_hz
    data.margin, data.near = margin_m, NEAR_M
    data.lidar_x = float(robot.lidar_xyz_base[0]) + noise.mount_xyz_m[0]
    data.lidar_y = float(robot.lidar_xyz_base[1]) + noise.mount_xyz_m[1]
    data.lidar_yaw = noise.mount_yaw_rad
    data.reach, data.horizon = lidar.range_max_m, reach
    data.n_rays, data.n_buckets = len(indices), N_BUCKETS
    data.sigma, data.dropout = noise.range_sigma_m, noise.dropout
    begins = -2.0 + 4.0 * np.arange(N_BUCKETS) / N_BUCKETS
    return PlanarCar(
        data=data,
        corners=outline.astype(np.float32),
        sides=np.column_stack([normals, (normals * outline).sum(axis=1)]).astype(np.float32),
        rays=np.column_stack([directions, order]).astype(np.float32),
        first_ray=np.searchsorted(order, begins - 1e-5).astype(np.int32),
        channels=channels,
        circumradius_m=float(np.hypot(*outline.T).max()),
    )


def bearing_order(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a number in [-2, 2] that grows with the bearing of each of (P, 2) points, as the kernel computes it."""
    x, y = points.T
    beside = 1.0 - x / (np.abs(x) + np.abs(y))
    return np.where(y < 0.0, -beside, beside)


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
    if (n[ranges < farthest] == 0).any():
        raise ConfigError(
            f"at {ranges[n == 0][0]:.2f} m no lidar channel meets a wall of {WALL_M} m within the height band, so the "
            "planar car would see what this lidar does not; change lidar or flatten, or use PyBullet"
        )
    return np.maximum(n, 1).astype(np.float32), farthest


def _horizon(lidar: LidarConfig, height: float, low: float, high: float) -> float:
    """Return the greatest horizontal range in m from which some channel returns a wall that fills the band."""
    elevations = beam_elevations(lidar)
    ranges = lidar.range_max_m * np.cos(elevations)
    at = height + ranges * np.tan(elevations)
    seen = ranges[(at >= low) & (at <= high)]
    return float(seen.max(initial=0.0))


def to_device(values: NDArray, dtype: type, device: str) -> wp.array:
    """Return a copy of an array on a device."""
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)
