"""Ackermann geometry: what a command of the virtual centre wheel means for two knuckles and four wheels. Pure."""

import math
from dataclasses import dataclass

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import ActionError, RobotError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Command


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
    """Return the command within the limits of speed and steering.

    Raises:
        ActionError: a number is not finite.
    """
    v, delta = command.speed_mps, command.steering_rad
    if not (math.isfinite(v) and math.isfinite(delta)):
        raise ActionError(f"a command must be finite, got speed_mps={v}, steering_rad={delta}; nothing was simulated")
    v_max, delta_max = physics.max_speed_mps, physics.max_steering_rad
    return Command(min(max(v, -v_max), v_max), min(max(delta, -delta_max), delta_max))


def wheel_targets(command: Command, robot: RobotModel) -> WheelTargets:
    """Turn the rear-axle speed and the virtual steering angle into joint targets with which no wheel scrubs.

    All wheels roll on circles about one centre on the rear axle's line, at distance L / tan(delta) to the left.
    """
    half = robot.track_m / 2.0
    slope = math.tan(command.steering_rad)  # wheelbase over turning radius
    swing = slope * half / robot.wheelbase_m
    roll = command.speed_mps / robot.wheel_radius_m
    left, right = 1.0 - swing, 1.0 + swing
    return WheelTargets(
        (math.atan2(slope, left), math.atan2(slope, right)),
        (roll * left, roll * right, roll * math.hypot(left, slope), roll * math.hypot(right, slope)),
    )


def virtual_steering(left_rad: float, right_rad: float, robot: RobotModel) -> float:
    """Return the virtual centre-wheel angle of two knuckle angles, of the mean of the curvatures that each asks for."""
    half_over_base = robot.track_m / 2.0 / robot.wheelbase_m
    left, right = math.tan(left_rad), math.tan(right_rad)
    return math.atan(0.5 * (left / (1.0 + left * half_over_base) + right / (1.0 - right * half_over_base)))


def check_limits(robot: RobotModel, physics: PhysicsConfig) -> None:
    """Raise RobotError where full lock asks more of the inner knuckle than its hinge allows."""
    inner, _ = wheel_targets(Command(0.0, physics.max_steering_rad), robot).knuckle_rad
    if not 0.0 < inner <= robot.knuckle_limit_rad:
        raise RobotError(
            f"{robot.urdf_path}: steering by max_steering_rad {physics.max_steering_rad} turns the inner knuckle by "
            f"{inner:.3f} rad, its hinge allows {robot.knuckle_limit_rad}; widen the URDF's limit or steer less"
        )
