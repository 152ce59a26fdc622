"""The numbers of a car that whoever drives it needs, without its URDF."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from zebrat_bullet.errors import ConfigError

if TYPE_CHECKING:
    from zebrat_bullet.config import PhysicsConfig
    from zebrat_bullet.robot import RobotModel


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

    Raises:
        ConfigError: a number is not finite, or no car has it.
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


GRIP = 0.44
"""Share of a wheel's load that it brakes with while the front wheels are turned, as measured of PyBullet's cars."""


def car_of(robot: "RobotModel", physics: "PhysicsConfig") -> Car:
    """Return the car that a URDF describes, with the limits of a task (`robot.fitted`).

    It brakes as its four wheel motors and their grip can at full lock, where braking has to end its turning too and
    takes longest. A rear wheel rolls as far as the axle's middle, a front wheel farther by 1 / cos(steering).
    """
    force_n = min(robot.wheel_effort_nm / max(robot.wheel_radius_m, robot.front_radius_m), GRIP * robot.weight_n / 4.0)
    lock = physics.max_steering_rad
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
    )
