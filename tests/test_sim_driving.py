"""The car drives as Ackermann geometry says, in DIRECT physics."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pybullet
import pytest
import shapely
from boxes import box_world
from numpy.typing import NDArray

from zebrat_bullet.errors import ActionError, SimulationError
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import Command, Pose2, RobotState

SMALL_CAR = Path(__file__).parent / "data" / "small_car.urdf"
ORIGIN = Pose2(0.0, 0.0, 0.0)
Simulate = Callable[..., Simulation]


def drive(simulation: Simulation, command: Command, n_steps: int) -> list[RobotState]:
    return [simulation.step(command) for _ in range(n_steps)]


def rear_axle(states: list[RobotState], robot: RobotModel) -> NDArray[np.float64]:
    x = robot.rear_axle_x_m
    return np.array([(s.pose.x + x * math.cos(s.pose.yaw), s.pose.y + x * math.sin(s.pose.yaw)) for s in states])


def circle_radius(points: NDArray[np.float64]) -> float:
    """Return the least-squares circle's radius: x^2 + y^2 = 2 a x + 2 b y + (r^2 - a^2 - b^2)."""
    a, b, c = np.linalg.lstsq(np.column_stack([2 * points, np.ones(len(points))]), (points**2).sum(axis=1))[0]
    return math.sqrt(c + a * a + b * b)


@pytest.mark.parametrize("speed", [0.6, -0.6])
@pytest.mark.parametrize("steering", [0.6, -0.6])
def test_full_lock_drives_the_smallest_circle(
    simulate: Simulate, robot: RobotModel, speed: float, steering: float
) -> None:
    simulation = simulate()
    simulation.reset(ORIGIN)
    states = drive(simulation, Command(speed, steering), 60)[10:]
    assert circle_radius(rear_axle(states, robot)) == pytest.approx(0.819, rel=0.02)  # 0.56 / tan 0.6
    assert states[-1].steering_rad == pytest.approx(steering, abs=0.002)
    assert states[-1].speed_mps == pytest.approx(speed, rel=0.03)
    assert states[-1].yaw_rate_radps == pytest.approx(speed * math.tan(steering) / 0.56, rel=0.03)


@pytest.mark.parametrize("rate_hz", [80.0, 100.0, 120.0])
def test_ten_metres_straight_drift_under_two_centimetres(simulate: Simulate, rate_hz: float) -> None:
    simulation = simulate(rate_hz=rate_hz)
    simulation.reset(ORIGIN)
    states = drive(simulation, Command(0.6, 0.0), 85)
    assert states[-1].pose.x > 10.0
    assert max(abs(state.pose.y) for state in states) < 0.02
    assert max(abs(state.height_m) for state in states) < 0.002
    assert max(abs(state.roll) + abs(state.pitch) for state in states) < 0.005


@pytest.mark.parametrize("speed", [0.6, 0.2, -0.6])
def test_commanded_speed_is_reached(simulate: Simulate, speed: float) -> None:
    simulation = simulate()
    simulation.reset(Pose2(1.0, -2.0, 2.5))
    states = drive(simulation, Command(speed, 0.0), 10)
    assert states[-1].speed_mps == pytest.approx(speed, rel=0.03)
    step = math.hypot(states[-1].pose.x - states[-2].pose.x, states[-1].pose.y - states[-2].pose.y)
    assert step / 0.2 == pytest.approx(abs(speed), rel=0.03)
    assert states[-1].wheel_rad - states[-2].wheel_rad == pytest.approx(np.full(4, speed * 0.2 / 0.15), rel=0.03)


def test_left_and_right_are_mirror_images(simulate: Simulate) -> None:
    simulation = simulate()
    manoeuvre = [(0.6, 0.5)] * 15 + [(-0.4, -0.6)] * 10 + [(0.5, 0.1)] * 15
    ends = []
    for side in (1.0, -1.0):
        simulation.reset(ORIGIN)
        states = [simulation.step(Command(speed, side * steering)) for speed, steering in manoeuvre]
        ends.append([(s.pose.x, side * s.pose.y, side * s.pose.yaw, side * s.steering_rad) for s in states])
    np.testing.assert_allclose(ends[0], ends[1], atol=0.01)


