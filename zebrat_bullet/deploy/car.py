"""The numbers of a car that whoever drives it needs, without its URDF."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown

if TYPE_CHECKING:
    from zebrat_bullet.config import PhysicsConfig
    from zebrat_bullet.robot import RobotModel


_TOLERANCE = 1e-3
"""In m, rad and m/s: a millimetre."""
_COMPARED = (
    "lidar_xyz_base",
    "lidar_rotation_base",
    "wheelbase_m",
    "rear_axle_x_m",
    "max_speed_mps",
    "max_steering_rad",
)
LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class Car:
    """A car-like robot in m, s and rad; base frame: on the floor, x forward, y left.

    Attributes:
        name: of the robot.
        outline_base: (K, 2) convex outline of the body, counter-clockwise.
        lidar_xyz_base: position of the lidar.
        wheelbase_m: rear to front axle.
        rear_axle_x_m: x of the rear axle.
        max_speed_mps, max_steering_rad: limits of a command.
        steering_rate_radps: how fast the steering turns.
        deceleration_mps2: how hard the car brakes.
        lidar_rotation_base: (3, 3) turns vectors of the lidar as it is mounted into the base frame.

    Raises:
        ConfigError: a number is not finite, or no car has it; or the rotation is none.
    """

    name: str
    outline_base: tuple[tuple[float, float], ...]
    lidar_xyz_base: tuple[float, float, float]
    wheelbase_m: float
    rear_axle_x_m: float
    max_speed_mps: float
    max_steering_rad: float
    steering_rate_radps: float
    deceleration_mps2: float
    lidar_rotation_base: tuple[tuple[float, ...], ...] = LEVEL

    def __post_init__(self) -> None:
        object.__setattr__(self, "outline_base", tuple(tuple(corner) for corner in self.outline_base))
        object.__setattr__(self, "lidar_xyz_base", tuple(self.lidar_xyz_base))
        if len(self.outline_base) < 3 or any(len(corner) != 2 for corner in self.outline_base):
            raise ConfigError(f"outline_base must be three corners (x, y) or more, got {self.outline_base}")
        if len(self.lidar_xyz_base) != 3:
            raise ConfigError(f"lidar_xyz_base must be (x, y, z), got {self.lidar_xyz_base}")
        numbers = [*sum(self.outline_base, ()), *self.lidar_xyz_base, self.rear_axle_x_m]
        if not all(map(math.isfinite, numbers)):
            raise ConfigError(f"a car's numbers must be finite, got {numbers}")
        above_0 = ("wheelbase_m", "max_speed_mps", "max_steering_rad", "steering_rate_radps", "deceleration_mps2")
        for name in above_0:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigError(f"{name} must be a finite number above 0, got {value}")
        rows = tuple(tuple(map(float, row)) for row in self.lidar_rotation_base)
        object.__setattr__(self, "lidar_rotation_base", rows)
        orthonormal = [len(row) for row in rows] == [3, 3, 3] and all(
            abs(sum(a * b for a, b in zip(rows[i], rows[j], strict=True)) - (i == j)) < 1e-6
            for i in range(3)
            for j in range(3)
        )
        if not orthonormal:
            raise ConfigError(f"lidar_rotation_base is no rotation: {shown(rows)}")


GRIP = 0.44
"""Share of a wheel's load that it brakes with while the front wheels are turned, as measured of PyBullet's cars."""


def car_of(robot: "RobotModel", physics: "PhysicsConfig") -> Car:
    """Return the car that a URDF describes, with the limits of a task (`robot.fitted`).

    It brakes as its four wheel motors and their grip can at full lock, where braking has to end its turning too and
    takes longest. A rear wheel rolls as far as the axle's middle, a front wheel farther by 1 / cos(steering).
    """
    from zebrat_bullet.geometry import rotation_from_rpy  # needs more than a robot has installed

    force_n = min(robot.wheel_effort_nm / max(robot.wheel_radius_m, robot.front_radius_m), GRIP * robot.weight_n / 4.0)
    lock = physics.max_steering_rad
    mount = rotation_from_rpy(*map(float, robot.lidar_rpy))
    mass_kg = robot.rolling_mass_kg + robot.yaw_inertia_kgm2 * (math.tan(lock) / robot.wheelbase_m) ** 2
    return Car(
        name=robot.source,
        outline_base=tuple((float(x), float(y)) for x, y in robot.footprint_base),
        lidar_xyz_base=tuple(map(float, robot.lidar_xyz_base)),  # type: ignore[arg-type]
        wheelbase_m=robot.wheelbase_m,
        rear_axle_x_m=robot.rear_axle_x_m,
        max_speed_mps=physics.max_speed_mps,
        max_steering_rad=lock,
        steering_rate_radps=robot.hinge_speed_radps,
        deceleration_mps2=force_n * (2.0 + 2.0 / math.cos(lock)) / mass_kg,
        lidar_rotation_base=tuple(map(tuple, (mount + 0.0).tolist())),  # no -0.0
    )


def differences(car: Car, trained: Car) -> list[str]:
    """Return in what a car differs from the one that a policy was trained for; how it brakes a policy does not know."""
    outlines = np.array(car.outline_base), np.array(trained.outline_base)
    same = outlines[0].shape == outlines[1].shape and _same_outline(*outlines)
    return ([] if same else [f"outline_base {car.outline_base} instead of {trained.outline_base}"]) + [
        f"{name} {getattr(car, name)} instead of {getattr(trained, name)}"
        for name in _COMPARED
        if not np.allclose(getattr(car, name), getattr(trained, name), rtol=0.0, atol=_TOLERANCE)
    ]


def _same_outline(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Return whether two outlines of K corners are one, wherever each begins."""
    turned = (np.roll(one, i, axis=0) for i in range(len(one)))
    return any(np.allclose(corners, other, rtol=0.0, atol=_TOLERANCE) for corners in turned)
