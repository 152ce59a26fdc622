"""The supervisor stops the car before it touches anything, lets through what is safe, and says why."""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from boxes import box_world
from numpy.typing import NDArray

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.agent import SmoothRandomAgent
from zebrat_bullet.agents.supervised import supervised
from zebrat_bullet.cli import main
from zebrat_bullet.config import EpisodeConfig, LidarConfig, NoiseConfig, PhysicsConfig, TaskConfig
from zebrat_bullet.deploy.car import Car, car_of
from zebrat_bullet.deploy.supervisor import Supervisor
from zebrat_bullet.deploy.sweep import scan_points
from zebrat_bullet.errors import ActionError, ConfigError, ZebratError
from zebrat_bullet.evaluation.metrics import score
from zebrat_bullet.evaluation.records import EpisodeRecord, load_record, save_record
from zebrat_bullet.evaluation.rollout import replay_episode, run_episode
from zebrat_bullet.geometry import to_world
from zebrat_bullet.robot import RobotModel, load_robot, within_limits
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command, Dynamics, FlatScan, Pose2, Reading
from zebrat_bullet.world import load_world

STEP_S, MARGIN_M = 0.2, 0.02
BEARINGS = np.linspace(-math.pi, math.pi, 360, endpoint=False)
FAR = np.full(360, 6.0, np.float32)
AHEAD, BACK = Command(0.6, 0.0), Command(-0.6, 0.0)
CAR = Car(
    name="box",
    outline_base=((-0.5, -0.3), (0.5, -0.3), (0.5, 0.3), (-0.5, 0.3)),
    lidar_xyz_base=(0.4, 0.0, 0.75),
    wheelbase_m=0.56,
    rear_axle_x_m=-0.271,
    max_speed_mps=0.6,
    max_steering_rad=0.6,
    steering_rate_radps=4.0,
    deceleration_mps2=3.0,
)
# A control step of 0.2 s at 0.6 m/s and 0.6^2 / (2 * 3) of braking.
STOPPING_M = 0.12 + 0.06


def scan_of(*points_base: tuple[float, float]) -> FlatScan:
    """Return a scan whose only returns are those nearest to points; exact where they lie on bearings."""
    ranges = FAR.copy()
    for x, y in points_base:
        bearing = math.atan2(y, x - 0.4)
        ranges[round((bearing + math.pi) / math.radians(1.0)) % 360] = math.hypot(x - 0.4, y)
    return FlatScan(ranges, 6.0)


def walls(*, ahead: float = 9.0, behind: float = 9.0, left: float = 9.0, right: float = 9.0) -> FlatScan:
    """Return the scan in a rectangle whose sides are so far from the car's."""
    c, s = np.cos(BEARINGS), np.sin(BEARINGS)
    with np.errstate(divide="ignore"):
        along = np.where(c > 0.0, 0.1 + ahead, 0.9 + behind) / np.abs(c)
        across = 0.3 + np.where(s > 0.0, left, right)
        across = across / np.abs(s)
    return FlatScan(np.minimum(np.minimum(along, across), 6.0).astype(np.float32), 6.0)


def steady(command: Command, *, margin_m: float = MARGIN_M, car: Car = CAR, **settings: float) -> Supervisor:
    """Return a supervisor of a car that has long obeyed a command."""
    supervisor = Supervisor(car, STEP_S, margin_m, **settings)
    for _ in range(5):
        assert not supervisor.check(command, scan_of((-5.0, 0.0)), command.speed_mps, command.steering_rad).refusal
    return supervisor


@pytest.mark.parametrize(("spare_m", "stops"), [(0.004, False), (-0.004, True)])
@pytest.mark.parametrize("side", ["ahead", "behind"])
def test_it_stops_where_a_control_step_and_braking_would_end_within_the_margin(
    side: str, spare_m: float, stops: bool
) -> None:
    command = AHEAD if side == "ahead" else BACK
    scan = walls(**{side: STOPPING_M + MARGIN_M + spare_m})
    decision = steady(command).check(command, scan, command.speed_mps, 0.0)
    assert bool(decision.refusal) == stops
    assert decision.command == (Command(0.0, 0.0) if stops else command)


