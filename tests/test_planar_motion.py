"""Planar cars drive as Ackermann geometry and the motors' torque say, and as PyBullet's car does."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from planar_cars import AS_BUILT, FIELD, drive, planar, stand

from zebrat_bullet.config import DynamicsConfig, EpisodeConfig, LidarConfig, PhysicsConfig, TaskConfig
from zebrat_bullet.planar.car import ROLLING
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command, Commands, Dynamics, Pose2

OPEN = EpisodeConfig(open_width_m=20.0)


def run(
    commands: list[tuple[float, float]], *, dynamics: object = AS_BUILT, step_s: float = 0.2
) -> NDArray[np.float64]:
    """Drive one car from the origin and return its (T + 1, 3) poses."""
    sim = planar(FIELD, task=TaskConfig(physics=PhysicsConfig(control_step_s=step_s)), indices=np.array([0]))
    stand(sim, (0.0, 0.0, 0.0), dynamics=dynamics)
    return drive(sim, commands)[:, 0]


def test_ten_metres_straight_at_twelve_centimetres_a_step() -> None:
    poses = run([(0.6, 0.0)] * 90)
    assert np.diff(poses[10:, 0]) == pytest.approx(0.12 * ROLLING, abs=2e-5)
    assert np.abs(poses[:, 1:]).max() < 1e-4 and poses[-1, 0] > 10.0


@pytest.mark.parametrize("speed", [0.6, -0.6])
@pytest.mark.parametrize("steering", [0.6, -0.6])
def test_full_lock_drives_the_smallest_circle(robot: RobotModel, speed: float, steering: float) -> None:
    poses = run([(speed, steering)] * 60)[15:]
    axle = poses[:, :2] + robot.rear_axle_x_m * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    (a, b, c), *_ = np.linalg.lstsq(np.column_stack([2 * axle, np.ones(len(axle))]), (axle**2).sum(axis=1))
    assert math.sqrt(c + a * a + b * b) == pytest.approx(0.56 / math.tan(0.6), rel=0.01)  # 0.819 m
    assert np.diff(poses[:, 2]) == pytest.approx(0.2 * speed * math.tan(steering) / 0.56, rel=0.02)


def test_left_and_right_are_mirror_images() -> None:
    manoeuvre = np.array([(0.6, 0.5)] * 15 + [(-0.4, -0.6)] * 10 + [(0.5, 0.1)] * 15)
    left, right = run(manoeuvre), run(manoeuvre * (1, -1))
    # As in Bullet, the solver meets the left wheels first.
    np.testing.assert_allclose(left, right * (1, -1, -1), atol=5e-3)


def test_a_rotated_and_shifted_start_drives_the_same_path(robot: RobotModel) -> None:
    sim = planar(FIELD, 2, indices=np.array([0]))
    stand(sim, [(0.0, 0.0, 0.0), (3.0, -2.0, 2.0)])
    here, there = np.moveaxis(drive(sim, [(0.6, 0.4)] * 20 + [(-0.6, -0.2)] * 10), 1, 0)
    c, s = math.cos(2.0), math.sin(2.0)
    turned = np.stack([3.0 + c * here[:, 0] - s * here[:, 1], -2.0 + s * here[:, 0] + c * here[:, 1]], axis=1)
    np.testing.assert_allclose(there[:, :2], turned, atol=1e-4)
    np.testing.assert_allclose(there[:, 2], here[:, 2] + 2.0, atol=1e-4)


def test_a_car_placed_anew_remembers_nothing() -> None:
    commands = [(0.6, 0.3)] * 5 + [(-0.3, -0.6)] * 5
    sim = planar(FIELD, indices=np.array([0]))
    paths = []
    for _ in range(2):
        stand(sim, (1.0, 2.0, 0.5))
        paths.append(drive(sim, commands))
        stand(sim, (0.0, 0.0, 0.0), dynamics=(0.5, 0.5, 0.2, 0.7, 0.2))
        drive(sim, [(0.6, -0.6)] * 7)
    assert np.array_equal(*paths)


def test_cars_do_not_touch_each_other() -> None:
    """Two hundred cars on one spot, each with commands of its own, drive as each would alone."""
    commands = np.random.default_rng(0).uniform(-0.6, 0.6, (12, 200, 2))
    sim = planar(FIELD, 200, indices=np.array([0]))
    stand(sim, (0.0, 0.0, 0.0))
    together = drive(sim, commands)
    for car in (0, 77, 199):
        assert np.array_equal(together[:, car], run(commands[:, car]))


@pytest.fixture(params=["planar", "bullet"])
def speeds(request: pytest.FixtureRequest) -> Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Drives one car under a `DynamicsConfig`: its speeds in m/s and yaw rates in rad/s after each control step."""

    def of(config: DynamicsConfig, commands: list[tuple[float, float]]) -> tuple[NDArray, NDArray]:
        task = TaskConfig(lidar=LidarConfig(caster="embree", n_channels=1, n_bearings=8), dynamics=config, episode=OPEN)
        if request.param == "planar":
            task = TaskConfig(dynamics=config, episode=OPEN)
            many = PlanarDrive(task, [FIELD], 1)
            rows = []
            for v, delta in commands:
                many.follow(Commands(np.float32([v]), np.float32([delta])))
                rows.append(many.sim.motion[0, 2:].copy())
            return tuple(np.array(rows).T)
        one = Drive(task, FIELD)
        one.reset(np.random.default_rng(0))
        states = [one.step(Command(*command)) and one.state for command in commands]
        one.close()
        return np.array([s.speed_mps for s in states]), np.array([s.yaw_rate_radps for s in states])

    return of


