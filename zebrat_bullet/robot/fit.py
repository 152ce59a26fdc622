"""A task as this car can do it: limits from its URDF where they are lower than the task's."""

import math
from dataclasses import replace

from zebrat_bullet.config import PhysicsConfig, TaskConfig
from zebrat_bullet.robot.load import load_robot
from zebrat_bullet.robot.model import RobotModel

_WITHIN = 1.0 - 1e-9
_MOST_SWING = 0.9
"""The turning centre stays so far outside of the hinges: half their track over the turning radius."""


def fitted(task: TaskConfig) -> TaskConfig:
    """Return the task with its car named for any folder, and with speed and steering that the car can do.

    Raises:
        AssetError, RobotError: there is no such car, or it cannot be driven.
    """
    robot = load_robot(task.robot)
    return replace(task, robot=robot.source, physics=within_limits(task.physics, robot))


def within_limits(physics: PhysicsConfig, robot: RobotModel) -> PhysicsConfig:
    """Return the physics with limits of speed and steering that are no greater than the car's own."""
    speed = min(physics.max_speed_mps, robot.wheel_speed_radps * min(robot.wheel_radius_m, robot.front_radius_m))
    steering = min(physics.max_steering_rad, most_steering_rad(robot))
    return replace(physics, max_speed_mps=speed, max_steering_rad=steering)


def most_steering_rad(robot: RobotModel) -> float:
    """Return the angle of the virtual centre wheel at which the inner knuckle reaches its limit."""
    half_over_base = robot.hinge_track_m / 2.0 / robot.wheelbase_m
    inner = math.tan(robot.knuckle_limit_rad)
    slope = min(inner / (1.0 + inner * half_over_base), _MOST_SWING / half_over_base)
    return math.atan(slope) * _WITHIN
