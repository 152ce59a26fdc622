"""MuJoCo, the second engine: the same car drives by the same numbers, meets the same walls and sees them alike."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import shapely
from boxes import box_world, standing
from numpy.typing import NDArray
from own_cars import ROS_JOINTS, OwnCar
from poses import near_wall_poses, placed, upright_world

from zebrat_bullet.cli import main
from zebrat_bullet.config import FlattenConfig, LidarConfig, NoiseConfig, PhysicsConfig, TaskConfig, with_engine
from zebrat_bullet.config_text import from_json, to_json
from zebrat_bullet.errors import ActionError, ConfigError, SimulationError
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.evaluation.records import load_record
from zebrat_bullet.robot import RobotModel, load_robot, named_robot
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.sim.mujoco.simulation import MujocoSimulation
from zebrat_bullet.sim.mujoco.walls import convex_prisms
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command, Dynamics, Pose2, RobotState
from zebrat_bullet.world import load_world
from zebrat_bullet.world.world import World

pytest.importorskip("mujoco")

SMALL_CAR = str(Path(__file__).parent / "data" / "small_car.urdf")
CARS = ("zebrat", "hexagon", "long", SMALL_CAR)
ORIGIN = Pose2(0.0, 0.0, 0.0)
AHEAD = Command(0.6, 0.0)
FRONT_WALL = ((1.0, 1.1), (-2.0, 2.0), (0.0, 1.0))
Simulate = Callable[..., MujocoSimulation]


@pytest.fixture
def simulate(robot: RobotModel) -> Simulate:
    """Makes simulations in MuJoCo, `simulate(robot=..., world=..., **physics settings)`."""

    def make(robot: RobotModel = robot, world: World | None = None, **physics: float) -> MujocoSimulation:
        made = MujocoSimulation(robot, PhysicsConfig(engine="mujoco", **physics))
        if world is not None:
            made.set_world(world)
        made.reset(ORIGIN)
        return made

    return make


@pytest.fixture
def bullet(robot: RobotModel) -> Iterator[Simulation]:
    made = Simulation(robot, PhysicsConfig())
    yield made
    made.close()


def drive(simulation: Simulation | MujocoSimulation, command: Command, n_steps: int) -> list[RobotState]:
    return [simulation.step(command) for _ in range(n_steps)]


def circle_radius(states: list[RobotState], robot: RobotModel) -> float:
    """Return the least-squares circle's radius of the rear axle: x^2 + y^2 = 2 a x + 2 b y + (r^2 - a^2 - b^2)."""
    x = robot.rear_axle_x_m
    points = np.array([(s.pose.x + x * math.cos(s.pose.yaw), s.pose.y + x * math.sin(s.pose.yaw)) for s in states])
    a, b, c = np.linalg.lstsq(np.column_stack([2 * points, np.ones(len(points))]), (points**2).sum(axis=1))[0]
    return math.sqrt(c + a * a + b * b)


@pytest.mark.parametrize("car", CARS, ids=lambda car: Path(car).stem)
@pytest.mark.parametrize(("speed", "steering"), [(0.6, 0.55), (-0.6, -0.55)])
def test_every_car_drives_the_circle_of_its_wheelbase(
    simulate: Simulate, car: str, speed: float, steering: float
) -> None:
    robot = load_robot(car)
    states = drive(simulate(robot), Command(speed, steering), 40)[10:]
    assert circle_radius(states, robot) == pytest.approx(robot.wheelbase_m / math.tan(0.55), rel=0.01)
    assert states[-1].steering_rad == pytest.approx(steering, abs=0.002)
    assert states[-1].speed_mps == pytest.approx(speed, rel=0.02)
    assert states[-1].yaw_rate_radps == pytest.approx(speed * math.tan(steering) / robot.wheelbase_m, rel=0.02)


@pytest.mark.parametrize("car", CARS, ids=lambda car: Path(car).stem)
def test_ten_metres_straight_drift_under_a_centimetre_and_it_brakes_at_once(simulate: Simulate, car: str) -> None:
    simulation = simulate(load_robot(car))
    states = drive(simulation, AHEAD, 85)
    assert states[-1].pose.x > 10.0
    assert max(abs(state.pose.y) for state in states) < 0.01
    assert max(abs(state.height_m) for state in states) < 0.002
    assert max(abs(state.roll) + abs(state.pitch) for state in states) < 0.005
    assert states[-1].wheel_rad[:2] - states[-2].wheel_rad[:2] == pytest.approx(
        np.full(2, 0.6 * 0.2 / load_robot(car).wheel_radius_m), rel=0.01
    )
    braked = simulation.step(Command(0.0, 0.0))
    assert braked.pose.x - states[-1].pose.x < 0.09 and abs(braked.speed_mps) < 0.02