def test_half_the_torque_is_half_the_acceleration(speeds) -> None:
    """Four wheels of 15 Nm and 0.15 m radius push 111.83 kg, spin included, with 400 N."""
    v, _ = speeds(DynamicsConfig(acceleration=(0.5, 0.5)), [(0.6, 0.0), (-0.6, 0.0)])
    assert v[0] == pytest.approx(0.5 * 400.0 / 111.83 * 0.2, rel=0.04)
    assert v[1] == pytest.approx(0.0, abs=0.02)


def test_half_the_speed_is_half_of_every_command(speeds) -> None:
    v, _ = speeds(DynamicsConfig(speed=(0.5, 0.5)), [(0.6, 0.0)] * 10 + [(-0.4, 0.0)] * 10)
    assert v[9] == pytest.approx(0.3, rel=0.01) and v[-1] == pytest.approx(-0.2, rel=0.01)


def test_a_steering_offset_turns_a_car_that_is_told_to_go_straight(speeds) -> None:
    _, yaw_rate = speeds(DynamicsConfig(steering_offset_rad=(0.1, 0.1)), [(0.6, 0.0)] * 15)
    assert yaw_rate[-1] == pytest.approx(0.6 * math.tan(0.1) / 0.56, rel=0.02)
    _, straight = speeds(DynamicsConfig(steering_offset_rad=(0.1, 0.1)), [(0.6, -0.1)] * 15)
    assert straight[-1] == pytest.approx(0.0, abs=1e-3)
    _, full = speeds(DynamicsConfig(steering_offset_rad=(0.1, 0.1)), [(0.6, 0.6)] * 20)
    assert full[-1] == pytest.approx(0.6 * math.tan(0.6) / 0.56, rel=0.02)  # no further than full lock


def test_hinges_at_a_fiftieth_of_their_speed_turn_so_slowly(simulate: Callable[..., Simulation]) -> None:
    """4 rad/s / 50 for 0.2 s are 0.016 rad; full lock asks for 0.77 and 0.49 rad."""
    sim = planar(FIELD, indices=np.array([0]))
    stand(sim, (0.0, 0.0, 0.0), dynamics=(1.0, 0.02, 0.0, 1.0, 0.0))
    bullet = simulate()
    bullet.reset(Pose2(0.0, 0.0, 0.0), Dynamics(steering_rate=0.02))
    for n in range(1, 6):
        drive(sim, [(0.0, 0.6)])
        assert sim.motion[0, :2] == pytest.approx(np.full(2, 0.016 * n), rel=1e-3)
        assert bullet.step(Command(0.0, 0.6)).knuckle_rad == pytest.approx(np.full(2, 0.016 * n), rel=0.05)


@pytest.mark.parametrize("n_left", range(4))
def test_a_late_command_drives_only_the_physics_steps_that_are_left(speeds, n_left: int) -> None:
    """In each of 1/120 s the motors bring 400 N / 111.83 kg / 120 Hz = 0.0298 m/s."""
    late_s = 0.2 - n_left / 120
    v, _ = speeds(DynamicsConfig(delay_s=(late_s, late_s)), [(0.6, 0.0)])
    assert v[0] == pytest.approx(n_left * 400.0 / 111.83 / 120, rel=0.05, abs=1e-3)


