"""DWA: each critic against numbers worked out by hand, and the planner where its users say it does well or badly."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from boxes import Box, box_world, standing

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.dwa import DwaAgent
from zebrat_bullet.config import EpisodeConfig, LidarConfig, PhysicsConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.notes import Note
from zebrat_bullet.planning.dwa import TUNED, DwaConfig, DwaPlanner, critics, rollouts
from zebrat_bullet.planning.dwa.planner import in_window, pruned
from zebrat_bullet.planning.grid import OccupancyGrid
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, load_world

LIMITS = PhysicsConfig()
RADIUS_M = 0.56 / math.tan(0.6)
TASK = TaskConfig(lidar=LidarConfig(caster="embree"), episode=EpisodeConfig(stall_steps=40))


def test_the_window_is_what_the_car_reaches_in_a_control_step() -> None:
    config = DwaConfig(vx_samples=3, vtheta_samples=5)
    samples = rollouts.velocity_window(0.3, 0.1, config, LIMITS, RADIUS_M)
    # 2.5 m/s2 for 0.2 s is 0.5 m/s: from 0.3 the window is [-0.2, 0.8], cut to [0, 0.6]; 0 is below min_vel_trans.
    assert np.unique(samples[:, 0]).tolist() == pytest.approx([0.3, 0.6])
    # 3.2 rad/s2 for 0.2 s is 0.64 rad/s, but 0.6 m/s on the smallest circle of 0.819 m turns at 0.733 rad/s only.
    fast = samples[samples[:, 0] > 0.5, 1]
    assert fast.tolist() == pytest.approx(
        [-0.54, -0.54 + 1.2733 / 4, 0.0, -0.54 + 1.2733 / 2, -0.54 + 1.2733 * 3 / 4, 0.7333], abs=2e-3
    )
    assert np.abs(samples[:, 1] / samples[:, 0]).max() <= 1 / RADIUS_M + 1e-9


def test_reverse_is_sampled_only_where_it_is_allowed() -> None:
    forward = rollouts.velocity_window(0.0, 0.0, DwaConfig(), LIMITS, RADIUS_M)
    both = rollouts.velocity_window(0.0, 0.0, DwaConfig(allow_reverse=True), LIMITS, RADIUS_M)
    assert forward[:, 0].min() > 0.0 and both[:, 0].min() == -0.5


def test_samples_include_standing_straight_between_left_and_right() -> None:
    assert rollouts.spread(-1.0, 2.0, 3).tolist() == [-1.0, 0.0, 0.5, 2.0]
    assert rollouts.spread(1.0, 2.0, 3).tolist() == [1.0, 1.5, 2.0]
    assert rollouts.spread(0.5, 0.5, 3).tolist() == [0.5]


def test_a_rollout_turns_about_the_rear_axle() -> None:
    samples = np.array([(0.5, 0.0), (0.5, 0.5)])
    config = DwaConfig(sim_time_s=math.pi)
    ways = rollouts.roll_out(Pose2(1.0, 2.0, 0.0), samples, config, rear_axle_x_m=-0.271)
    assert ways[:, 0].tolist() == [[1.0, 2.0, 0.0], [1.0, 2.0, 0.0]]
    assert ways[0, -1] == pytest.approx([1.0 + 0.5 * math.pi, 2.0, 0.0])
    # A quarter circle of 1 m: the axle goes from (0.729, 2) to (1.729, 3), the centre stands 0.271 m ahead of it.
    assert ways[1, -1] == pytest.approx([1.729, 3.271, math.pi / 2])
    assert np.linalg.norm(np.diff(ways[..., :2], axis=1), axis=-1).max() <= 0.5 * math.hypot(1.0, 0.271) * 0.05 + 1e-9


def test_fast_cars_are_checked_with_a_larger_outline() -> None:
    scale = critics.footprint_scale(np.array([0.1, 0.25, 0.425, -0.6]), DwaConfig(), 0.6)
    assert scale.tolist() == pytest.approx([1.0, 1.0, 1.1, 1.2])


def test_the_outline_is_padded_and_dense_and_has_its_corners() -> None:
    points = critics.outline_points(np.array([(-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)]), 0.01, 0.025)
    assert np.abs(points).max(axis=0) == pytest.approx([0.21, 0.11])
    assert np.isclose(points, (0.21, 0.11)).all(axis=1).any()
    steps = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
    assert steps.max() <= 0.025 and steps.sum() == pytest.approx(2 * (0.42 + 0.22))


def test_obstacle_cost_is_the_highest_under_the_outline_and_a_wall_refuses() -> None:
    costs = np.zeros((40, 40), np.uint8)  # 2 m x 2 m
    costs[:, 30] = 80  # x in [1.5, 1.55]
    costs[:, 38] = 254  # x in [1.9, 1.95]
    outline = critics.outline_points(np.array([(-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)]), 0.0, 0.025)

    def cost(x_end: float, scale: float = 1.0) -> float:
        way = np.array([[(x, 1.0, 0.0) for x in np.arange(0.5, x_end + 1e-6, 0.05)]])
        return float(critics.obstacle_costs(costs, np.zeros(2), 0.05, way, outline, np.array([scale]))[0])

    assert cost(1.2) == 0.0  # front at 1.4
    assert cost(1.35) == 80.0  # front at 1.55
    assert cost(1.2, scale=1.6) == 80.0  # front at 1.52
    assert cost(1.75) == math.inf  # front at 1.95
    assert (
        critics.obstacle_costs(costs, np.zeros(2), 0.05, np.array([[(0.1, 1.0, 0.0)]]), outline, np.ones(1))[0]
        == math.inf
    )


def test_grid_distance_counts_steps_round_obstacles() -> None:
    costs = np.zeros((3, 4), np.uint8)
    costs[:2, 1] = 253
    inf = math.inf
    assert critics.grid_distances(costs, np.array([(0, 0)])).tolist() == [[0, inf, 6, 7], [1, inf, 5, 6], [2, 3, 4, 5]]
    costs[2, 1] = 254
    assert critics.grid_distances(costs, np.array([(0, 0), (1, 3), (0, 4), (-1, 0)])).tolist() == [
        [0, inf, 2, 1],
        [1, inf, 1, 0],
        [2, inf, 2, 1],
    ]


def test_end_distance_is_that_of_the_last_pose_and_refuses_what_has_no_way() -> None:
    distances = np.array([[0.0, 1.0, 2.0], [math.inf, 2.0, 3.0]])
    cells = np.array([[(0, 0), (0, 2)], [(1, 0), (1, 1)], [(0, 1), (0, 3)], [(0, 0), (1, 0)]])
    assert critics.end_distances(distances, cells).tolist() == [2.0, math.inf, math.inf, math.inf]
    # A nose may stand where no way leads from: it counts as far as there are cells. Off the grid it may not.
    assert critics.end_distances(distances, cells, stop_on_failure=False).tolist() == [2.0, 2.0, math.inf, 6.0]


def test_noses_stand_ahead() -> None:
    ways = np.array([[(1.0, 2.0, math.pi / 2)]])
    assert critics.shifted(ways, 0.325)[0, 0].tolist() == pytest.approx([1.0, 2.325])


def test_oscillation_refuses_to_turn_back_twice_until_the_car_has_moved() -> None:
    critic = critics.Oscillation(DwaConfig())
    both = np.array([(0.3, 0.0), (-0.3, 0.0)])
    critic.note(Pose2(0.0, 0.0, 0.0), 0.3, 0.0)
    assert critic.allows(both).tolist() == [True, True]
    critic.note(Pose2(0.0, 0.0, 0.0), -0.3, 0.0)
    assert critic.allows(both).tolist() == [False, True]
    critic.note(Pose2(-0.04, 0.0, 0.0), -0.3, 0.0)
    assert critic.allows(both).tolist() == [False, True]
    critic.note(Pose2(-0.06, 0.0, 0.0), -0.3, 0.0)
    assert critic.allows(both).tolist() == [True, True]


def test_the_path_is_pruned_behind_the_car_and_cut_at_the_window() -> None:
    path = np.stack([np.arange(0.0, 10.0, 0.5), np.zeros(20)], axis=1)
    ahead = pruned(path, np.array([4.1, 0.0]))
    assert ahead[0].tolist() == [3.5, 0.0] and ahead[-1].tolist() == [9.5, 0.0]
    assert in_window(ahead, np.array([4.1, 0.0]), 6.0)[-1].tolist() == [7.0, 0.0]
    assert in_window(ahead[:3], np.array([4.1, 0.0]), 6.0).shape == (3, 2)
    assert len(pruned(path, np.array([4.1, 2.0]))) == 0


def open_floor() -> OccupancyGrid:
    """A floor with a wall 5 m behind the origin and nothing else."""
    return OccupancyGrid.of_walls(shapely.MultiPolygon([shapely.box(-5, -5, -4.9, 5)]), also_inside=[(9.0, 5.0)])


def test_prices_are_metres_off_the_path_and_from_its_end_each_times_its_bias(robot: RobotModel) -> None:
    planner = DwaPlanner(DwaConfig(forward_point_distance_m=0.3), robot, LIMITS, open_floor())
    planner.follow(np.stack([np.arange(0.025, 2.05, 0.05), np.full(41, 0.175)], axis=1))
    prices = planner.prices(Pose2(0.025, 0.025, 0.0), np.array([(0.5, 0.0)]))
    # 0.5 m/s for 1.7 s end at x = 0.875: 3 cells of 0.05 m off the path and 23 before its end at x = 2.025. The nose,
    # 0.3 m ahead, is as far from the path, and from a point 0.3 m past its end.
    assert {name: price[0] for name, price in prices.items()} == pytest.approx(
        {
            "oscillation": 0.0,
            "obstacle": 0.0,
            "path": 0.6 * 0.15,
            "alignment": 0.6 * 0.15,
            "goal": 0.8 * (1.15 + 0.15),
            "goal_front": 0.8 * (1.15 + 0.15),
        }
    )


def test_near_the_goal_the_nose_may_leave_the_path(robot: RobotModel) -> None:
    planner = DwaPlanner(DwaConfig(), robot, LIMITS, open_floor())
    planner.follow(np.stack([np.arange(0.025, 0.3, 0.05), np.full(6, 0.175)], axis=1))
    prices = planner.prices(Pose2(0.025, 0.025, 0.0), np.array([(0.5, 0.0)]))
    assert prices["alignment"].tolist() == [0.0] and prices["path"][0] > 0.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_car_steers_back_to_a_path_beside_it_the_same_on_both_sides(side: float, robot: RobotModel) -> None:
    planner = DwaPlanner(DwaConfig(), robot, LIMITS, open_floor())
    planner.follow(np.stack([np.arange(0.0, 8.0, 0.05), np.full(160, 0.525 * side)], axis=1))
    command = planner.command(standing(0.025, 0.025))
    assert command is not None
    assert command.speed_mps == 0.5 and 0.05 < side * command.steering_rad <= 0.6


def test_the_agent_takes_settings_in_its_name() -> None:
    agent = load_agent("dwa:inflation_radius_m=0.3,allow_reverse=true", TASK)
    assert isinstance(agent, DwaAgent)
    assert agent.config == DwaConfig(inflation_radius_m=0.3, allow_reverse=True)
    assert agent.name == "dwa:inflation_radius_m=0.3,allow_reverse=true"
    assert agent.privileged == {"pose", "map", "goal"}
    with pytest.raises(ConfigError, match="cannot set 'radius=1': write key=value with a key of costmap"):
        load_agent("dwa:radius=1", TASK)
    tuned = load_agent("dwa_tuned:sim_time_s=2", TASK)
    assert isinstance(tuned, DwaAgent) and tuned.config == replace(TUNED, sim_time_s=2.0)
    with pytest.raises(ConfigError, match="sim_time_s must be above 0, got -1"):
        load_agent("dwa:sim_time_s=-1", TASK)
    for wrong in ("inflation_radius_m=nan", "window_m=inf", "footprint_padding_m=-0.1"):
        with pytest.raises(ConfigError, match=r"must be 0 to 1e\+06, got"):
            load_agent(f"dwa:{wrong}", TASK)


def wall(x0: float, x1: float, y0: float, y1: float) -> Box:
    return ((x0, x1), (y0, y1), (0.0, 1.0))


def drive(world: World, goal: tuple[float, float], agent: str = "dwa", start: Pose2 | None = None) -> EpisodeRecord:
    """Drive one episode from the origin, or `start`, towards a goal."""
    begin = replace(world.start, pose=start or world.start.pose)
    task_drive = Drive(TASK, replace(world, waypoints=np.array([goal]), start=begin))
    try:
        return run_episode(task_drive, load_agent(agent, TASK), 0, 0)
    finally:
        task_drive.close()


CORRIDOR = (
    wall(-1.5, 8.0, 0.6, 0.7),
    wall(-1.5, 8.0, -0.7, -0.6),
    wall(-1.5, -1.4, -0.7, 0.7),
    wall(8.0, 8.1, -0.7, 0.7),
)


@pytest.mark.parametrize("radius", [0.3, 0.5])
def test_a_corridor_of_1_2_m_is_driven_to_its_goal_where_the_car_stops(radius: float) -> None:
    record = drive(box_world(*CORRIDOR), (6.0, 0.0), f"dwa:inflation_radius_m={radius}")
    assert record.outcome == "stall"
    assert np.linalg.norm(record.pose[-1, :2] - (6.0, 0.0)) < 0.25
    assert record.min_gap_m > 0.1
    assert np.linalg.norm(record.pose[60, :2]) > 4.0  # not crawling: 12 s at up to 0.6 m/s


def test_a_wide_right_angle_is_driven() -> None:
    # Corridors 2 m wide: east along y in [-1, 1], then north along x in [4, 6].
    world = box_world(
        *(wall(-1.5, 4.0, 1.0, 1.1), wall(3.9, 4.0, 1.0, 8.0), wall(-1.5, 6.1, -1.1, -1.0), wall(6.0, 6.1, -1.1, 8.0)),
        *(wall(-1.5, -1.4, -1.0, 1.0), wall(3.9, 6.1, 8.0, 8.1)),
    )
    record = drive(world, (5.0, 5.5))
    assert np.linalg.norm(record.pose[-1, :2] - (5.0, 5.5)) < 0.25


def test_in_a_u_turn_the_settings_of_ros_stop_the_car_short_of_the_wall() -> None:
    world = load_world("track_3")
    record = drive(world, tuple(world.waypoints[-1]))
    assert record.outcome == "stall" and record.min_gap_m > 0.05


def test_a_goal_behind_in_a_dead_end_leaves_the_car_standing_not_crashed() -> None:
    # The car faces the dead end, the goal lies behind it; there is no room to turn and no reverse.
    record = drive(box_world(*CORRIDOR), (0.0, 0.0), start=Pose2(6.0, 0.0, 0.0))
    assert record.outcome == "stall"
    assert record.pose[:, 0].min() > 5.5


def test_with_reverse_the_car_backs_out_of_a_dead_end() -> None:
    record = drive(box_world(*CORRIDOR), (0.0, 0.0), "dwa:allow_reverse=true", start=Pose2(6.0, 0.0, 0.0))
    assert np.linalg.norm(record.pose[-1, :2]) < 0.3


def test_where_the_goal_is_behind_walls_the_car_stands_and_that_is_noted() -> None:
    with pytest.warns(Note, match="dwa stands where an episode begins without a plan.*no way from"):
        record = drive(box_world(*CORRIDOR), (10.0, 0.0))
    assert not record.command.any()


def test_the_same_seed_gives_the_same_drive_bit_for_bit_also_with_a_used_agent() -> None:
    world = load_world("track_2")
    task_drive = Drive(replace(TASK, episode=EpisodeConfig(max_steps=40)), world)
    used, fresh = load_agent("dwa", TASK), load_agent("dwa", TASK)
    first = [run_episode(task_drive, used, 0, episode) for episode in (0, 1, 0)]
    again = run_episode(task_drive, fresh, 0, 0)
    task_drive.close()
    assert np.array_equal(first[0].pose, first[2].pose) and np.array_equal(first[0].pose, again.pose)
    assert not np.array_equal(first[0].pose, first[1].pose)