def test_a_command_that_holds_longer_is_followed_for_so_long() -> None:
    ahead_m = 0.36 + STOPPING_M - 0.12  # 0.6 s at 0.6 m/s, and braking
    for spare_m, stops in ((0.004, False), (-0.004, True)):
        supervisor = steady(AHEAD)
        scan = walls(ahead=ahead_m + MARGIN_M + spare_m)
        assert bool(supervisor.check(AHEAD, scan, 0.6, 0.0, 0.0, 0.6).refusal) is stops
    supervisor = steady(AHEAD)
    assert not supervisor.check(AHEAD, walls(ahead=ahead_m), 0.6, 0.0).refusal  # a control step, as ever
    # How far the car has come since is another matter: that is told at the next check.
    for since_s, turned_rad in ((None, 0.5), (0.2, 0.5), (0.6, 0.6), (0.0, 0.0)):
        supervisor = steady(AHEAD)
        supervisor.check(Command(0.6, 0.6), scan_of((-5.0, 0.0)), 0.6, None, 0.0, 0.6)
        supervisor.check(AHEAD, scan_of((-5.0, 0.0)), 0.6, None, 0.0, None, since_s)
        assert supervisor._steerings_rad[1] == pytest.approx(turned_rad, abs=0.05)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -1.0, "0.2"])
def test_a_time_that_is_none_stops_the_car(wrong: float) -> None:
    for times in ({"hold_s": wrong}, {"since_s": wrong}):
        decision = steady(AHEAD).check(AHEAD, walls(), 0.6, 0.0, **times)
        assert decision.command.speed_mps == 0.0 and "since a check are in s from 0" in decision.refusal


def test_a_clock_that_was_set_forward_costs_no_time() -> None:
    """Of simulated time that begins in 1970 and is then told: each step of it would be driven."""
    supervisor = steady(AHEAD)
    assert not supervisor.check(AHEAD, scan_of((-5.0, 0.0)), 0.6, 0.0, 0.0, None, 1.7e9).refusal
    assert supervisor.check(AHEAD, scan_of((-5.0, 0.0)), 0.6, 0.0, 0.0, 1.7e9).command.speed_mps == 0.0


def test_a_wall_behind_does_not_stop_a_car_that_drives_ahead() -> None:
    assert not steady(AHEAD).check(AHEAD, walls(behind=0.03), 0.6, 0.0).refusal
    assert steady(BACK).check(BACK, walls(behind=0.03), -0.6, 0.0).refusal


def test_the_measured_speed_counts_and_not_the_commanded_one() -> None:
    crawl, scan = Command(0.1, 0.0), walls(ahead=0.07)
    assert not Supervisor(CAR, STEP_S).check(crawl, scan, 0.1, 0.0).refusal
    # From 0.6 m/s it takes 58 mm to slow down to 0.1 m/s, and more for the rest of the step and to stop.
    assert Supervisor(CAR, STEP_S).check(crawl, scan, 0.6, 0.0).refusal


def test_a_car_that_still_rolls_ahead_may_be_told_to_reverse() -> None:
    supervisor = steady(AHEAD)
    decision = supervisor.check(BACK, walls(ahead=0.06), 0.6, 0.0)
    assert decision.command == BACK and not decision.refusal  # it brakes as a stop would


@pytest.mark.parametrize("age_s", [0.0, 0.1, 0.19])
def test_an_old_scan_is_moved_on_along_the_last_command(age_s: float) -> None:
    for spare_m, stops in ((0.004, False), (-0.004, True)):
        scan = walls(ahead=STOPPING_M + MARGIN_M + 0.6 * age_s + spare_m)
        assert bool(steady(AHEAD).check(AHEAD, scan, 0.6, 0.0, age_s).refusal) == stops


def test_a_delay_of_the_motors_counts_like_the_age_of_the_scan() -> None:
    scan = walls(ahead=STOPPING_M + MARGIN_M + 0.03)
    assert not steady(AHEAD).check(AHEAD, scan, 0.6, 0.0).refusal
    assert steady(AHEAD, delay_s=0.06).check(AHEAD, scan, 0.6, 0.0).refusal


