"""Paths that a car can drive: checked against shapely, hand-worked arcs, and places that leave no other way."""

import math

import numpy as np
import pytest
import shapely

from zebrat_bullet.errors import ConfigError, PlanError
from zebrat_bullet.planning.arc_path import (
    ArcPath,
    axle_pose,
    clearances,
    footprint_about_axle,
    outlines,
    sweep_factor,
)
from zebrat_bullet.planning.arc_search import separation
from zebrat_bullet.planning.footprint_check import index_walls, outline_of
from zebrat_bullet.planning.hybrid_a_star import HybridAStarConfig, plan_path
from zebrat_bullet.planning.shortest_path import shortest_length_m
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import load_world

TIGHTEST_M = 0.56 / math.tan(0.6)
ORIGIN = Pose2(0.0, 0.0, 0.0)


def corridor(width: float, *line: tuple[float, float]) -> shapely.MultiPolygon:
    """Return walls 0.1 m thick on both sides of a line that begins along +x, and across its beginning."""
    inside = shapely.LineString(line).buffer(width / 2, cap_style="flat", join_style="mitre")
    around = shapely.LineString([(line[0][0] - 0.1, line[0][1]), *line])
    outside = around.buffer(width / 2 + 0.1, cap_style="flat", join_style="mitre")
    return shapely.MultiPolygon(shapely.get_parts(outside.difference(inside)).tolist())


def random_poses(walls: shapely.MultiPolygon, n: int) -> np.ndarray:
    x, y, x_end, y_end = walls.bounds
    return np.random.default_rng(0).uniform((x, y, -math.pi), (x_end, y_end, math.pi), (n, 3))


@pytest.mark.parametrize("name", ["track_3", "real_2"])
def test_the_compiled_separation_is_never_too_long_and_0_exactly_at_a_contact(name: str, robot: RobotModel) -> None:
    walls = load_world(name).walls
    poses = random_poses(walls, 3000)
    index, outline = index_walls(walls, robot), outline_of(footprint_about_axle(robot))
    found = np.array([separation(index, outline, *pose, 0.0) for pose in poses])
    truth = shapely.distance(walls.boundary, outlines(poses, robot))
    assert 500 < (truth == 0.0).sum() < 2500
    assert ((found <= 0.0) == (truth == 0.0)).all()
    assert (found <= truth + 1e-9).all()
    # Short only where a corner of the car faces the end of a wall, and then by the square root of 2.
    near = (truth > 0.0) & (truth < index.reach_m)
    assert (found[near] >= truth[near] / math.sqrt(2.0) - 1e-9).all()
    assert np.isclose(found, np.minimum(truth, index.reach_m))[truth > 0.0].mean() > 0.8


