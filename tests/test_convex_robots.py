"""Cars that are no symmetric rectangle: a hexagon with its lidar off the centre line, and a long narrow one."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from boxes import box_world, standing

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.agent import RandomAgent
from zebrat_bullet.agents.policy import load_policy
from zebrat_bullet.config import (
    EpisodeConfig,
    FlattenConfig,
    LidarConfig,
    NoiseConfig,
    PhysicsConfig,
    RewardConfig,
    SafetyRegionConfig,
    TaskConfig,
)
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.geometry import footprint_hits, rotation_2d
from zebrat_bullet.report.region_figure import draw_regions
from zebrat_bullet.robot import RobotModel, inspect_robot, load_robot
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.rewards import TERMS, RewardInput, forward_term, middle_term
from zebrat_bullet.types import Command, Commands, Pose2
from zebrat_bullet.world import load_world

NAMES = ("hexagon", "long")
EMBREE = LidarConfig(caster="embree")


@pytest.fixture(params=NAMES)
def robot(request: pytest.FixtureRequest) -> RobotModel:
    return load_robot(request.param)


@pytest.fixture
def simulation(robot: RobotModel) -> Iterator[Simulation]:
    made = Simulation(robot, PhysicsConfig())
    yield made
    made.close()


def test_the_hexagon_has_six_corners_and_its_lidar_off_the_centre_line() -> None:
    hexagon = load_robot("hexagon")
    corners = [[-0.6, 0.0], [-0.3, -0.35], [0.3, -0.35], [0.6, 0.0], [0.3, 0.35], [-0.3, 0.35]]
    np.testing.assert_allclose(hexagon.footprint_base, corners, atol=1e-6)
    np.testing.assert_allclose(hexagon.lidar_xyz_base, [0.18, 0.12, 0.75])


def test_the_long_car_is_1_8_by_0_5_m_with_its_lidar_near_the_rear() -> None:
    long = load_robot("long")
    np.testing.assert_allclose(long.footprint_base, [[-0.9, -0.25], [0.9, -0.25], [0.9, 0.25], [-0.9, 0.25]])
    np.testing.assert_allclose(long.lidar_xyz_base, [-0.7, 0.0, 0.75])


def test_they_drive_straight(simulation: Simulation) -> None:
    simulation.reset(Pose2(0.0, 0.0, 0.0))
    for _ in range(50):
        state = simulation.step(Command(0.6, 0.0))
    assert state.pose.x == pytest.approx(6.0, abs=0.06)  # less what the start from rest costs
    assert abs(state.pose.y) < 2e-3 and abs(state.pose.yaw) < 1e-3


@pytest.mark.parametrize("steering_rad", [0.6, -0.6])
def test_they_turn_with_wheelbase_over_tan_steering(
    simulation: Simulation, robot: RobotModel, steering_rad: float
) -> None:
    state = simulation.reset(Pose2(0.0, 0.0, 0.0))
    for _ in range(60):
        before, state = state, simulation.step(Command(0.6, steering_rad))
    turned = (state.pose.yaw - before.pose.yaw + math.pi) % (2 * math.pi) - math.pi
    rear = np.array([(p.x, p.y) for p in (before.pose, state.pose)])
    rear += [robot.rear_axle_x_m * np.array([math.cos(p.yaw), math.sin(p.yaw)]) for p in (before.pose, state.pose)]
    radius = np.hypot(*(rear[1] - rear[0])) / (2 * math.sin(abs(turned) / 2))
    assert radius == pytest.approx(robot.wheelbase_m / math.tan(0.6), rel=0.005)
    assert math.copysign(1.0, turned) == math.copysign(1.0, steering_rad)


def poses_at_a_wall(robot: RobotModel, gap_m: float) -> list[Pose2]:
    """Return poses `gap_m` before the wall x >= 1: each side flush with it, then each corner pointing at it."""
    outline = robot.footprint_base
    sides = np.roll(outline, -1, axis=0) - outline
    flush = [-math.atan2(-dx, dy) for dx, dy in sides]
    pointing = [yaw + 0.2 for yaw in flush]
    reaches = [float((outline @ rotation_2d(yaw).T)[:, 0].max()) for yaw in flush + pointing]
    return [Pose2(1.0 - reach - gap_m, 0.0, yaw) for reach, yaw in zip(reaches, flush + pointing, strict=True)]


@pytest.mark.parametrize("name", ["zebrat", *NAMES])
def test_physics_and_the_exact_check_agree_to_a_tenth_of_a_millimetre(name: str) -> None:
    robot = load_robot(name)
    world = box_world(((1.0, 1.2), (-3.0, 3.0), (0.0, 1.0)))
    simulation = Simulation(robot, PhysicsConfig())
    simulation.set_world(world)
    try:
        for gap_m in (1e-4, -1e-4):
            for pose in poses_at_a_wall(robot, gap_m):
                simulation.reset(pose)
                assert simulation.step(Command(0.0, 0.0)).contact == (gap_m < 0), (pose, gap_m)
                assert footprint_hits(world.walls, robot.footprint_base, pose) == (gap_m < 0)
    finally:
        simulation.close()


def test_the_lidar_sees_a_wall_flush_with_any_side_as_the_region_expects(robot: RobotModel) -> None:
    region = make_region(robot, SafetyRegionConfig(), 360)
    lidar = Lidar(robot, EMBREE, NoiseConfig(), FlattenConfig())
    lidar.set_world(box_world(((1.0, 1.2), (-6.0, 6.0), (0.0, 1.0))))
    n_sides = len(robot.footprint_base)
    for gap_m in (2e-3, -2e-3):  # a beam loses up to a millimetre of its range to float32 and the band
        for pose in poses_at_a_wall(robot, gap_m)[:n_sides]:
            scan = lidar.scan(standing(pose.x, pose.y, pose.yaw), np.random.default_rng(0))
            assert region.measure(scan).collision == (gap_m < 0)


def test_a_lidar_yawed_by_whole_scan_steps_gives_the_same_scan() -> None:
    """The scan is about the car's heading, so the region needs to know nothing of the mount's yaw."""
    robot = load_robot("hexagon")
    yawed = replace(robot, lidar_rpy=np.array([0.0, 0.0, math.radians(37.0)]))
    world = box_world(((1.0, 1.2), (-3.0, 3.0), (0.0, 1.0)), ((-2.0, 3.0), (1.0, 1.1), (0.0, 1.0)))
    scans = []
    for model in (robot, yawed):
        lidar = Lidar(model, EMBREE, NoiseConfig(), FlattenConfig())
        lidar.set_world(world)
        scans.append(lidar.scan(standing(0.1, 0.2, 0.3), np.random.default_rng(0)).ranges_m)
    np.testing.assert_allclose(scans[1], scans[0], atol=1e-4)


@pytest.mark.parametrize("resolution_m", [0.03, 0.095, 1.0])
def test_they_are_driven_paid_and_recorded_whatever_the_number_of_bearings(
    robot: RobotModel, resolution_m: float
) -> None:
    task = TaskConfig(
        robot=str(robot.urdf_path),
        lidar=EMBREE,
        region=SafetyRegionConfig(resolution_m=resolution_m),
        episode=EpisodeConfig(max_steps=5),
    )
    drive = Drive(task, load_world("track_1"))
    try:
        record = run_episode(drive, RandomAgent(0.6, 0.6), seed=0, episode=0)
    finally:
        drive.close()
    n = len(drive.region.indices)
    assert record.obs_m.shape[1] == n
    assert record.terms.shape[1] == len(TERMS) and np.isfinite(record.terms).all()


def test_with_few_bearings_the_sums_of_the_reward_end_straight_back() -> None:
    """ZebraT at 1 m: back, corner, right, corner, ahead, corner, left, corner. V_obs counts 1, 2, 4, ... 128 m."""
    robot, config = load_robot("zebrat"), RewardConfig(discount=1.0)
    region = make_region(robot, SafetyRegionConfig(resolution_m=1.0), 360)
    assert (len(region.indices), region.right, region.front, region.left) == (8, 2, 4, 6)
    obs = np.float32(2.0) ** np.arange(8)
    speed, none = np.array([1.0]), np.array([0.0])
    step = RewardInput(region.clearances(obs[None]), region, speed, Commands(speed, none), config, none)
    assert forward_term(step) == 2 * 16 + 8 + 32 + 4 + 64 + 2 + 128 + 1 + 1
    assert middle_term(step) == -(64 - 4) - (128 - 2) - (1 - 1)


def test_a_policy_of_another_number_of_bearings_is_refused_with_both_numbers() -> None:
    task = TaskConfig(robot="long", lidar=EMBREE)
    drive = Drive(task, load_world("track_1"))
    try:
        with pytest.raises(PolicyError, match="expects 32 bearings, the reading has 50"):
            run_episode(drive, load_policy("shipped"), seed=0, episode=0)
    finally:
        drive.close()


def test_a_policy_is_refused_on_a_car_with_as_many_bearings_that_lie_otherwise() -> None:
    assert len(make_region(load_robot("hexagon"), SafetyRegionConfig(), 360).indices) == 32
    with pytest.raises(PolicyError, match="'shipped' was trained on the robot 'zebrat', whose bearings lie otherwise"):
        load_agent("shipped", TaskConfig(robot="hexagon"))
    load_agent("shipped", TaskConfig(robot=str(load_robot("zebrat").urdf_path)))


def test_the_figure_of_their_regions_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / "regions.png"
    draw_regions({name: inspect_robot(name) for name in NAMES}, SafetyRegionConfig(), path)
    assert path.read_bytes().startswith(b"\x89PNG")
