"""Each disturbance changes on the real car of either engine what it should and nothing else, by the seed alone."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import (
    RANDOM_DYNAMICS,
    VLP16_NOISE,
    DisturbanceConfig,
    DynamicsConfig,
    LidarConfig,
    NoiseConfig,
    PhysicsConfig,
    TaskConfig,
)
from zebrat_bullet.config_text import from_json, to_json, with_overrides
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.evaluation.rollout import replay_episode, run_episode
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.dark_walls import DarkWalls
from zebrat_bullet.sim.base import CarSimulation
from zebrat_bullet.sim.engine import make_simulation
from zebrat_bullet.task.disturbances import Disturbances
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.training.presets import TRAIN_PRESETS
from zebrat_bullet.types import Command, Dynamics, Pose2, Reading
from zebrat_bullet.world import load_world

WORLD = load_world("track_2")
TASK = TaskConfig(lidar=LidarConfig(caster="embree"))
START = Pose2(0.0, 0.0, 0.0)
EVERYTHING = DisturbanceConfig(
    friction=(0.4, 1.2), mass=(0.7, 1.3), steering_lag_s=(0.0, 0.4), command_noise=(0.0, 0.3),
    range_sigma_m=(0.0, 0.05), dropout=(0.0, 0.5), dark_walls=(0.0, 0.2), mount_offset_m=(0.0, 0.1),
    mount_yaw_rad=(-0.1, 0.1), pose_sigma_m=0.05, pose_sigma_rad=0.05,
)  # fmt: skip


@pytest.fixture(scope="module", params=["bullet", "mujoco"])
def sim(request: pytest.FixtureRequest, robot: RobotModel) -> Iterator[CarSimulation]:
    if request.param == "mujoco":
        pytest.importorskip("mujoco")
    simulation = make_simulation(robot, PhysicsConfig(engine=request.param))
    yield simulation
    simulation.close()


def of(**settings: object) -> TaskConfig:
    """Return the task with settings of the disturbance, each a value for every episode or a range."""
    ranges = {k: (v, v) if isinstance(v, float) and not k.startswith("pose") else v for k, v in settings.items()}
    return replace(TASK, disturbance=DisturbanceConfig(**ranges))  # type: ignore[arg-type]


def driven(sim: CarSimulation, dynamics: Dynamics, commands: list[Command]) -> np.ndarray:
    """Return (T + 1, 6) x, y, yaw, speed, steering and yaw rate."""
    states = [sim.reset(START, dynamics), *(sim.step(command) for command in commands)]
    return np.array([(*s.pose, s.speed_mps, s.steering_rad, s.yaw_rate_radps) for s in states])


def drive(task: TaskConfig, commands: list[Command], seed: int = 0) -> tuple[list[Reading], np.ndarray]:
    """Return the readings and the (T + 1, 3) true poses of commands driven in a world."""
    made = Drive(task, WORLD)
    readings = [made.reset(np.random.default_rng(seed), whole_scans=True)]
    poses = [made.state.pose]
    for command in commands:
        readings.append(made.step(command).reading)
        poses.append(made.state.pose)
    made.close()
    return readings, np.array(poses)


def scans(readings: list[Reading]) -> np.ndarray:
    return np.array([reading.scan.ranges_m for reading in readings])


FORWARD = [Command(0.6, 0.0)] * 5
LEFT = [Command(0.6, 0.0)] * 3 + [Command(0.6, 0.6)] * 5
STILL = [Command(0.0, 0.0)]


def test_slippery_tyres_brake_in_more_way_and_turn_wider(sim: CarSimulation) -> None:
    stop = [Command(0.6, 0.0)] * 10 + [Command(0.0, 0.0)] * 10
    way = {f: driven(sim, Dynamics(friction=f), stop)[-1, 0] for f in (0.02, 0.4, 1.0)}
    moving = {f: driven(sim, Dynamics(friction=f), stop)[10, 0] for f in way}
    braking = {f: way[f] - moving[f] for f in way}
    # v^2 / (2 mu g) is 0.92 m at 0.02; the motors brake with less than 0.4 g.
    assert braking[0.02] > 0.15 and braking[0.02] > 3 * braking[1.0]
    assert braking[0.4] == pytest.approx(braking[1.0], abs=0.02)
    yaw = {f: driven(sim, Dynamics(friction=f), LEFT * 2)[-1, 2] for f in (0.02, 1.0)}
    assert yaw[0.02] < 0.8 * yaw[1.0]


def test_a_heavier_car_gathers_speed_more_slowly_and_keeps_its_end_speed(sim: CarSimulation) -> None:
    rows = {m: driven(sim, Dynamics(mass=m), [Command(0.6, 0.0)] * 10) for m in (0.7, 1.0, 1.3, 4.0)}
    way = [rows[m][1, 0] for m in rows]
    assert way == sorted(way, reverse=True) and way[0] > way[-1] * 1.2
    assert all(rows[m][-1, 3] == pytest.approx(0.6, abs=0.01) for m in rows)


def test_a_lagging_steering_comes_as_a_first_order_lag_does(sim: CarSimulation) -> None:
    lag = 0.4
    steering = driven(sim, Dynamics(steering_lag_s=lag), [Command(0.0, 0.5)] * 12)[:, 4]
    prompt = driven(sim, Dynamics(), [Command(0.0, 0.5)] * 12)[:, 4]
    at = 0.2 * np.arange(13)
    # The hinges themselves take about 0.08 s.
    assert np.abs(steering - 0.5 * (1 - np.exp(-np.maximum(at - 0.08, 0) / lag))).max() < 0.03
    assert prompt[2] > 0.49 and steering[-1] > 0.49
    speeds = [driven(sim, Dynamics(steering_lag_s=s), FORWARD)[:, 3] for s in (0.0, lag)]
    assert speeds[0] == pytest.approx(speeds[1], abs=1e-6)


@pytest.mark.parametrize("n", [1, 2])
def test_a_car_late_by_control_steps_drives_the_same_so_much_later(sim: CarSimulation, n: int) -> None:
    commands = [Command(0.6, 0.0), Command(0.6, 0.4), Command(0.2, -0.5), Command(-0.5, 0.3), Command(0.6, 0.1)]
    late = driven(sim, Dynamics(delay_s=0.2 * n), commands + STILL * n)
    assert np.abs(late[: n + 1, :3]).max() < 1e-3  # the physics itself lets a standing car creep by 0.1 mm
    assert late[n:] == pytest.approx(driven(sim, Dynamics(), commands), abs=2e-3)


def test_a_delay_between_one_step_and_two_lies_between(sim: CarSimulation) -> None:
    way = [driven(sim, Dynamics(delay_s=d), FORWARD)[-1, 0] for d in (0.2, 0.3, 0.4)]
    assert way[0] - way[1] == pytest.approx(0.06, abs=0.005) and way[1] - way[2] == pytest.approx(0.06, abs=0.005)


DISTURBED = Dynamics(friction=0.3, mass=1.7, steering_lag_s=0.3, delay_s=0.3)


def test_what_was_disturbed_leaves_no_trace_in_the_next_episode(sim: CarSimulation, robot: RobotModel) -> None:
    fresh = make_simulation(robot, sim._physics)
    before = driven(fresh, Dynamics(), LEFT)
    fresh.close()
    assert (driven(sim, DISTURBED, LEFT) != before).any()
    assert (driven(sim, Dynamics(), LEFT) == before).all()


def test_a_look_at_what_a_command_would_do_leaves_no_trace_in_a_disturbed_car(sim: CarSimulation) -> None:
    plain = driven(sim, DISTURBED, LEFT)
    sim.reset(START, DISTURBED)
    for row, command in zip(plain[1:], LEFT, strict=True):
        assert not sim.would_touch(Command(-0.6, -0.6))
        assert tuple(sim.step(command).pose) == tuple(row[:3])


def test_noise_on_the_commands_moves_the_car_and_no_one_is_told() -> None:
    quiet, loud = drive(TASK, LEFT), drive(of(command_noise=0.3), LEFT)
    assert np.abs(quiet[1] - loud[1]).max() > 0.01 and (quiet[1][0] == loud[1][0]).all()
    assert [reading.last_command for reading in loud[0]] == [reading.last_command for reading in quiet[0]]
    limits = PhysicsConfig()
    noise = Disturbances(of(command_noise=0.3), *np.random.default_rng(0).spawn(2))
    got = [noise.at_motors(Command(0.0, 0.0)) for _ in range(4000)]
    assert np.std([c.speed_mps for c in got]) == pytest.approx(0.3 * limits.max_speed_mps, rel=0.05)
    assert max(abs(c.steering_rad) for c in got) <= limits.max_steering_rad


def test_a_turned_mount_turns_the_scan_and_moves_nothing() -> None:
    (plain, *_), at = drive(TASK, STILL)
    (left, *_), there = drive(of(mount_yaw_rad=math.radians(10.0)), STILL)
    # Looking further left by ten bearings, what was at bearing i + 10 is now at i.
    assert left.scan.ranges_m == pytest.approx(np.roll(plain.scan.ranges_m, -10), abs=2e-3)
    assert (at == there).all()


def test_a_mount_is_off_by_so_much_in_a_direction_of_the_episodes_own() -> None:
    offsets = []
    for seed in range(40):
        noise = Disturbances(of(mount_offset_m=0.1), *np.random.default_rng(seed).spawn(2)).noise
        offsets.append(noise.mount_xyz_m)
    across = np.array(offsets)
    assert np.hypot(*across[:, :2].T) == pytest.approx(0.1) and (across[:, 2] == 0.0).all()
    assert across[:, :2].min() < -0.05 and across[:, :2].max() > 0.05


def test_dark_walls_give_no_return_and_all_else_stays() -> None:
    commands = FORWARD * 2
    plain, dark = drive(TASK, commands), drive(of(dark_walls=0.3), commands)
    assert (plain[1] == dark[1]).all()
    before, after = scans(plain[0]), scans(dark[0])
    gone = after == TASK.lidar.range_max_m
    assert (after[~gone] == before[~gone]).all()
    lost = (gone & (before < TASK.lidar.range_max_m)).mean() / (before < TASK.lidar.range_max_m).mean()
    assert 0.15 < lost < 0.45
    # Whole stretches, that stay while the car drives by, are gone: far more neighbours than of returns lost at random.
    assert (gone[0] & np.roll(gone[0], 1)).sum() > 0.7 * gone[0].sum()


def test_dark_places_are_a_share_of_the_plan_and_the_same_for_ever() -> None:
    points = np.random.default_rng(0).uniform(-100, 100, (20_000, 2))
    walls = DarkWalls(0.2, np.random.default_rng(1))
    assert walls.dark(points).mean() == pytest.approx(0.2, abs=0.02)
    assert (walls.dark(points) == walls.dark(points)).all()
    assert (walls.dark(points) != DarkWalls(0.2, np.random.default_rng(2)).dark(points)).any()
    assert not DarkWalls(0.0, np.random.default_rng(1)).dark(points).any()


@pytest.mark.parametrize("name", ["range_sigma_m", "dropout"])
def test_noise_drawn_for_an_episode_is_that_of_the_fixed_setting(name: str) -> None:
    fixed = replace(TASK, noise=NoiseConfig(**{name: 0.05}))
    assert (scans(drive(fixed, FORWARD)[0]) == scans(drive(of(**{name: 0.05}), FORWARD)[0])).all()
    drawn = [Disturbances(of(**{name: (0.0, 0.05)}), *np.random.default_rng(i).spawn(2)).noise for i in range(20)]
    assert 0.0 < min(getattr(n, name) for n in drawn) < max(getattr(n, name) for n in drawn) < 0.05


def test_a_localisation_errs_by_its_sigmas_and_drifts() -> None:
    task = of(pose_sigma_m=0.05, pose_sigma_rad=math.radians(3.0))
    made = Drive(task, WORLD)
    made.reset(np.random.default_rng(0))
    true = made.state
    errors = []
    for seed in range(60):
        disturbances = Disturbances(task, *np.random.default_rng(seed).spawn(2))
        errors.append([np.subtract(disturbances.localised(true).pose, true.pose) for _ in range(60)])
    made.close()
    across = np.array(errors)
    assert across.std(axis=(0, 1)) == pytest.approx((0.05, 0.05, math.radians(3.0)), rel=0.2)
    steps = np.diff(across, axis=1).std(axis=(0, 1))
    assert (steps < 0.25 * across.std(axis=(0, 1))).all() and (steps > 0).all()


class _Asks:
    """Stands, and keeps the poses that it is given."""

    name = "asks"

    def __init__(self, *privileges: str) -> None:
        self.privileged = frozenset(privileges)
        self.given: list[Pose2 | None] = []

    def reset(self, seed: int) -> None:
        self.given = []

    def act(self, reading: Reading) -> Command:
        self.given.append(None if reading.state is None else reading.state.pose)
        return Command(0.0, 0.0)


def test_only_who_is_given_the_pose_gets_its_error_and_the_record_keeps_the_truth() -> None:
    task = replace(of(pose_sigma_m=0.05, pose_sigma_rad=0.05), episode=replace(TASK.episode, max_steps=5))
    made = Drive(task, WORLD)
    planner, policy = _Asks("pose"), _Asks()
    record = run_episode(made, planner, 0, 0)
    given = np.array(planner.given)
    off = np.abs(given - record.pose[:-1])
    assert 0.0 < off[:, :2].max() < 0.3 and 0.0 < off[:, 2].max() < 0.3
    assert (run_episode(made, policy, 0, 0).pose == record.pose).all() and set(policy.given) == {None}
    made.close()


def _same(a: EpisodeRecord, b: EpisodeRecord) -> bool:
    return a.outcome == b.outcome and all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("pose", "scan_m", "command", "reward")
    )


def test_a_disturbed_episode_is_a_function_of_its_seed_and_its_record_replays_exactly() -> None:
    task = replace(TASK, disturbance=EVERYTHING, dynamics=replace(RANDOM_DYNAMICS, delay_s=(0.0, 0.4)))
    made, other = Drive(task, WORLD), Drive(task, WORLD)
    agent = load_agent("shipped", task)
    run_episode(made, agent, 5, 7)  # what was before does not matter
    record = run_episode(made, agent, 5, 3)
    assert _same(record, run_episode(other, agent, 5, 3))
    assert from_json(TaskConfig, record.task).disturbance == EVERYTHING
    assert _same(record, replay_episode(other, record, WORLD))
    assert not np.array_equal(record.pose[:5], run_episode(made, agent, 5, 4).pose[:5])
    made.close()
    other.close()


def test_by_default_nothing_is_drawn_or_changed() -> None:
    rngs = np.random.default_rng(0).spawn(2)
    task = replace(TASK, noise=VLP16_NOISE, dynamics=RANDOM_DYNAMICS)
    none = Disturbances(task, *rngs)
    state = object()
    assert none.noise == VLP16_NOISE and none.dark_walls is None and none.localised(state) is state  # type: ignore[arg-type]
    assert none.at_motors(command := Command(0.1, 0.2)) is command
    as_before = np.random.default_rng(0).spawn(2)[0].uniform(*zip(*vars(RANDOM_DYNAMICS).values(), strict=True))
    assert none.dynamics == Dynamics(*as_before.tolist())


def test_a_new_disturbance_shifts_none_of_the_others() -> None:
    one, other = (
        Disturbances(of(mass=(0.7, 1.3), **more), *np.random.default_rng(0).spawn(2))
        for more in ({}, {"friction": (0.4, 1.2), "command_noise": 0.2, "dark_walls": 0.1})
    )
    assert one.dynamics.mass == other.dynamics.mass != 1.0 and other.dynamics.friction != 1.0


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("disturbance.friction=[0.0,1.0]", r"disturbance.friction must be within 0.01 to 10, got \[0.0, 1.0\]"),
        ("disturbance.mass=[1.3,0.7]", r"disturbance.mass must be \[least, greatest\], got \[1.3, 0.7\]"),
        ("disturbance.dropout=[0.0,1.5]", "disturbance.dropout must be within 0 to 1"),
        ("disturbance.dark_walls=0.1", "disturbance.dark_walls"),
        ("disturbance.steering_lag_s=[.nan,0.1]", "disturbance.steering_lag_s"),
        ("disturbance.mount_yaw_rad=[-4,4]", "disturbance.mount_yaw_rad must be within"),
        ("disturbance.pose_sigma_m=-0.1", "disturbance.pose_sigma_m must be within 0 to 100, got -0.1"),
        ("disturbance.pose_drift_s=0", "disturbance.pose_drift_s must be within 0.001"),
        ("disturbance.grip=[1,1]", "disturbance.*grip|cannot set"),
        ("dynamics.delay_s=[0.0,0.5]", r"dynamics.delay_s may be two control steps \(0.4 s\) at most, got 0.5"),
    ],
)
def test_a_disturbance_that_cannot_be_is_refused_by_its_name(setting: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        with_overrides(TASK, [setting])


@pytest.mark.parametrize(
    ("task", "said"),
    [
        (of(friction=0.5), "planar cars have no disturbance.friction; leave them out, or drive it in PyBullet"),
        (of(dark_walls=0.1, pose_sigma_m=0.05), "no disturbance.dark_walls, disturbance.pose_sigma_m"),
        (replace(TASK, dynamics=DynamicsConfig(delay_s=(0.0, 0.3))), "planar cars obey within a control step"),
    ],
)
def test_planar_cars_refuse_what_they_do_not_have(task: TaskConfig, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        PlanarDrive(task, [WORLD], 4)


def test_a_training_on_planar_cars_refuses_it_before_it_draws_a_track() -> None:
    with pytest.raises(ConfigError, match=r"planar cars have no disturbance\.mass"):
        with_overrides(TRAIN_PRESETS["general"], ["task.disturbance.mass=[0.7,1.3]"])


def test_settings_of_a_disturbance_go_to_text_and_back() -> None:
    task = with_overrides(TASK, ["disturbance.friction=[0.4,1.2]", "disturbance.pose_sigma_m=0.05"])
    assert task.disturbance == DisturbanceConfig(friction=(0.4, 1.2), pose_sigma_m=0.05)
    assert from_json(TaskConfig, to_json(task)) == task
    old = to_json(TASK).replace(',"disturbance":' + to_json(TASK.disturbance), "")
    assert "disturbance" not in old and from_json(TaskConfig, old) == TASK