@pytest.mark.parametrize("steering", [0.0, 0.3, -0.6])
def test_reversing_retraces_the_path(simulate: Simulate, robot: RobotModel, steering: float) -> None:
    simulation = simulate()
    start = simulation.reset(Pose2(0.5, 0.5, 1.0))
    drive(simulation, Command(0.0, steering), 5)
    forth = [start, *drive(simulation, Command(0.6, steering), 30), *drive(simulation, Command(0.0, steering), 5)]
    back = drive(simulation, Command(-0.6, steering), 30) + drive(simulation, Command(0.0, steering), 5)
    path = shapely.LineString(rear_axle(forth, robot))
    # Chords of 0.12 m cut the tightest circle by 0.12^2 / (8 * 0.819) = 2 mm.
    assert shapely.distance(shapely.points(rear_axle(back, robot)), path).max() < 0.015
    assert (back[-1].pose.x, back[-1].pose.y) == pytest.approx((0.5, 0.5), abs=0.03)
    assert back[-1].pose.yaw == pytest.approx(1.0, abs=0.03)


def test_a_smaller_car_drives_by_its_own_measures(simulate: Simulate) -> None:
    small = load_robot(SMALL_CAR)
    simulation = simulate(robot=small)
    simulation.reset(ORIGIN)
    states = drive(simulation, Command(0.4, 0.5), 60)[10:]
    assert circle_radius(rear_axle(states, small)) == pytest.approx(0.32 / math.tan(0.5), rel=0.02)
    assert states[-1].speed_mps == pytest.approx(0.4, rel=0.03)
    simulation.reset(ORIGIN)
    assert abs(drive(simulation, Command(0.6, 0.0), 85)[-1].pose.y) < 0.02


def test_reset_stands_at_the_pose_with_straight_wheels(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.reset(ORIGIN)
    drive(simulation, Command(0.6, 0.6), 10)
    state = simulation.reset(Pose2(3.0, -2.0, -1.2))
    assert (state.pose.x, state.pose.y, state.pose.yaw) == pytest.approx((3.0, -2.0, -1.2))
    assert (state.height_m, state.roll, state.pitch) == pytest.approx((0.0, 0.0, 0.0))
    assert (state.speed_mps, state.yaw_rate_radps, state.steering_rad) == (0.0, 0.0, 0.0)
    rest = drive(simulation, Command(0.0, 0.0), 20)[-1]
    assert (rest.pose.x, rest.pose.y, rest.pose.yaw) == pytest.approx((3.0, -2.0, -1.2), abs=3e-3)


def test_commands_beyond_the_limits_drive_like_the_limits(simulate: Simulate) -> None:
    simulation = simulate()
    poses = []
    for command in (Command(0.6, -0.6), Command(50.0, -7.0)):
        simulation.reset(ORIGIN)
        poses.append(drive(simulation, command, 10)[-1].pose)
    assert poses[0] == poses[1]


def test_a_command_that_is_not_finite_moves_nothing(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.reset(ORIGIN)
    before = drive(simulation, Command(0.6, 0.3), 5)[-1]
    with pytest.raises(ActionError):
        simulation.step(Command(math.nan, 0.0))
    after = simulation.step(Command(0.6, 0.3)).pose
    assert 0.1 < math.hypot(after.x - before.pose.x, after.y - before.pose.y) < 0.13


def test_a_state_that_is_not_finite_stops_the_run_and_a_new_world_mends_it(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.reset(ORIGIN)
    nan = (math.nan, 0.0, 0.0)
    pybullet.resetBaseVelocity(simulation.car_id, nan, nan, physicsClientId=simulation.client_id)
    with pytest.raises(SimulationError, match="lost the car"):
        simulation.step(Command(0.6, 0.0))
    simulation.set_world(box_world())
    simulation.reset(ORIGIN)
    assert drive(simulation, Command(0.6, 0.0), 10)[-1].speed_mps == pytest.approx(0.6, rel=0.03)


def test_a_start_pose_that_is_not_finite_is_refused(simulate: Simulate) -> None:
    simulation = simulate()
    with pytest.raises(SimulationError, match="finite"):
        simulation.reset(Pose2(0.0, math.nan, 0.0))
    assert simulation.reset(ORIGIN).pose == ORIGIN