def test_the_wheels_that_still_stand_to_the_left_carry_the_car_to_the_left() -> None:
    right = Command(0.6, -0.6)
    # Full left lock swings the front left corner out by 3 cm before the wheels have come round.
    scan = walls(left=0.03)
    assert not Supervisor(CAR, STEP_S, 0.0).check(right, walls(left=0.03, right=1.0), 0.6, -0.6).refusal
    assert Supervisor(CAR, STEP_S, 0.0).check(right, scan, 0.6, 0.6).refusal


REFUSALS = {
    "none": (None, 0.0, "no scan"),
    "late": (walls(), 0.21, "0.21 s old"),
    "from the future": (walls(), -0.1, "old"),
    "of unknown age": (walls(), math.nan, "old"),
    "without bearings": (FlatScan(np.zeros(0, np.float32), 6.0), 0.0, "shape"),
    "of two dimensions": (FlatScan(np.full((16, 360), 5.0, np.float32), 6.0), 0.0, "shape"),
    "with a nan": (FlatScan(np.where(np.arange(360) == 7, np.nan, FAR), 6.0), 0.0, "1 of 360 .*finite"),
    "with an inf": (FlatScan(np.where(np.arange(360) == 7, np.inf, FAR), 6.0), 0.0, "1 of 360 .*finite"),
    "below 0": (FlatScan(np.where(np.arange(360) == 7, -1.0, FAR), 6.0), 0.0, "below 0"),
    "without a reach": (FlatScan(FAR, math.nan), 0.0, "finite"),
    "empty": (FlatScan(FAR, 6.0), 0.0, "empty"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_a_scan_that_says_nothing_stops_the_car_at_once(case: str) -> None:
    scan, age_s, said = REFUSALS[case]
    supervisor = steady(Command(0.6, 0.2))
    decision = supervisor.check(Command(0.6, -0.5), scan, 0.6, 0.2, age_s)
    assert decision.command == Command(0.0, 0.2)  # it was seen to be free to brake with these wheels
    with pytest.raises(AssertionError, match=said):
        raise AssertionError(decision.refusal)
    assert not supervisor.check(Command(0.6, 0.2), scan_of((-5.0, 0.0)), 0.0, 0.2).refusal


@pytest.mark.parametrize("command", [Command(math.nan, 0.0), Command(0.6, math.inf)])
def test_a_command_that_is_not_finite_stops_the_car(command: Command) -> None:
    decision = steady(AHEAD).check(command, walls(), 0.6, 0.0)
    assert decision.command == Command(0.0, 0.0) and "must be finite" in decision.refusal


@pytest.mark.parametrize(("speed", "steering"), [(math.nan, 0.0), (0.0, math.inf)])
def test_a_measurement_that_is_not_finite_stops_the_car(speed: float, steering: float) -> None:
    decision = Supervisor(CAR, STEP_S).check(AHEAD, walls(), speed, steering)
    assert decision.command.speed_mps == 0.0 and "odometry" in decision.refusal


def test_a_command_beyond_the_limits_is_clipped_to_them() -> None:
    assert Supervisor(CAR, STEP_S).check(Command(9.0, -9.0), scan_of((-5.0, 0.0)), 0.0, 0.0).command == Command(
        0.6, -0.6
    )


def test_a_lidar_in_a_wide_hall_may_be_allowed_to_see_nothing() -> None:
    assert not Supervisor(CAR, STEP_S, least_returns=0).check(AHEAD, FlatScan(FAR, 6.0), 0.0, 0.0).refusal


@pytest.mark.parametrize(
    "settings",
    [{"margin_m": -0.1}, {"margin_m": math.nan}, {"late_s": math.inf}, {"delay_s": -1.0}, {"steering_lag_s": -1.0}],
)
def test_settings_that_mean_nothing_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(settings))):
        Supervisor(CAR, STEP_S, **settings)
    with pytest.raises(ConfigError, match="control_step_s"):
        Supervisor(CAR, 0.0)