@pytest.mark.parametrize("car", CARS, ids=lambda car: Path(car).stem)
def test_a_standing_car_does_not_creep(simulate: Simulate, car: str) -> None:
    simulation = simulate(load_robot(car))
    simulation.reset(Pose2(3.0, -2.0, -1.2))
    first = drive(simulation, Command(0.0, 0.3), 10)[-1]
    rest = drive(simulation, Command(0.0, 0.3), 50)[-1]
    assert first.steering_rad == pytest.approx(0.3, abs=0.002)
    assert rest.pose == pytest.approx(first.pose, abs=1e-5)


def test_left_and_right_are_mirror_images(simulate: Simulate) -> None:
    simulation = simulate()
    manoeuvre = [(0.6, 0.5)] * 15 + [(-0.4, -0.6)] * 10 + [(0.5, 0.1)] * 15
    ends = []
    for side in (1.0, -1.0):
        simulation.reset(ORIGIN)
        states = [simulation.step(Command(speed, side * steering)) for speed, steering in manoeuvre]
        ends.append([(s.pose.x, side * s.pose.y, side * s.pose.yaw, side * s.steering_rad) for s in states])
    np.testing.assert_allclose(ends[0], ends[1], atol=0.01)


def random_drive(simulation: Simulation | MujocoSimulation, dynamics: Dynamics, n_steps: int = 25) -> NDArray:
    """Return the (n, 3) poses under commands that change once a second."""
    rng = np.random.default_rng(3)
    simulation.reset(ORIGIN, dynamics)
    command, poses = AHEAD, []
    for k in range(n_steps):
        if k % 5 == 0:
            command = Command(*rng.uniform(-0.6, 0.6, 2).tolist())
        poses.append(simulation.step(command).pose)
    return np.array(poses)


@pytest.mark.parametrize(
    "dynamics",
    [
        Dynamics(),
        Dynamics(acceleration=0.3),
        Dynamics(steering_rate=0.05),
        Dynamics(steering_offset_rad=0.1, speed=0.7),
        Dynamics(delay_s=0.1),
    ],
    ids=["as built", "weak motors", "slow steering", "askew and slow", "late"],
)
def test_both_engines_move_the_car_alike_and_obey_its_dynamics(
    simulate: Simulate, bullet: Simulation, dynamics: Dynamics
) -> None:
    here, there = random_drive(simulate(), dynamics), random_drive(bullet, dynamics)
    assert np.abs(here - there)[:, :2].max() < 0.03
    assert np.abs(here - there)[:, 2].max() < 0.03
    if dynamics != Dynamics():
        assert np.abs(random_drive(simulate(), Dynamics()) - here)[:, :2].max() > 0.04  # and it makes a difference


def fingerprint() -> str:
    """Return what a drive comes to, to the last bit."""
    simulation = MujocoSimulation(load_robot("zebrat"), PhysicsConfig(engine="mujoco"))
    simulation.set_world(box_world(FRONT_WALL))
    return random_drive(simulation, Dynamics(acceleration=0.8, delay_s=0.05)).tobytes().hex()


def test_a_used_simulation_and_another_process_drive_the_same_bit_for_bit(simulate: Simulate) -> None:
    used = simulate(world=box_world(((0.6, 0.7), (-1.0, 1.0), (0.0, 1.0))))
    drive(used, Command(0.6, 0.6), 15)
    used.set_world(box_world(FRONT_WALL))
    drive(used, AHEAD, 5)
    dynamics = Dynamics(acceleration=0.8, delay_s=0.05)
    random_drive(used, Dynamics(acceleration=0.3), 10)
    assert random_drive(used, dynamics).tobytes().hex() == fingerprint()
    code = f"import sys; sys.path[:0] = {sys.path!r}; import test_mujoco as t; print(t.fingerprint())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().splitlines()[-1] == fingerprint()


def test_walls_are_cut_into_convex_pieces_that_fill_them_exactly() -> None:
    for name in ("track_4", "track_8", "real_2"):
        world = load_world(name)
        pieces = [shapely.Polygon(corners) for corners, _, _ in convex_prisms(world)]
        assert all(piece.area == pytest.approx(piece.convex_hull.area, rel=1e-9) for piece in pieces)
        assert shapely.union_all(pieces).symmetric_difference(world.walls).area < 1e-6


