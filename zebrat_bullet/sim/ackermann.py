"""Ackermann geometry: what a command of the virtual centre wheel means for two knuckles and four wheels. Pure."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import ActionError
from zebrat_bullet.files import shown
from zebrat_bullet.types import Command

if TYPE_CHECKING:  # the robot's reader needs much that a driver's commands do not
    from zebrat_bullet.robot import RobotModel


@dataclass(frozen=True, slots=True)
class WheelTargets:
    """Joint targets of one command.

    Attributes:
        knuckle_rad: left and right steering hinge.
        wheel_radps: rolling speeds of rear-left, rear-right, front-left, front-right wheel.
    """

    knuckle_rad: tuple[float, float]
    wheel_radps: tuple[float, float, float, float]


def clip_command(command: Command, physics: PhysicsConfig) -> Command:
    """Return the command within the limits of speed and steering, as `in_floats`.

    Raises:
        ActionError: a number is not finite.
    """
    command = in_floats(command)
    v_max, delta_max = physics.max_speed_mps, physics.max_steering_rad
    v, delta = command.speed_mps, command.steering_rad
    return Command(min(max(v, -v_max), v_max), min(max(delta, -delta_max), delta_max))


def in_floats(command: Command) -> Command:
    """Return the command in Python's own numbers, whatever a driver's are: in single precision none would replay.

    Raises:
        ActionError: speed or steering is not one finite number.
    """
    v, delta = _float(command.speed_mps), _float(command.steering_rad)
    if not (math.isfinite(v) and math.isfinite(delta)):
        got = f"speed_mps={shown(repr(command.speed_mps))}, steering_rad={shown(repr(command.steering_rad))}"
        raise ActionError(f"a command must be finite numbers, got {got}; nothing was simulated")
    return Command(v, delta)


def _float(given: Any) -> float:
    """Return a driver's number (NumPy's, torch's) as Python's own, nan for what is none."""
    if isinstance(given, str | bytes) or getattr(given, "ndim", 0) != 0:
        return math.nan
    try:
        return float(given)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def wheel_targets(command: Command, robot: "RobotModel") -> WheelTargets:
    """Turn the rear-axle speed and the virtual steering angle into joint targets with which no wheel scrubs.

    All wheels roll on circles about one centre on the rear axle's line, at distance L / tan(delta) to the left. Where a
    wheel would turn faster than its motor can, all turn so much slower.
    """
    slope = math.tan(command.steering_rad)  # wheelbase over turning radius
    swing = slope * (robot.track_m / 2.0) / robot.wheelbase_m
    turn = slope * (robot.hinge_track_m / 2.0) / robot.wheelbase_m
    beside = slope * robot.hinge_offset_m / robot.wheelbase_m
    left, right = 1.0 - turn, 1.0 + turn
    rear, front = command.speed_mps / robot.wheel_radius_m, command.speed_mps / robot.front_radius_m
    wheels = (
        rear * (1.0 - swing),
        rear * (1.0 + swing),
        front * (math.hypot(left, slope) - beside),
        front * (math.hypot(right, slope) + beside),
    )
    fastest = max(map(abs, wheels))
    if fastest > robot.wheel_speed_radps:
        slower = robot.wheel_speed_radps / fastest
        wheels = (wheels[0] * slower, wheels[1] * slower, wheels[2] * slower, wheels[3] * slower)
    return WheelTargets((math.atan2(slope, left), math.atan2(slope, right)), wheels)


def virtual_steering(left_rad: float, right_rad: float, robot: "RobotModel") -> float:
    """Return the virtual centre-wheel angle of two knuckle angles, of the mean of the curvatures that each asks for."""
    half_over_base = robot.hinge_track_m / 2.0 / robot.wheelbase_m
    left, right = math.tan(left_rad), math.tan(right_rad)
    return math.atan(0.5 * (left / (1.0 + left * half_over_base) + right / (1.0 - right * half_over_base)))