@pytest.mark.parametrize("gap_m", [0.01, 0.001, -0.02])
@pytest.mark.parametrize("lock", [0.6, 0.0, -0.6])
def test_a_car_within_the_margin_or_in_contact_may_back_away_but_not_go_nearer(gap_m: float, lock: float) -> None:
    scan = walls(ahead=gap_m)
    assert not Supervisor(CAR, STEP_S).check(Command(-0.6, lock), scan, 0.0, lock).refusal
    assert Supervisor(CAR, STEP_S).check(Command(0.1, lock), scan, 0.0, lock).refusal
    assert not Supervisor(CAR, STEP_S).check(Command(0.6, lock), walls(behind=gap_m), 0.0, lock).refusal


def test_a_car_within_the_margin_of_a_side_may_drive_along_it_but_not_towards_it() -> None:
    scan = walls(left=0.01, right=0.01)
    for command in (AHEAD, BACK):
        assert not Supervisor(CAR, STEP_S).check(command, scan, 0.0, 0.0).refusal
    for lock in (0.3, -0.3):
        assert Supervisor(CAR, STEP_S).check(Command(0.6, lock), scan, 0.0, lock).refusal


@pytest.mark.parametrize("inside", [(0.2, 0.0), (0.15, 0.1), (-0.46, 0.0)])
def test_a_return_inside_the_outline_is_no_leave_to_drive_into_a_wall(inside: tuple[float, float]) -> None:
    """The first two are deep inside; the third could be a wall behind that is touched, but is not the one ahead."""
    supervisor = steady(AHEAD)
    for gap_m in np.arange(0.6, 0.0, -0.005):
        points = scan_of(inside)
        seen = walls(ahead=float(gap_m)).ranges_m
        seen = np.where(points.ranges_m < 6.0, points.ranges_m, seen)
        if supervisor.check(AHEAD, FlatScan(seen, 6.0), 0.6, 0.0).refusal:
            assert gap_m > STOPPING_M - 0.006  # steps of 5 mm: the wall is still outside when the car stands
            return
    raise AssertionError("it drove into the wall")


def test_a_return_deep_inside_the_outline_stops_and_is_told() -> None:
    decision = Supervisor(CAR, STEP_S).check(BACK, scan_of((0.2, 0.0), (3.0, 0.0)), 0.0, 0.0)
    assert "1 returns stand up to 0.30 m inside the car's outline" in decision.refusal
    assert decision.command.speed_mps == 0.0


@pytest.mark.parametrize(("speed_mps", "steering_rad"), [(1e6, 0.0), (-2.0, 0.0), (0.0, 3.0)])
def test_a_measurement_that_no_car_has_is_refused_at_once(speed_mps: float, steering_rad: float) -> None:
    decision = Supervisor(CAR, STEP_S).check(AHEAD, walls(ahead=3.0), speed_mps, steering_rad)
    assert "measured speed and steering must be within 1.8 m/s and 1.57 rad" in decision.refusal


def test_odometry_that_is_stuck_at_0_does_not_let_a_car_into_a_wall() -> None:
    supervisor = steady(AHEAD)
    scan = walls(ahead=STOPPING_M + MARGIN_M - 0.01)
    assert supervisor.check(AHEAD, scan, 0.0, 0.0).refusal


def test_a_stop_turns_the_wheels_as_commanded_unless_braking_so_comes_nearer() -> None:
    standing_still = Supervisor(CAR, STEP_S).check(Command(0.6, 0.5), walls(ahead=0.05), 0.0, 0.0)
    assert standing_still.refusal and standing_still.command == Command(0.0, 0.5)
    # At full speed along a wall: turning towards it while it brakes would touch it.
    rolling = steady(AHEAD, margin_m=0.0).check(Command(0.6, 0.6), walls(left=0.006), 0.6, 0.0)
    assert rolling.refusal and rolling.command == Command(0.0, 0.0)