@pytest.mark.parametrize(("car", "name"), [("zebrat", "track_4"), ("hexagon", "real_2"), ("long", "track_8")])
def test_contact_is_where_the_polygons_meet(simulate: Simulate, car: str, name: str) -> None:
    robot, world = load_robot(car), load_world(name)
    poses = near_wall_poses(world, robot, 400, np.random.default_rng(1))
    outlines = shapely.polygons(placed(robot.footprint_base, poses))
    gaps = shapely.distance(outlines, world.walls)
    overlaps = shapely.area(shapely.intersection(outlines, world.walls))
    simulation = simulate(robot, world)
    wrong = []
    for pose, gap, overlap in zip(poses, gaps, overlaps, strict=True):
        simulation.reset(pose)
        touches = bool(simulation.touches())
        if touches != (gap == 0.0) and not (gap < 1e-5 and overlap < 1e-6):
            wrong.append((pose, touches, gap, overlap))
    assert not wrong and 50 < (gaps == 0.0).sum() < 350


def test_a_wall_stops_the_car_and_contact_says_so(simulate: Simulate) -> None:
    simulation = simulate(world=box_world(FRONT_WALL))
    free = drive(simulation, AHEAD, 3)
    assert free[-1].pose.x < 0.45 and not any(state.contact for state in free)  # its front is 0.5 m ahead
    pushed = drive(simulation, AHEAD, 10)
    assert pushed[-1].contact and not pushed[-1].unseen_contact
    assert pushed[-1].pose.x == pytest.approx(0.5, abs=0.01)
    assert pushed[-1].speed_mps == pytest.approx(0.0, abs=0.03)
    assert not drive(simulation, Command(-0.6, 0.0), 3)[-1].contact
    simulation.reset(Pose2(0.45, 0.0, 0.0))
    assert simulation.step(AHEAD).contact
    assert not simulation.reset(ORIGIN).contact and not simulation.step(AHEAD).contact


def test_contact_with_a_low_obstacle_is_unseen(simulate: Simulate) -> None:
    world = upright_world(shapely.box(1.0, -0.5, 1.2, 0.5), shapely.box(-1.1, -2.0, -1.0, 2.0), top_m=0.2)
    simulation = simulate(world=replace(world, low_obstacles=shapely.MultiPolygon([shapely.box(1.0, -0.5, 1.2, 0.5)])))
    simulation.reset(Pose2(0.3, 0.0, 0.0))
    ahead = drive(simulation, AHEAD, 3)[-1]
    assert ahead.contact and ahead.unseen_contact
    simulation.reset(Pose2(-0.3, 0.0, 0.0))
    behind = drive(simulation, Command(-0.6, 0.0), 3)[-1]
    assert behind.contact and not behind.unseen_contact


def test_steered_wheels_clear_the_body_and_a_wall_that_the_body_clears(simulate: Simulate) -> None:
    # At full lock the inner wheel reaches out to 0.245 + 0.15 sin 0.773 = 0.35; the wall is 2 cm beside the body.
    simulation = simulate(world=box_world(((-5.0, 5.0), (0.32, 0.42), (0.0, 1.0))))
    states = drive(simulation, Command(0.0, 0.6), 6)
    assert states[-1].knuckle_rad == pytest.approx([0.773, 0.485], abs=0.01)
    assert not any(state.contact for state in states)


@pytest.mark.parametrize("name", ["track_4", "real_3"])
def test_its_rays_give_the_cloud_of_embree_to_a_millimetre(simulate: Simulate, robot: RobotModel, name: str) -> None:
    world = load_world(name)
    simulation = simulate(world=world)
    lidars = [
        Lidar(robot, LidarConfig(caster=caster), NoiseConfig(), FlattenConfig(), simulation.client)
        for caster in ("mujoco", "embree")
    ]
    rng = np.random.default_rng(5)
    for x, y in world.centre_line[10:-10:15]:
        state = simulation.reset(Pose2(float(x), float(y), rng.uniform(-3.0, 3.0)))
        clouds = []
        for lidar in lidars:
            lidar.set_world(world)
            clouds.append(lidar.sweep(state, rng).ranges_m)
        assert np.quantile(np.abs(clouds[0] - clouds[1]), 0.999) < 1e-3  # a ray along an edge may pass or hit
        assert (clouds[0] < 6.0).mean() > 0.5


def test_rays_pass_through_the_car_and_meet_floor_and_walls_of_the_latest_world(
    simulate: Simulate, robot: RobotModel
) -> None:
    simulation = simulate(world=box_world(FRONT_WALL))
    lidar = Lidar(
        robot, LidarConfig(caster="mujoco", n_channels=1, elevation_min_rad=-0.5, elevation_max_rad=-0.5),
        NoiseConfig(), FlattenConfig(), simulation.client,
    )  # fmt: skip
    floor_m = robot.lidar_xyz_base[2] / math.sin(0.5)
    ranges = lidar.sweep(standing(), np.random.default_rng(0)).ranges_m
    assert ranges[0] == pytest.approx(floor_m, abs=1e-4)  # to the back, over the car's own body
    assert ranges[180] == pytest.approx((1.0 - robot.lidar_xyz_base[0]) / math.cos(0.5), abs=1e-4)
    simulation.set_world(box_world())
    assert lidar.sweep(standing(), np.random.default_rng(0)).ranges_m[180] == pytest.approx(floor_m, abs=1e-4)