MANOEUVRE = [(0.6, 0.5), (0.6, 0.5), (-0.3, -0.6), (0.6, 0.1), (0.6, 0.0), (0.2, 0.4)]


def late(delay: int) -> list[tuple[float, float]]:
    """Return the manoeuvre in quarters of a control step, so many quarters late, the car told to stand until then."""
    return ([(0.0, 0.0)] * delay + [command for command in MANOEUVRE for _ in range(4)])[: 4 * len(MANOEUVRE)]


@pytest.mark.parametrize("delay", range(5), ids=lambda n: f"{n}-quarters-of-a-step")
def test_a_late_command_is_the_same_command_later(delay: int) -> None:
    in_quarters = run(late(delay), step_s=0.05)[::4]
    delayed = run(MANOEUVRE, dynamics=(1.0, 1.0, 0.0, 1.0, 0.05 * delay))
    np.testing.assert_allclose(delayed, in_quarters, atol=2e-6)


@pytest.mark.parametrize("delay", range(5), ids=lambda n: f"{n}-quarters-of-a-step")
def test_a_late_command_is_the_same_command_later_in_bullet_too(
    simulate: Callable[..., Simulation], delay: int
) -> None:
    whole, quarters = simulate(), simulate(control_step_s=0.05)
    whole.reset(Pose2(0.0, 0.0, 0.0), Dynamics(delay_s=0.05 * delay))
    quarters.reset(Pose2(0.0, 0.0, 0.0))
    for n, command in enumerate(MANOEUVRE):
        pose = whole.step(Command(*command)).pose
        parts = [quarters.step(Command(*quarter)).pose for quarter in late(delay)[4 * n : 4 * n + 4]]
        assert (pose.x, pose.y, pose.yaw) == pytest.approx((parts[-1].x, parts[-1].y, parts[-1].yaw), abs=1e-9)


def test_until_a_late_command_comes_the_wheels_go_where_an_offset_turns_them(
    simulate: Callable[..., Simulation],
) -> None:
    """Told nothing yet, both cars hold the command "stand, straight on", which this one's linkage makes 0.2 rad."""
    sim = planar(FIELD, indices=np.array([0]))
    stand(sim, (0.0, 0.0, 0.0), dynamics=(1.0, 1.0, 0.2, 1.0, 0.2))
    drive(sim, [(0.0, -0.4)])
    bullet = simulate()
    bullet.reset(Pose2(0.0, 0.0, 0.0), Dynamics(steering_offset_rad=0.2, delay_s=0.2))
    knuckles = bullet.step(Command(0.0, -0.4)).knuckle_rad
    assert sim.motion[0, 0] > 0.15 and sim.motion[0, :2] == pytest.approx(knuckles, abs=0.01)


def test_dynamics_are_drawn_anew_for_each_episode() -> None:
    config = DynamicsConfig(speed=(0.5, 1.0), delay_s=(0.0, 0.2))
    many = PlanarDrive(TaskConfig(dynamics=config, episode=OPEN), [FIELD], 400)
    first = many.sim.state()["dynamics"].copy()
    assert first[:, 3].min() < 0.52 and first[:, 3].max() > 0.98 and first[:, 3].mean() == pytest.approx(0.75, abs=0.03)
    assert set(first[:, 4]) == set(range(25))  # physics steps of 1/120 s in 0.2 s
    assert (first[:, :3] == (1.0, 1.0, 0.0)).all()
    many.reset()
    assert not np.array_equal(many.sim.state()["dynamics"], first)


def test_the_planar_car_follows_bullets_car(simulate: Callable[..., Simulation]) -> None:
    commands = np.repeat(np.random.default_rng(3).uniform(-0.6, 0.6, (10, 2)), 5, axis=0)
    bullet = simulate()
    bullet.reset(Pose2(0.0, 0.0, 0.0))
    theirs = np.array([(p.x, p.y, p.yaw) for p in (bullet.step(Command(*c)).pose for c in commands)])
    ours = run(commands)[1:]
    assert np.hypot(*(ours - theirs)[:, :2].T).max() < 0.03 and np.abs(ours - theirs)[:, 2].max() < 0.03