def test_it_says_where_and_when_and_which_ways_are_free() -> None:
    said = steady(AHEAD).check(AHEAD, scan_of((0.65, 0.3)), 0.6, 0.0).refusal
    assert said.startswith("would touch what is 0.15 m ahead-left in 0.2 s; free at full speed: ")
    assert "back straight" in said and "ahead straight" not in said
    said = steady(BACK).check(BACK, scan_of((-0.6, 0.0)), -0.6, 0.0).refusal
    assert "0.10 m behind in 0.1 s" in said and "ahead straight" in said
    near = steady(AHEAD).check(AHEAD, walls(ahead=STOPPING_M + 0.01), 0.6, 0.0).refusal
    assert "would come to 0.01" in near and "margin 0.02 m" in near
    shut = walls(ahead=0.03, behind=0.03, left=0.03, right=0.03)
    assert "go slower" in Supervisor(CAR, STEP_S).check(AHEAD, shut, 0.0, 0.0).refusal


def test_between_returns_that_lie_apart_there_is_wall_and_none_between_those_far_apart() -> None:
    x, y = scan_points(walls(left=0.05), CAR).T
    beside = np.sort(x[(np.abs(y - 0.35) < 1e-3) & (np.abs(x + 0.45) < 0.15)])
    assert np.diff(beside).max() < 0.015  # the bearings alone are up to 4.6 cm apart there
    assert len(scan_points(scan_of((1.0, 0.0), (0.9, 0.05)), CAR)) == 2


def test_without_measurements_it_takes_the_car_to_have_obeyed() -> None:
    measured, blind = steady(AHEAD), steady(AHEAD)
    scan = walls(ahead=STOPPING_M + MARGIN_M - 0.004)
    assert measured.check(AHEAD, scan, 0.6, 0.0) == blind.check(AHEAD, scan, None, None)
    assert not Supervisor(CAR, STEP_S).check(AHEAD, scan, None, None).refusal  # it stands still
    blind.reset()
    assert not blind.check(AHEAD, scan, None, None).refusal


# ---- against brute force ------------------------------------------------------------------------------------------


def swept(speed: float, steering: float, command: Command, inset_m: float = 0.0) -> NDArray[np.object_]:
    """Return the outlines, so much smaller than they are, of a control step and of braking, in the frame of now.

    They are 2 ms apart, worked out at 2,000 steps a second, of both ways in which the steering may turn.
    """
    corners = np.array(CAR.outline_base) * (1.0 - inset_m / np.array([0.5, 0.3]))
    return shapely.polygons([at for lag_s in (0.0, 0.08) for at in placed(corners, speed, steering, command, lag_s)])


def placed(
    corners: NDArray[np.float64], speed: float, steering: float, command: Command, lag_s: float
) -> list[NDArray[np.float64]]:
    car, dt = CAR, 0.0005
    x, y, yaw, time, found = car.rear_axle_x_m, 0.0, 0.0, 0.0, []
    while time < STEP_S or speed != 0.0:
        wanted = command.speed_mps if time < STEP_S else 0.0
        faster = abs(wanted) > abs(speed) and wanted * speed >= 0
        most = car.deceleration_mps2 * dt * (1.5 if faster else 1.0)
        speed += float(np.clip(wanted - speed, -most, most))
        error = command.steering_rad - steering
        most = car.steering_rate_radps * dt
        steering += float(np.clip(error * dt / lag_s if lag_s else error, -most, most))
        x, y = x + speed * dt * math.cos(yaw), y + speed * dt * math.sin(yaw)
        yaw += speed * dt * math.tan(steering) / car.wheelbase_m
        time += dt
        c, s = math.cos(yaw), math.sin(yaw)
        base = np.array([x - car.rear_axle_x_m * c, y - car.rear_axle_x_m * s])
        found.append(corners @ np.array([[c, s], [-s, c]]) + base)
    return found[::4]


