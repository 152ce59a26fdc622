"""Ackermann geometry, by hand for ZebraT: wheelbase 0.56 m, track 0.49 m, wheels of 0.15 m."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import ActionError
from zebrat_bullet.robot import load_robot, within_limits
from zebrat_bullet.sim.ackermann import clip_command, virtual_steering, wheel_targets
from zebrat_bullet.types import Command

ROBOT = load_robot("zebrat")
commands = st.builds(Command, st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))


def test_straight_wheels_roll_alike() -> None:
    targets = wheel_targets(Command(0.3, 0.0), ROBOT)
    assert targets.knuckle_rad == (0.0, 0.0)
    assert targets.wheel_radps == pytest.approx((2.0, 2.0, 2.0, 2.0))  # 0.3 m/s over 0.15 m


def test_full_lock_to_the_left() -> None:
    targets = wheel_targets(Command(0.6, 0.6), ROBOT)
    radius = 0.56 / math.tan(0.6)
    assert radius == pytest.approx(0.8185, abs=1e-4)
    # Left wheels are inside: their circles are smaller by half the track, so they steer more and roll slower.
    assert targets.knuckle_rad == pytest.approx((math.atan(0.56 / 0.5735), math.atan(0.56 / 1.0635)), abs=1e-4)
    yaw_rate = 0.6 / radius
    circles = (0.5735, 1.0635, math.hypot(0.5735, 0.56), math.hypot(1.0635, 0.56))
    assert targets.wheel_radps == pytest.approx([yaw_rate * circle / 0.15 for circle in circles], abs=1e-3)


@given(commands)
def test_right_is_the_mirror_of_left(command: Command) -> None:
    left = wheel_targets(command, ROBOT)
    right = wheel_targets(Command(command.speed_mps, -command.steering_rad), ROBOT)
    assert right.knuckle_rad == pytest.approx((-left.knuckle_rad[1], -left.knuckle_rad[0]))
    rear_left, rear_right, front_left, front_right = left.wheel_radps
    assert right.wheel_radps == pytest.approx((rear_right, rear_left, front_right, front_left))


@given(commands)
def test_the_knuckles_give_back_the_steering(command: Command) -> None:
    assert virtual_steering(*wheel_targets(command, ROBOT).knuckle_rad, ROBOT) == pytest.approx(command.steering_rad)


def test_commands_are_clipped_to_the_limits() -> None:
    assert clip_command(Command(9.0, -9.0), PhysicsConfig()) == Command(0.6, -0.6)
    assert clip_command(Command(-0.1, 0.2), PhysicsConfig()) == Command(-0.1, 0.2)


def test_a_clipped_command_holds_floats_whatever_a_driver_counts_in() -> None:
    clipped = clip_command(Command(np.float32(0.6), np.array(0)), PhysicsConfig())
    assert clipped == Command(0.6, 0.0) and type(clipped.speed_mps) is type(clipped.steering_rad) is float


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, "0.3", None, np.array([0.3])])
def test_commands_that_are_not_finite_are_refused(bad: object) -> None:
    for command in (Command(bad, 0.0), Command(0.0, bad)):
        with pytest.raises(ActionError, match="finite"):
            clip_command(command, PhysicsConfig())


@pytest.mark.parametrize("steering", [0.7, 1.3])
def test_steering_is_no_wider_than_the_hinges_allow(steering: float) -> None:
    lock = within_limits(PhysicsConfig(max_steering_rad=steering), ROBOT).max_steering_rad
    inner, _ = wheel_targets(Command(0.0, lock), ROBOT).knuckle_rad
    assert inner == pytest.approx(0.85, abs=1e-6) and inner <= 0.85


def test_no_wheel_is_asked_to_turn_faster_than_its_motor_can() -> None:
    slow = replace(ROBOT, wheel_speed_radps=2.0)
    free, held = (wheel_targets(Command(0.6, 0.5), robot).wheel_radps for robot in (ROBOT, slow))
    assert max(held) == pytest.approx(2.0)
    np.testing.assert_allclose(np.array(held) / held[0], np.array(free) / free[0])  # the same circle