@pytest.mark.parametrize(("direction", "side"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_a_quarter_circle_has_its_length_and_the_curvature_of_its_wheels(direction: int, side: int) -> None:
    turn = direction * side * math.pi / 2.0
    end = (2.0 * direction, 2.0 * side, turn)
    path = ArcPath(np.array([(0.0, 0.0, 0.0), end]), np.array([direction]))
    assert path.lengths_m == pytest.approx([math.pi])
    assert path.curvatures == pytest.approx([0.5 * side])
    assert path.lateral_errors_m() == pytest.approx([0.0], abs=1e-12)
    poses, arcs = path.sample(0.01)
    assert len(poses) == 316 and (arcs == 0).all()
    assert np.hypot(poses[:, 0], poses[:, 1] - 2.0 * side) == pytest.approx(2.0)


def test_a_pose_beside_its_arc_and_one_behind_it_show_as_lateral_errors() -> None:
    aside = ArcPath(np.array([(0.0, 0.0, 0.0), (1.0, 0.1, 0.0)]), np.array([1]))
    behind = ArcPath(np.array([(0.0, 0.0, 0.0), (-1.0, 0.0, 0.0)]), np.array([1]))
    assert aside.lateral_errors_m() == pytest.approx([0.1])
    assert behind.lateral_errors_m() == pytest.approx([1.0])


def test_the_outer_front_corner_moves_fastest(robot: RobotModel) -> None:
    # 0.771 m ahead of the axle, 0.3 m outside it: DESIGN's 1.359 m about a turning centre 0.819 m away.
    assert sweep_factor(robot, 1.0 / TIGHTEST_M) == pytest.approx(1.359 / 0.819, abs=2e-3)
    assert sweep_factor(robot, 0.0) == 1.0


def test_along_a_straight_corridor_the_path_is_straight(robot: RobotModel) -> None:
    plan = plan_path(corridor(1.2, (-1.0, 0.0), (5.0, 0.0)), robot, ORIGIN, np.array([6.0, 0.0]))
    assert plan.path.n_reversals == 0 and plan.margin_m == 0.03
    assert plan.path.turns_rad == pytest.approx(0.0)
    # The lidar, at x = 0.4, comes within 0.3 m of the goal in steps of 0.2 m.
    assert plan.path.lengths_m.sum() == pytest.approx(5.4)


def test_a_path_is_drivable_and_keeps_its_margin(robot: RobotModel) -> None:
    world = load_world("track_7")
    plan = plan_path(world.walls, robot, world.start.pose, world.waypoints[-1])
    poses, _ = plan.path.sample(0.01)
    assert plan.path.poses_world[0] == pytest.approx(axle_pose(world.start.pose, robot))
    assert np.abs(plan.path.curvatures).max() <= 1.0 / TIGHTEST_M + 1e-9
    assert plan.path.lateral_errors_m().max() < 1e-9
    assert clearances(poses, robot, world.walls).min() >= plan.margin_m


def test_a_car_that_must_leave_forward_side_first_turns_round_with_one_reversal(robot: RobotModel) -> None:
    # The exit lies behind the car, and too far to reverse to at twice the price.
    walls = shapely.union_all(
        [shapely.box(2, -1.1, 2.1, 1.1), shapely.box(-8, 1, 2, 1.1), shapely.box(-8, -1.1, 2, -1)]
    )
    plan = plan_path(shapely.MultiPolygon([walls]), robot, ORIGIN, np.array([-10.0, 0.0]))
    assert plan.path.n_reversals == 1
    assert plan.path.directions[-1] == 1
    assert abs(plan.path.poses_world[-1, 2]) == pytest.approx(math.pi, abs=0.5)


def test_a_hairpin_too_tight_for_one_go_takes_reversals(robot: RobotModel) -> None:
    # Outer walls 2.30 m apart, and a U-turn in one go needs 2.50 m.
    walls = corridor(1.1, (-1.2, 0.0), (3.0, 0.0), (3.0, 1.2), (-3.0, 1.2))
    plan = plan_path(walls, robot, ORIGIN, np.array([-4.0, 1.2]))
    assert plan.path.n_reversals == 2
    assert clearances(plan.path.sample(0.005)[0], robot, walls).min() > 0.01


@pytest.mark.parametrize(("width", "most"), [(1.0, 0), (0.9, 4)])
def test_a_tight_corner_takes_few_reversals_and_keeps_its_margin_between_samples(width, most, robot) -> None:
    walls = corridor(width, (-1.2, 0.0), (3.0, 0.0), (3.0, 4.0))
    plan = plan_path(walls, robot, ORIGIN, np.array([3.0, 4.8]), HybridAStarConfig(save_reversals=True))
    assert plan.path.n_reversals <= most
    assert clearances(plan.path.sample(0.0005)[0], robot, walls).min() >= plan.margin_m


def test_a_narrower_margin_is_taken_where_it_saves_reversals(robot: RobotModel) -> None:
    walls = corridor(1.1, (-1.2, 0.0), (3.0, 0.0), (3.0, 4.0))
    goal = np.array([3.0, 4.8])
    wide = plan_path(walls, robot, ORIGIN, goal, HybridAStarConfig(margins_m=(0.08, 0.03)))
    chosen = plan_path(walls, robot, ORIGIN, goal, HybridAStarConfig(margins_m=(0.08, 0.03), save_reversals=True))
    assert wide.path.n_reversals > 0 and wide.margin_m == 0.08
    assert chosen.path.n_reversals == 0 and chosen.margin_m == 0.03


def test_a_start_nearer_to_a_wall_than_the_margin_is_left(robot: RobotModel) -> None:
    walls = corridor(1.4, (-1.0, 0.0), (5.0, 0.0))
    plan = plan_path(walls, robot, Pose2(0.0, 0.38, 0.0), np.array([6.0, 0.0]))
    poses, _ = plan.path.sample(0.01)
    assert clearances(poses[:1], robot, walls) == pytest.approx([0.02])
    assert plan.margin_m >= 0.01
    assert clearances(poses, robot, walls).min() >= min(plan.margin_m, 0.008)
    assert clearances(poses[220:], robot, walls).min() >= plan.margin_m


def test_where_there_is_no_way_the_error_says_what_was_asked(robot: RobotModel) -> None:
    walls = corridor(0.75, (-1.2, 0.0), (3.0, 0.0), (3.0, 4.0))
    with pytest.raises(PlanError, match=r"\(3\.00, 4\.80\) that keeps 0\.003 m from the walls") as refusal:
        plan_path(walls, robot, ORIGIN, np.array([3.0, 4.8]))
    assert not refusal.value.proven


def test_a_car_at_its_goal_has_nowhere_to_go(robot: RobotModel) -> None:
    plan = plan_path(corridor(1.2, (-1.0, 0.0), (5.0, 0.0)), robot, ORIGIN, np.array([0.5, 0.0]))
    assert plan.path.poses_world == pytest.approx(np.array([(-0.271, 0.0, 0.0)]))
    assert plan.path.n_reversals == 0 and plan.path.lengths_m.sum() == 0.0


def test_a_car_in_a_wall_is_refused(robot: RobotModel) -> None:
    with pytest.raises(PlanError, match="touches a wall where it starts") as refusal:
        plan_path(corridor(1.4, (-1.0, 0.0), (5.0, 0.0)), robot, Pose2(0.0, 0.41, 0.0), np.array([6.0, 0.0]))
    assert refusal.value.proven


@pytest.mark.parametrize(
    "wrong",
    [
        *({"arc_m": 0.0}, {"n_steering": 2}, {"margins_m": ()}, {"margins_m": (0.1, 0.0)}, {"max_nodes": 1}),
        *({"greed": 0.9}, {"reverse_cost": -1.0}, {"reversal_cost": float("nan")}, {"margins_m": (float("nan"),)}),
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict) -> None:
    with pytest.raises(ConfigError):
        HybridAStarConfig(**wrong)


def test_the_shortest_way_round_a_corner_is_two_tangents_and_an_arc() -> None:
    # A disc of 0.3 m goes from (-3, 2) under the tip (0, 0) of a wall to (3, 2), the lower end of the line.
    wall = shapely.MultiPolygon([shapely.box(-0.001, 0.0, 0.001, 9.0)])
    line = np.array([(3.0, 2.0), (3.0, 9.0)])
    tangent = math.sqrt(13.0 - 0.09)
    turned = 2.0 * (math.atan2(2.0, 3.0) + math.asin(0.3 / math.sqrt(13.0)))
    expected = 2.0 * tangent + 0.3 * turned
    found = shortest_length_m(wall, np.array([-3.0, 2.0]), line, 0.3)
    assert expected - 0.02 < found <= expected


def test_the_shortest_way_through_nothing_is_the_straight_and_through_a_wall_there_is_none() -> None:
    far = shapely.MultiPolygon([shapely.box(0.0, 5.0, 1.0, 6.0)])
    ring = shapely.Polygon(shapely.box(-2, -2, 2, 2).exterior, [shapely.box(-1, -1, 1, 1).exterior])
    line = np.array([(4.0, -1.0), (4.0, 1.0)])
    assert shortest_length_m(far, np.zeros(2), line, 0.2) == pytest.approx(4.0)
    assert shortest_length_m(shapely.MultiPolygon([ring]), np.zeros(2), line, 0.2) == math.inf