def test_no_command_gets_through_that_brute_force_says_would_touch() -> None:
    rng = np.random.default_rng(0)
    let_through = touched = 0
    for _ in range(250):
        n, reach = rng.integers(1, 6), rng.uniform(0.02, 0.35)
        side = rng.uniform(-1.0, 1.0, (n, 2)) * (0.5 + reach, 0.3 + reach)
        points = side[(np.abs(side) > (0.505, 0.305)).any(axis=1)]
        if not len(points):
            continue
        scan = scan_of(*points.tolist())
        seen = scan.ranges_m < 6.0
        exact = np.stack([np.cos(BEARINGS[seen]), np.sin(BEARINGS[seen])], 1) * scan.ranges_m[seen, None] + (0.4, 0.0)
        if (np.abs(exact) <= (0.5, 0.3)).all(axis=1).any():
            continue
        command = Command(float(rng.choice([-0.6, 0.6, rng.uniform(-0.6, 0.6)])), float(rng.uniform(-0.6, 0.6)))
        speed, steering = float(rng.uniform(-0.6, 0.6)), float(rng.uniform(-0.6, 0.6))
        refused = bool(Supervisor(CAR, STEP_S, 0.0).check(command, scan, speed, steering).refusal)
        mirrored = FlatScan(np.roll(scan.ranges_m[::-1], 1), 6.0)
        other = Supervisor(CAR, STEP_S, 0.0).check(mirrored_command(command), mirrored, speed, -steering)
        assert bool(other.refusal) == refused  # left is as right
        cloud = shapely.MultiPoint(exact)
        touches = bool(shapely.intersects(cloud, swept(speed, steering, command, inset_m=0.001)).any())
        if touches and not refused:  # nor does stopping at once help then
            brake = replace(command, speed_mps=0.0)
            assert shapely.intersects(cloud, swept(speed, steering, brake)).any(), (speed, steering, command, exact)
        let_through += not refused
        touched += touches
    assert let_through > 80 and touched > 15


def mirrored_command(command: Command) -> Command:
    return Command(command.speed_mps, -command.steering_rad)


# ---- in PyBullet --------------------------------------------------------------------------------------------------

SMALL_CAR = Path(__file__).parent / "data" / "small_car.urdf"
EMBREE = TaskConfig(lidar=LidarConfig(caster="embree"))


@pytest.mark.parametrize("name", ["zebrat", "hexagon", "long", str(SMALL_CAR)])
def test_the_car_brakes_in_physics_at_least_as_hard_as_its_numbers_say(
    simulate: Callable[..., Simulation], name: str
) -> None:
    robot = load_robot(name)
    car = car_of(robot, within_limits(PhysicsConfig(), robot))
    simulation = simulate(robot=robot)
    factors = []
    for steering in (0.0, 0.2, 0.4, 0.6, -0.6):
        for speed in (0.6, -0.6):
            v, metres = brake(simulation, car, Command(speed, steering))
            factors.append(v * v / (2.0 * metres) / car.deceleration_mps2)
    assert min(factors) >= 1.0
    assert min(factors) < 1.6  # nor is it far too careful, which would stop cars that have room


def test_braking_takes_what_the_page_says(simulate: Callable[..., Simulation], robot: RobotModel) -> None:
    car = car_of(robot, within_limits(PhysicsConfig(), robot))
    assert car.deceleration_mps2 == pytest.approx(3.08, abs=0.005)
    for steering, metres in ((0.0, 0.049), (0.3, 0.050), (0.45, 0.053), (0.6, 0.057)):
        for speed in (0.6, -0.6):
            v, driven = brake(simulate(robot=robot), car, Command(speed, steering))
            assert driven * (0.6 / v) ** 2 == pytest.approx(metres, abs=0.001)


def brake(simulation: Simulation, car: Car, command: Command) -> tuple[float, float]:
    """Drive by a command for 2 s, then by none; return the speed in m/s and the way in m of the rear axle to rest."""
    simulation.reset(Pose2(0.0, 0.0, 0.0))
    for _ in range(10):
        state = simulation.step(command)
    v, metres, pose = state.speed_mps, 0.0, state.pose
    for _ in range(3):
        for touches in simulation.substeps(Command(0.0, command.steering_rad)):
            after = simulation.read(touches).pose
            axles = [
                (p.x + car.rear_axle_x_m * math.cos(p.yaw), p.y + car.rear_axle_x_m * math.sin(p.yaw))
                for p in (pose, after)
            ]
            metres, pose = metres + math.dist(*axles), after
    return v, metres


def nearest_m(record: EpisodeRecord) -> float:
    """Return how near the true outline came to the true walls."""
    outlines = shapely.polygons([to_world(np.array(CAR.outline_base), Pose2(*pose)) for pose in record.pose])
    return float(shapely.distance(outlines, CORRIDOR.walls).min())


