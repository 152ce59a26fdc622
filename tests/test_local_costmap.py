"""The costmap of the live scan: cells against scans made by hand, and what planners do with it that no map can show."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from boxes import Box, box_world, standing

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import DisturbanceConfig, EpisodeConfig, LidarConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.geometry import rotation_2d, to_world
from zebrat_bullet.planning.dwa import DwaConfig, DwaPlanner
from zebrat_bullet.planning.grid import OccupancyGrid
from zebrat_bullet.planning.local_costmap import LocalCostmap
from zebrat_bullet.planning.teb.config import TUNED
from zebrat_bullet.planning.teb.global_path import GlobalPath
from zebrat_bullet.planning.teb.planner import TebPlanner
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import FlatScan, Pose2
from zebrat_bullet.world import World

TASK = TaskConfig(lidar=LidarConfig(caster="embree"), episode=EpisodeConfig(stall_steps=40, max_steps=120))
ORIGIN = Pose2(0.0, 0.0, 0.0)
AHEAD, LEFT = 180, 270


def scan_of(returns_m: dict[int, float]) -> FlatScan:
    """Return a scan of 360 bearings with these returns, nothing in the others."""
    ranges = np.full(360, 6.0, np.float32)
    for bearing, range_m in returns_m.items():
        ranges[bearing] = range_m
    return FlatScan(ranges, 6.0)


def marked(grid: OccupancyGrid) -> np.ndarray:
    """Return the (K, 2) centres of the occupied cells in m, world frame."""
    return grid.centres_of(np.argwhere(grid.occupied))


def test_a_return_marks_its_cell_up_to_2_5_m(robot: RobotModel) -> None:
    lidar_x, lidar_y = robot.lidar_xyz_base[:2]
    costmap = LocalCostmap(robot)
    grid = costmap.see(scan_of({AHEAD: 1.51, LEFT: 2.49, 200: 2.51}), ORIGIN)
    expected = grid.cells_of([(lidar_x + 1.51, lidar_y), (lidar_x, lidar_y + 2.49)])
    assert sorted(map(tuple, np.argwhere(grid.occupied))) == sorted(map(tuple, expected))


def test_a_ray_frees_what_stood_on_its_way_and_one_without_return_frees_nothing(robot: RobotModel) -> None:
    costmap = LocalCostmap(robot)
    (first,) = marked(costmap.see(scan_of({AHEAD: 1.5}), ORIGIN))
    assert marked(costmap.see(scan_of({}), ORIGIN)) == pytest.approx(first[None])
    (second,) = marked(costmap.see(scan_of({AHEAD: 2.2}), ORIGIN))
    assert second[0] - first[0] == pytest.approx(0.7, abs=0.051)
    assert len(marked(costmap.see(scan_of({AHEAD: 5.0}), ORIGIN))) == 0


def test_bearings_that_were_not_cast_neither_mark_nor_free(robot: RobotModel) -> None:
    costmap = LocalCostmap(robot)
    before = marked(costmap.see(scan_of({AHEAD: 1.5}), ORIGIN))
    assert marked(costmap.see(FlatScan(np.full(360, np.nan, np.float32), 6.0), ORIGIN)).tolist() == before.tolist()


def test_the_window_rolls_with_the_car_over_obstacles_that_stay(robot: RobotModel) -> None:
    costmap = LocalCostmap(robot)
    before = marked(costmap.see(scan_of({AHEAD: 2.0, LEFT: 2.0}), ORIGIN))
    for x, y in ((0.52, 0.0), (0.52, -0.7), (-0.3, 0.4)):
        assert marked(costmap.see(scan_of({}), Pose2(x, y, 1.0))) == pytest.approx(before)
    costmap.see(scan_of({}), Pose2(9.0, 0.0, 0.0))
    assert len(marked(costmap.see(scan_of({}), ORIGIN))) == 0


def test_what_an_episode_showed_is_forgotten_at_the_next(robot: RobotModel) -> None:
    costmap = LocalCostmap(robot)
    costmap.see(scan_of({AHEAD: 1.5}), ORIGIN)
    costmap.forget()
    assert len(marked(costmap.see(scan_of({}), ORIGIN))) == 0


def test_the_car_stands_on_no_obstacle(robot: RobotModel) -> None:
    costmap = LocalCostmap(robot)
    half_width_m = float(robot.footprint_base[:, 1].max())
    scan = scan_of({LEFT: half_width_m - 0.1, AHEAD: 1.5})
    assert len(marked(costmap.see(scan, ORIGIN))) == 1
    assert len(marked(costmap.see(scan_of({}), Pose2(1.5 + robot.lidar_xyz_base[0], 0.0, 0.7)))) == 0


def test_an_error_of_the_pose_moves_obstacles_on_the_map_not_relative_to_the_car(robot: RobotModel) -> None:
    scan = scan_of({bearing: 1.0 + 0.01 * bearing for bearing in range(90, 270, 5)})
    true, believed = Pose2(1.0, 2.0, 0.3), Pose2(1.12, 1.9, 0.3 + math.radians(8.0))

    def seen(pose: Pose2) -> tuple[np.ndarray, np.ndarray]:
        world = marked(LocalCostmap(robot).see(scan, pose))
        return world, (world - pose[:2]) @ rotation_2d(pose.yaw)

    def apart(some: np.ndarray, others: np.ndarray) -> float:
        return float(np.linalg.norm(some[:, None] - others, axis=2).min(axis=1).max())

    (world, base), (wrong_world, wrong_base) = seen(true), seen(believed)
    cell_m = 0.05 * math.sqrt(2.0)
    assert apart(base, wrong_base) <= cell_m and apart(wrong_base, base) <= cell_m
    assert apart(wrong_world, to_world(base, believed)) <= cell_m
    assert apart(wrong_world, world) > 0.2  # 8 degrees at 2 m are 0.28 m


def wall(x0: float, x1: float, y0: float, y1: float) -> Box:
    return ((x0, x1), (y0, y1), (0.0, 1.0))


HALL = (  # 3 m wide and 9.5 m long
    *(wall(-1.5, 8.0, 1.5, 1.6), wall(-1.5, 8.0, -1.6, -1.5)),
    *(wall(-1.5, -1.4, -1.6, 1.6), wall(8.0, 8.1, -1.6, 1.6)),
)
IN_THE_WAY = wall(2.6, 3.0, -0.6, 0.2)


def hall(*on_the_map: Box) -> World:
    """Return the hall with an obstacle on its way, as real as its walls, and a map that shows these boxes."""
    world = box_world(*HALL, IN_THE_WAY)
    goal = np.array([(6.0, 0.0)])
    return replace(world, walls=box_world(*on_the_map).walls, waypoints=goal)


def test_a_real_scan_marks_the_walls_it_sees_and_nothing_else(robot: RobotModel) -> None:
    world = hall(*HALL)
    drive = Drive(TASK, world)
    try:
        reading = drive.reset(np.random.default_rng(0), whole_scans=True)
        grid = LocalCostmap(robot).see(reading.scan, drive.state.pose)
    finally:
        drive.close()
    cells = shapely.points(marked(grid))
    real = box_world(*HALL, IN_THE_WAY).walls
    assert shapely.distance(cells, real).max() <= 0.05
    face = [(2.6, y) for y in np.arange(-0.59, 0.2, 0.02)]  # of the obstacle, that the lidar looks at
    assert shapely.distance(shapely.points(face), shapely.union_all(cells)).max() <= 0.05
    assert shapely.distance(shapely.box(3.1, -0.4, 5.0, 0.0), shapely.union_all(cells)) > 0.0  # its shadow is free


def driven(agent: str, world: World, task: TaskConfig = TASK) -> EpisodeRecord:
    task_drive = Drive(task, world)
    try:
        return run_episode(task_drive, load_agent(agent, task), 0, 0)
    finally:
        task_drive.close()


@pytest.mark.parametrize("planner", ["dwa_tuned", "teb_tuned"])
def test_what_is_not_on_the_map_is_hit_by_a_map_based_planner_and_driven_round_by_a_live_one(planner: str) -> None:
    blind = driven(planner, hall(*HALL))
    assert blind.outcome == "collision" and 1.8 < blind.pose[-1, 0] < 3.0
    seeing = driven(f"{planner}:costmap=live", hall(*HALL))
    assert seeing.outcome != "collision" and np.linalg.norm(seeing.pose[-1, :2] - (6.0, 0.0)) < 0.6


def test_a_planner_heeds_the_cells_that_it_saw_last_and_no_longer_its_map(robot: RobotModel) -> None:
    across = shapely.MultiPolygon([shapely.box(0.45, -0.5, 0.55, 0.5)])  # across the front of the car
    blocked = OccupancyGrid.of_walls(across, also_inside=[(-4.0, -4.0), (4.0, 4.0)])
    free = replace(blocked, occupied=np.zeros_like(blocked.occupied))
    line = np.column_stack([np.arange(0.0, 3.0, 0.05), np.zeros(60)])
    teb = TebPlanner(TUNED, robot, TASK.physics, across)
    dwa = DwaPlanner(DwaConfig(), robot, TASK.physics, blocked)
    for grid, drives in ((free, True), (blocked, False), (free, True)):
        teb.see_cells(grid)
        assert (teb.plan(standing(), GlobalPath(line - (0.271, 0.0)), 0.0).speed_mps > 0.1) == drives
        dwa.see(grid)
        dwa.follow(line)
        prices = dwa.prices(ORIGIN, np.array([(0.5, 0.0)]))
        assert math.isfinite(prices["obstacle"][0]) == drives


def test_the_same_episode_is_the_same_drive_with_a_used_agent_and_a_drifting_pose() -> None:
    error = DisturbanceConfig(pose_sigma_m=0.05, pose_sigma_rad=math.radians(3.0))
    task = replace(TASK, episode=EpisodeConfig(max_steps=30), disturbance=error)
    drive = Drive(task, hall(*HALL))
    try:
        for agent in ("dwa:costmap=live", "teb_tuned:costmap=live"):
            used, fresh = load_agent(agent, task), load_agent(agent, task)
            first = [run_episode(drive, used, 0, episode) for episode in (0, 1, 0)]
            assert np.array_equal(first[0].pose, first[2].pose)
            assert np.array_equal(first[0].pose, run_episode(drive, fresh, 0, 0).pose)
            assert not np.array_equal(first[0].pose, first[1].pose)
    finally:
        drive.close()


@pytest.mark.parametrize("planner", ["dwa", "teb", "dwa_tuned", "teb_tuned"])
def test_another_costmap_is_refused(planner: str) -> None:
    with pytest.raises(ConfigError, match="costmap must be one of map, live, got 'odom'"):
        load_agent(f"{planner}:costmap=odom", TASK)