def test_a_users_car_is_driven_as_pybullet_drives_it(simulate: Simulate, tmp_path: Path) -> None:
    OwnCar(names=dict(ROS_JOINTS)).write(tmp_path, "mine.urdf")
    robot = load_robot(named_robot(str(tmp_path / "mine.urdf"), [f"{k}={v}" for k, v in ROS_JOINTS.items()]))
    assert robot.plain_urdf is not None
    bullet = Simulation(robot, PhysicsConfig())
    apart = np.abs(random_drive(simulate(robot), Dynamics()) - random_drive(bullet, Dynamics()))
    bullet.close()
    assert apart[:, :2].max() < 0.05


def test_commands_and_states_that_are_not_finite_are_refused_and_leave_no_file(
    simulate: Simulate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    simulation = simulate()
    with pytest.raises(ActionError):
        simulation.step(Command(math.nan, 0.0))
    with pytest.raises(SimulationError, match="finite"):
        simulation.reset(Pose2(0.0, math.nan, 0.0))
    simulation._scene.data.qvel[0] = math.nan
    with pytest.raises(SimulationError, match="lost the car"):
        simulation.step(AHEAD)
    simulation.reset(ORIGIN)
    assert drive(simulation, AHEAD, 10)[-1].speed_mps == pytest.approx(0.6, rel=0.03)
    assert os.listdir(tmp_path) == []  # MuJoCo would log where one stands


def test_the_engine_stays_what_was_asked_for_and_old_settings_are_pybullets() -> None:
    asked = with_engine(TaskConfig(), "mujoco")
    assert (asked.physics.engine, asked.lidar.caster) == ("mujoco", "mujoco")
    assert as_trained(asked, "shipped", own_robot=True) == (asked, [])
    old = json.loads(to_json(TaskConfig()))
    del old["physics"]["engine"]
    assert from_json(TaskConfig, json.dumps(old)) == TaskConfig()
    with pytest.raises(ConfigError, match="engine must be one of bullet, mujoco, got 'ode'"):
        PhysicsConfig(engine="ode")


@pytest.mark.parametrize(("engine", "caster"), [("mujoco", "bullet"), ("bullet", "mujoco")])
def test_the_caster_of_the_other_engine_is_refused(engine: str, caster: str) -> None:
    task = replace(with_engine(TaskConfig(), engine), lidar=LidarConfig(caster=caster))
    with pytest.raises(ConfigError, match=f"caster '{caster}' casts in a"):
        Drive(task, load_world("track_2"))


def test_without_the_package_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("zebrat_bullet.sim.engine.find_spec", lambda name: None)
    for command in (["evaluate", "--agent", "shipped"], ["video"]):
        assert main([*command, "--sim", "mujoco"]) == 2
        assert "pip install 'zebrat-bullet[mujoco]'" in capfd.readouterr().err


def test_evaluate_drives_in_mujoco_and_the_record_says_so_and_replays(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    given = ["--episodes", "1", "--workers", "1", "--json", "--sim", "mujoco", "--set", "task.episode.max_steps=12"]
    common = ["evaluate", "--agent", "shipped", "--randomise", *given]
    assert main([*common, "--worlds", "track_2", "--out", str(tmp_path)]) == 0
    score = json.loads(capfd.readouterr().out.splitlines()[-1])["track_2"]
    assert (score["engine"], score["caster"], score["causes"]) == ("mujoco", "mujoco", {"timeout": 1})
    path = tmp_path / "records" / "track_2" / "episode_0000.npz"
    record = load_record(path)
    assert record.engine == "mujoco" and record.pose[-1, 0] - record.pose[0, 0] > 0.5
    assert main(["replay", str(path), "--json"]) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["exact"]
    elsewhere = replace(record, task=to_json(with_engine(from_json(TaskConfig, record.task), "bullet")))
    assert elsewhere.engine == "bullet"
    assert main([*common, "--generated", "1", "--out", str(tmp_path / "g")]) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["causes"]["timeout"] == 1


def test_an_env_of_this_engine_says_which_caster_goes_with_it() -> None:
    with pytest.raises(ConfigError, match=r"got MuJoCo's; with that engine let lidar.caster be 'mujoco' or 'embree'"):
        gymnasium.make("ZebraT/Track2-v0", task={"physics": {"engine": "mujoco"}})
    gymnasium.make("ZebraT/Track2-v0", task={"physics": {"engine": "mujoco"}}, caster="mujoco").close()