class Blindly:
    """Drives full speed, whatever there is."""

    name = "blindly"
    privileged: frozenset[str] = frozenset()

    def __init__(self, speed_mps: float, steering_rad: float) -> None:
        self._command = Command(speed_mps, steering_rad)

    def reset(self, seed: int) -> None:
        pass

    def act(self, reading: Reading) -> Command:
        return self._command


CORRIDOR = box_world(
    *(((-2.0, 3.0), (y, y + 0.1), (0.0, 1.0)) for y in (0.75, -0.85)),
    *(((x, x + 0.1), (-0.85, 0.85), (0.0, 1.0)) for x in (-2.1, 3.0)),
)


@pytest.fixture(scope="module")
def corridor() -> Iterator[Drive]:
    """A corridor 1.6 m wide, shut at both ends; the car begins in its middle."""
    drive = Drive(EMBREE, CORRIDOR)
    yield drive
    drive.close()


@pytest.mark.parametrize("steering", [0.0, 0.1, -0.3, 0.6, -0.6])
@pytest.mark.parametrize("speed", [0.6, -0.6])
def test_a_driver_that_always_drives_into_the_wall_never_touches_it(
    corridor: Drive, speed: float, steering: float
) -> None:
    alone = run_episode(corridor, Blindly(speed, steering), 0, 0)
    agent = supervised(Blindly(speed, steering), EMBREE, 0.01)
    record = run_episode(corridor, agent, 0, 0)
    assert alone.outcome == "collision"
    assert record.outcome == "stall" and nearest_m(record) > 0.008
    assert np.abs(record.speed_mps[-1]) < 0.01 and len(agent.refused) == len(record.refused)


@pytest.mark.parametrize(("noise_m", "margin_m"), [(0.0, 0.01), (0.008, 0.03)])
def test_nor_does_one_that_drives_at_random(noise_m: float, margin_m: float) -> None:
    task = replace(EMBREE, noise=NoiseConfig(range_sigma_m=noise_m), episode=EpisodeConfig(max_steps=200))
    drive = Drive(task, CORRIDOR)
    agent = supervised(SmoothRandomAgent(0.6, 0.6), EMBREE, margin_m)
    records = [run_episode(drive, agent, 5, episode) for episode in range(2)]
    drive.close()
    assert min(map(nearest_m, records)) > 0.008
    assert sum(int(record.refused[:, 3].sum()) for record in records) > 20


def test_what_would_touch_is_asked_without_a_trace(simulate: Callable[..., Simulation]) -> None:
    def drive(ask: bool) -> tuple[list[Pose2], list[bool]]:
        simulation, rng = simulate(), np.random.default_rng(3)
        simulation.set_world(CORRIDOR)
        simulation.reset(Pose2(2.3, 0.0, 0.0), Dynamics(delay_s=0.05))
        poses, answers = [], []
        for _ in range(40):
            if ask:
                answers += [simulation.would_touch(Command(v, 0.0)) for v in (0.6, -0.6)]
            poses.append(simulation.step(Command(*rng.uniform(-0.6, 0.6, 2).tolist())).pose)
        return poses, answers

    asked, answers = drive(True)
    assert asked == drive(False)[0] and any(answers) and not all(answers)
    simulation = simulate()
    simulation.set_world(CORRIDOR)
    for x, touches in ((2.30, False), (2.45, True)):  # 0.068 m of speeding up and 0.05 m of braking to x = 3
        simulation.reset(Pose2(x, 0.0, 0.0))
        assert simulation.would_touch(Command(0.6, 0.0)) == touches
    with pytest.raises(ActionError):
        simulation.would_touch(Command(math.nan, 0.0))


# ---- around agents, in records and scores -------------------------------------------------------------------------


def test_a_record_says_what_was_refused_and_is_replayed_exactly(corridor: Drive, tmp_path: Path) -> None:
    record = run_episode(corridor, supervised(Blindly(0.6, 0.0), EMBREE, 0.02), 0, 0)
    save_record(record, tmp_path / "record.npz")
    loaded = load_record(tmp_path / "record.npz")
    assert loaded.supervised_m == 0.02 and loaded.reasons == record.reasons and "would" in record.reasons[0]
    np.testing.assert_array_equal(loaded.refused, record.refused)
    steps = loaded.refused[:, 0].astype(int)
    assert (loaded.refused[:, 1] == 0.6).all() and (loaded.command[steps, 0] == 0.0).all()
    replay_episode(corridor, loaded, CORRIDOR)
    for broken in (
        replace(record, refused=record.refused[:, :3]),
        replace(record, refused=record.refused[::-1]),
        replace(record, reasons=()),
        replace(record, supervised_m=-1.0),
    ):
        save_record(broken, tmp_path / "broken.npz")
        with pytest.raises(ZebratError, match=r"broken\.npz"):
            load_record(tmp_path / "broken.npz")


def test_a_run_of_refused_steps_is_one_intervention_and_false_if_none_of_them_would_have_touched(
    corridor: Drive,
) -> None:
    record = run_episode(corridor, supervised(Blindly(0.6, 0.0), EMBREE, 0.0), 0, 0)
    minutes = record.duration_s / 60.0
    rows = [(3, 0.6, 0.0, 0.0), (4, 0.6, 0.0, 1.0), (9, 0.6, 0.0, 0.0), (11, 0.6, 0.0, 0.0)]
    made = replace(record, refused=np.array(rows), reasons=("",) * 4)
    at = score([made]).supervision
    assert at is not None
    assert (at.interventions, at.false_stops, at.stalls) == (3, 2, 0)
    assert (at.per_minute, at.false_per_minute) == pytest.approx((3 / minutes, 2 / minutes))
    assert at.stopped == 4 / len(record.command)
    stalled = score([record]).supervision
    assert stalled is not None and stalled.stalls == 1
    alone = run_episode(corridor, Blindly(0.6, 0.0), 0, 0)
    assert "supervision" not in score([alone]).as_dict()


def test_a_far_too_wide_margin_makes_false_stops() -> None:
    drive = Drive(EMBREE, load_world("track_2"))
    agent = load_agent("shipped", EMBREE)
    free = run_episode(drive, agent, 0, 0)
    watched, wide = (run_episode(drive, supervised(agent, EMBREE, m), 0, 0) for m in (0.02, 0.3))
    drive.close()
    np.testing.assert_array_equal(free.pose, watched.pose)  # where it has nothing to do it changes nothing
    at = score([wide]).supervision
    assert at is not None and at.interventions == at.false_stops > 0


def test_a_scan_of_some_bearings_only_is_refused() -> None:
    drive = Drive(replace(EMBREE, lidar=replace(EMBREE.lidar, bearings="region")), load_world("track_2"))
    reading = drive.reset(np.random.default_rng(0))
    agent = supervised(Blindly(0.6, 0.0), EMBREE, 0.02)
    agent.reset(0)
    assert agent.act(reading) == Command(0.0, 0.0) and "whole scans" in agent.refused[0].reason
    drive.close()


@pytest.mark.parametrize("where", [["--generated", "2"], ["--set", "niches", "--sim", "planar"]])
def test_planar_cars_have_no_scans_for_a_supervisor(where: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--agent", "shipped", "--supervised", "--episodes", "1", *where]) == 2
    assert "whole scans" in capsys.readouterr().err


def test_the_command_line_judges_with_a_supervisor(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    options = ["--worlds", "track_2", "--episodes", "1", "--caster", "embree", "--workers", "1", "--quiet", "--json"]
    assert main(["evaluate", "--agent", "random", *options, "--supervised", "0.01", "--out", str(tmp_path)]) == 0
    answer = json.loads(capfd.readouterr().out)["track_2"]
    assert answer["collision"] == 0.0 and answer["supervision"]["margin_m"] == 0.01
    assert "stops a minute" in (tmp_path / "table.md").read_text(encoding="utf-8")
    assert main(["evaluate", "--agent", "random", *options, "--supervised", "-1", "--out", str(tmp_path)]) == 2
    assert "supervised_m" in capfd.readouterr().err
