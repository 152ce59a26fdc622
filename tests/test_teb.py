"""TEB: each cost term against numbers worked out by hand, derivatives against finite differences, and whole drives."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from boxes import Box, box_world, standing
from hypothesis import given, settings
from hypothesis import strategies as st

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import EpisodeConfig, LidarConfig, PhysicsConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.notes import Note
from zebrat_bullet.planning.teb import costs as terms
from zebrat_bullet.planning.teb.band import Band, begin, prune, resize
from zebrat_bullet.planning.teb.config import TUNED, costs_for
from zebrat_bullet.planning.teb.costs import (
    Costs,
    Problem,
    associate,
    band_cost,
    clearance,
    normal_equations,
    obstacle_errors,
)
from zebrat_bullet.planning.teb.global_path import GlobalPath
from zebrat_bullet.planning.teb.optimise import Surroundings, optimise
from zebrat_bullet.planning.teb.oscillation import Oscillation
from zebrat_bullet.planning.teb.planner import TebPlanner, first_velocity, steering_angle, via_points
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Pose2

LIMITS = PhysicsConfig()
RADIUS_M = 0.56 / math.tan(0.6)
COSTS = costs_for(TUNED, load_robot("zebrat"), LIMITS)
BOX = np.array([[-0.229, -0.3], [0.771, -0.3], [0.771, 0.3], [-0.229, 0.3]])  # the footprint seen from the rear axle
NO_POINTS, NO_PAIRS, NO_VIAS = np.empty((0, 2)), np.empty((0, 2), np.int64), np.empty((0, 3))
NO_WALLS = np.empty((0, 4))


def problem_of(
    costs: Costs = COSTS,
    walls: np.ndarray = NO_WALLS,
    pairs: np.ndarray = NO_PAIRS,
    scale: float = 1.0,
    vias: np.ndarray = NO_VIAS,
    start: tuple[float, float] = (0.46875, 0.0),
    rotate: float = 0.0,
) -> Problem:
    return Problem(costs, BOX, walls, pairs, scale, vias, np.array(start), rotate)


def test_limits_come_from_the_car() -> None:
    assert COSTS.min_turning_radius_m == pytest.approx(0.8186, abs=1e-4)
    assert COSTS.max_vel_x_mps == 0.6
    assert COSTS.max_vel_theta_radps == pytest.approx(0.6 / RADIUS_M)


# --- terms ---


def test_bounds_are_felt_epsilon_early() -> None:
    assert terms.below(0.4, 0.3, 0.05) == 0.0
    assert terms.below(0.33, 0.3, 0.05) == pytest.approx(0.02)
    assert terms.outside(0.5, -0.2, 0.6, 0.05) == 0.0
    assert terms.outside(0.7, -0.2, 0.6, 0.05) == pytest.approx(0.15)
    assert terms.outside(-0.3, -0.2, 0.6, 0.05) == pytest.approx(0.15)


def test_non_holonomic_is_zero_on_an_arc_and_grows_sideways() -> None:
    # A quarter circle of radius 2 m from heading 0 to heading 90 degrees.
    assert terms.non_holonomic(2.0, 2.0, 0.0, math.pi / 2) == pytest.approx(0.0)
    assert terms.non_holonomic(0.0, 0.1, 0.0, 0.0) == pytest.approx(0.2)  # (cos 0 + cos 0) * 0.1


def test_too_tight_is_the_missing_radius() -> None:
    assert terms.too_tight(0.3, 0.6, 0.8) == pytest.approx(0.3)  # 0.3 m over 0.6 rad is a radius of 0.5 m
    assert terms.too_tight(0.3, -0.6, 0.8) == pytest.approx(0.3)
    assert terms.too_tight(0.3, 0.1, 0.8) == 0.0
    assert terms.too_tight(0.0, 0.0, 0.8) == 0.0


def test_velocity_is_signed_by_the_heading() -> None:
    # 0.2 m in 0.4 s; the smooth sign of 0.2 m is 20 / 21.
    assert terms.velocity(0.2, 0.0, 0.0, 0.4) == pytest.approx(0.5 * 20 / 21)
    assert terms.velocity(0.2, 0.0, math.pi, 0.4) == pytest.approx(-0.5 * 20 / 21)


def test_acceleration_is_the_change_of_speed_over_time() -> None:
    assert terms.acceleration(0.1, 0.4, 0.3) == pytest.approx(1.0)


def test_walls_cost_below_the_distance_to_keep_and_a_little_below_the_inflation_distance() -> None:
    assert obstacle_errors(0.05, COSTS) == pytest.approx((0.15, 0.25))  # 0.15 + 0.05 - 0.05, 0.3 - 0.05
    assert obstacle_errors(0.25, COSTS) == pytest.approx((0.0, 0.05))
    assert obstacle_errors(0.1, COSTS._replace(inflation_dist_m=0.15)) == pytest.approx((0.1, 0.0))


# --- clearance ---


def test_clearance_of_a_wall_beside_ahead_and_off_a_corner() -> None:
    pose = np.zeros(3)
    assert clearance(BOX, pose, np.array([-5.0, 0.5, 5.0, 0.5]), 9.0)[:3] == pytest.approx((0.2, 0.0, -1.0))
    assert clearance(BOX, pose, np.array([1.0, -0.1, 1.0, 0.2]), 9.0)[0] == pytest.approx(0.229)
    assert clearance(BOX, pose, np.array([1.071, 0.7, 5.0, 0.7]), 9.0)[0] == pytest.approx(0.5)  # 0.3, 0.4, 0.5
    turned = np.array([1.0, 2.0, math.pi / 2])
    assert clearance(BOX, turned, np.array([0.0, 3.0, 9.0, 3.0]), 9.0)[0] == pytest.approx(0.229)


def test_a_wall_inside_the_outline_is_minus_its_depth_away() -> None:
    assert clearance(BOX, np.zeros(3), np.array([-5.0, 0.2, 5.0, 0.2]), 9.0)[0] == pytest.approx(-0.1)
    assert clearance(BOX, np.zeros(3), np.array([0.671, 0.0, 5.0, 0.0]), 9.0)[0] == pytest.approx(-0.1)


def test_beyond_what_is_felt_a_lower_bound_is_enough() -> None:
    corner = np.array([1.071, 0.7, 5.0, 0.7])
    assert 0.3 <= clearance(BOX, np.zeros(3), corner, 0.3)[0] <= 0.5


coordinate = st.floats(-1.5, 1.5, allow_subnormal=False)  # shapely finds a line of 5e-324 m infinitely far


@settings(max_examples=200, deadline=None)
@given(st.tuples(coordinate, coordinate, st.floats(-3, 3)), st.tuples(*[coordinate] * 4))
def test_clearance_is_that_of_shapely(pose: tuple[float, ...], ends: tuple[float, ...]) -> None:
    x, y, yaw = pose
    turned = shapely.affinity.translate(shapely.affinity.rotate(shapely.Polygon(BOX), yaw, (0, 0), True), x, y)
    expected = turned.distance(shapely.LineString([ends[:2], ends[2:]]))
    got = clearance(BOX, np.array(pose), np.array(ends), 9.0)[0]
    assert max(got, 0.0) == pytest.approx(expected, abs=1e-6)


def test_derivatives_of_clearance_are_those_of_finite_differences() -> None:
    rng = np.random.default_rng(0)
    checked = 0
    for _ in range(300):
        pose, wall_ends = rng.uniform(-1.2, 1.2, 3), rng.uniform(-1.2, 1.2, 4)

        def at(moved, wall_ends=wall_ends) -> float:
            return clearance(BOX, moved, wall_ends, 9.0)[0]

        slopes = [[(at(pose + h * e) - at(pose)) / h for h in (1e-6, -1e-6)] for e in np.eye(3)]
        if np.abs(np.diff(slopes)).max() < 1e-4:  # not at a kink, where the nearest feature changes
            assert clearance(BOX, pose, wall_ends, 9.0)[1:] == pytest.approx(np.mean(slopes, axis=1), abs=1e-4)
            checked += 1
    assert checked > 250


# --- cost of a band ---


def straight(n: int, step_m: float, dt_s: float) -> Band:
    """Return a band of `n` poses along x."""
    poses = np.zeros((n, 3))
    poses[:, 0] = step_m * np.arange(n)
    return Band(poses, np.full(n - 1, dt_s))


def unknowns_of(band: Band) -> np.ndarray:
    return np.column_stack([band.poses, np.append(band.dt_s, 0.0)]).ravel()


def test_cost_of_a_straight_band_is_its_time_and_its_braking() -> None:
    # Two steps of 0.15 m in 0.3 s: the smooth sign of 0.15 m is 15/16, so 0.46875 m/s. It begins at that speed and
    # brakes in 0.3 s: 1.5625 m/s2, 1.1125 above the 0.5 - 0.05 that is free. Time: 2 * 0.3^2.
    unknowns = unknowns_of(straight(3, 0.15, 0.3))
    assert band_cost(unknowns, problem_of()) == pytest.approx(0.18 + 1.1125**2)


def test_obstacles_via_points_and_turning_directions_add_their_weights() -> None:
    band = straight(3, 0.15, 0.3)
    walls = np.array([[-5.0, 0.4, 5.0, 0.4]])  # 0.1 m beside the footprint
    free = band_cost(unknowns_of(band), problem_of())
    walled = band_cost(unknowns_of(band), problem_of(walls=walls, pairs=np.array([[1, 0]]), scale=2.0))
    assert walled - free == pytest.approx(2.0 * 50.0 * 0.1**2 + 0.1 * 0.2**2)
    pulled = band_cost(unknowns_of(band), problem_of(vias=np.array([[1.0, 0.15, 0.5]])))
    assert pulled - free == pytest.approx(1.0 * 0.5**2)
    band.poses[1, 2] = -0.01  # the first step turns right, the second left
    left, right, none = (band_cost(unknowns_of(band), problem_of(rotate=turn)) for turn in (1.0, -1.0, 0.0))
    assert left - none == pytest.approx(50.0 * 0.01**2)
    assert right - none == pytest.approx(50.0 * 0.01**2)


def crooked_band(rng: np.random.Generator) -> Band:
    """Return a band that breaks every bound."""
    poses = np.column_stack([0.2 * np.arange(8), np.zeros(8), np.zeros(8)]) + rng.normal(0.0, 0.08, (8, 3))
    return Band(poses, rng.uniform(0.1, 0.6, 7))


@pytest.mark.parametrize("seed", range(5))
def test_the_gradient_is_that_of_finite_differences_and_the_ends_are_fixed(seed: int) -> None:
    unknowns = unknowns_of(crooked_band(np.random.default_rng(seed)))
    walls = np.array([[-1.0, 0.35, 3.0, 0.45], [-1.0, -0.4, 3.0, -0.5]])
    pairs = associate(unknowns, BOX, 1.0, walls, 0.5, 1.0)
    vias = np.array([[3.0, 0.5, 0.2]])
    costs = COSTS._replace(weight_kinematics_forward_drive=3.0, weight_kinematics_nh=10.0)
    problem = problem_of(costs, walls, pairs, 2.0, vias, (0.5, -0.3), 1.0)
    _, gradient = normal_equations(unknowns, problem)
    fixed = np.r_[0:3, 28:32]  # first and last pose, and what is no time step
    assert not gradient[fixed].any()
    for i in np.setdiff1d(np.arange(len(unknowns)), fixed):
        step = np.zeros(len(unknowns))
        step[i] = 1e-6
        slope = (band_cost(unknowns + step, problem) - band_cost(unknowns - step, problem)) / 2e-6
        assert gradient[i] == pytest.approx(0.5 * slope, rel=1e-3, abs=1e-4)


def test_the_normal_matrix_predicts_the_cost_where_errors_are_linear() -> None:
    # Time and via points alone: the cost is a parabola, so one undamped step lands at its minimum.
    only = {name: 0.0 for name in COSTS._fields if name.startswith("weight")}
    costs = COSTS._replace(**(only | {"weight_optimaltime": 1.0, "weight_viapoint": 2.0}))
    unknowns = unknowns_of(straight(4, 0.2, 0.3))
    vias = np.array([[1.0, 0.3, 0.1], [2.0, 0.4, -0.1]])
    matrix, gradient = normal_equations(unknowns, problem_of(costs, vias=vias))
    assert not matrix[1:].any()
    moving = matrix[0] > 0.0
    moved = unknowns.copy()
    moved[moving] -= gradient[moving] / matrix[0, moving]
    assert moved[[4, 5, 8, 9]] == pytest.approx([0.3, 0.1, 0.4, -0.1])
    assert moved[3:-1:4] == pytest.approx(0.0, abs=1e-9)


def test_a_pose_feels_every_near_wall_and_the_nearest_on_each_side_beyond() -> None:
    band = straight(3, 0.5, 1.0)
    # Footprint sides at y = +-0.3: distances 0.1, 0.4, 0.5 on the left, 0.6 on the right, and one beyond the cutoff.
    walls = np.array([[-9, y, 9, y] for y in (0.4, 0.7, 0.8, -0.9, -2.0)], float)
    pairs = associate(unknowns_of(band), BOX, 0.83, walls, 0.225, 0.75)
    assert pairs.tolist() == [[1, 0], [1, 1], [1, 3]]


# --- the band ---


def test_a_new_band_heads_along_the_path_as_fast_as_the_car_may() -> None:
    path = np.array([[0.0, 0.0], [0.3, 0.0], [0.6, 0.0], [0.6, 0.3], [0.6, 0.6]])
    band = begin(path, np.array([0.0, 0.0, 0.0]), math.pi / 2, COSTS)
    assert band.poses[:, 2] == pytest.approx([0.0, 0.0, math.pi / 2, math.pi / 2, math.pi / 2])
    assert band.dt_s == pytest.approx([0.5, math.pi / 2 / COSTS.max_vel_theta_radps, 0.5, 0.5])


def test_a_new_band_to_a_goal_behind_drives_backwards() -> None:
    band = begin(np.array([[0.0, 0.0], [-0.3, 0.0], [-0.6, 0.0]]), np.zeros(3), math.pi, COSTS)
    assert math.cos(band.poses[1, 2]) == pytest.approx(1.0)


def test_resizing_keeps_the_time_but_for_what_is_too_much_in_the_last_step() -> None:
    for dt_s in (0.05, 0.1, 0.3, 0.45, 1.0, 3.0):
        band = resize(straight(10, 0.1, dt_s), TUNED)
        assert 9 * dt_s - 0.3 < band.dt_s.sum() < 9 * dt_s + 1e-9
        assert len(band.dt_s) == 3 or (band.dt_s[:-1] > 0.2 - 1e-9).all()
        assert (band.dt_s[:-1] < 0.4 + 1e-9).all()
        assert band.poses[[0, -1], 0] == pytest.approx([0.0, 0.9])


def test_a_long_step_is_split_in_its_middle() -> None:
    band = resize(
        Band(np.array([[0, 0, 0], [1, 0, 0.2], [1.1, 0, 0.2], [1.2, 0, 0.2]], float), np.array([0.7, 0.3, 0.3])),
        TUNED,
    )
    assert band.poses[1] == pytest.approx([0.5, 0.0, 0.1])
    assert band.dt_s == pytest.approx([0.35, 0.35, 0.3, 0.3])


def test_pruning_drops_the_poses_that_the_car_has_passed() -> None:
    start, goal = np.array([0.27, 0.02, 0.1]), np.array([1.05, 0.0, 0.0])
    band = prune(straight(11, 0.1, 0.3), start, goal, 3)
    assert len(band.poses) == 8 and len(band.dt_s) == 7
    assert band.poses[0] == pytest.approx(start) and band.poses[-1] == pytest.approx(goal)
    assert band.poses[1, 0] == pytest.approx(0.4)


def test_a_free_straight_is_driven_just_below_the_speed_limit() -> None:
    path = np.column_stack([np.arange(0.0, 3.01, 0.05), np.zeros(61)])
    around = Surroundings(BOX, NO_WALLS, NO_POINTS, np.array([0.55, 0.0]))
    band = optimise(begin(path, np.zeros(3), 0.0, COSTS), around, TUNED, COSTS)
    assert band is not None
    assert np.abs(band.poses[:, 1:]).max() < 1e-3
    v, omega = first_velocity(band)
    assert 0.5 < v < 0.65 and abs(omega) < 1e-3
    assert (3.0 / 0.65) < band.dt_s.sum() < 7.0


def test_a_band_round_a_corner_keeps_to_the_car_and_off_the_walls_the_same_on_both_sides() -> None:
    path = np.array([[x, 0.0] for x in np.arange(0, 1.8, 0.05)] + [[1.8, y] for y in np.arange(0, 1.6, 0.05)])
    walls = np.array([[-1, 0.8, 1.0, 0.8], [1.0, 0.8, 1.0, 3], [-1, -0.8, 2.6, -0.8], [2.6, -0.8, 2.6, 3]], float)
    bands = []
    for side in (1.0, -1.0):
        mirror = np.array([1.0, side])
        around = Surroundings(BOX, walls * np.tile(mirror, 2), NO_POINTS, np.array([0.5, 0.0]))
        start = begin(path * mirror, np.zeros(3), side * math.pi / 2, COSTS)
        for _ in range(3):  # the second and third start warm
            band = optimise(start, around, TUNED, COSTS)
            assert band is not None
            start = band
        bands.append(band)
    left, right = bands
    assert left.poses == pytest.approx(right.poses * (1, -1, -1), abs=1e-4)
    step = np.diff(left.poses, axis=0)
    assert (np.hypot(step[:, 0], step[:, 1]) / np.maximum(np.abs(step[:, 2]), 1e-9)).min() > 0.75 * RADIUS_M
    slips = [
        terms.non_holonomic(d[0], d[1], a[2], b[2])
        for d, a, b in zip(step, left.poses[:-1], left.poses[1:], strict=True)
    ]
    assert np.abs(slips).max() < 0.01
    assert min(clearance(BOX, pose, wall, 9.0)[0] for pose in left.poses for wall in walls) > 0.1


def test_a_band_that_diverged_is_none() -> None:
    band = straight(5, 0.15, 0.3)
    band.poses[2, 0] = math.inf
    assert optimise(band, Surroundings(BOX, NO_WALLS, NO_POINTS, np.zeros(2)), TUNED, COSTS) is None


# --- from the band to the command ---


def test_the_first_step_gives_speed_and_steering_forwards_and_in_reverse() -> None:
    forwards = Band(np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.1]]), np.array([0.3]))
    assert first_velocity(forwards) == pytest.approx((0.5, 1 / 3))
    backwards = Band(np.array([[0.0, 0.0, 3.1], [0.06, 0.0, -3.1]]), np.array([0.3]))
    assert first_velocity(backwards) == pytest.approx((-0.2, (2 * math.pi - 6.2) / 0.3))
    assert steering_angle(0.5, 0.5 / RADIUS_M, 0.56, 0.7) == pytest.approx(0.6)
    assert steering_angle(-0.5, 0.5 / RADIUS_M, 0.56, 0.7) == pytest.approx(-0.6)
    assert steering_angle(0.1, 3.0, 0.56, 0.6) == 0.6
    assert steering_angle(0.0, 3.0, 0.56, 0.6) == 0.0


def test_the_global_plan_is_cut_ahead_and_forgotten_behind() -> None:
    path = GlobalPath(np.column_stack([np.arange(0.0, 10.01, 0.05), np.zeros(201)]))
    ahead, yaw = path.ahead(np.array([4.0, 0.1]), 3.0, 1.0)
    assert ahead[0] == pytest.approx([3.0, 0.0], abs=0.06)  # no farther than the lookahead in one go
    ahead, yaw = path.ahead(np.array([4.0, 0.1]), 3.0, 1.0)
    assert ahead[[0, -1], 0] == pytest.approx([4.0, 7.0], abs=0.06) and yaw == 0.0
    ahead, _ = path.ahead(np.array([3.0, 0.1]), 3.0, 0.5)
    assert ahead[[0, -1], 0] == pytest.approx([4.0, 5.5], abs=0.06)  # not back, and half as far
    ahead, _ = path.ahead(np.array([7.0, 0.0]), 3.5, 0.5)
    assert ahead[[0, -1], 0] == pytest.approx([7.0, 10.0], abs=0.06)  # the goal within reach is kept
    assert path.distance_to(np.array([8.0, 0.7])) == pytest.approx(0.7)


# --- checks and recoveries ---


def planner_among(*boxes: tuple[float, float, float, float]) -> TebPlanner:
    walls = shapely.MultiPolygon([shapely.box(*box) for box in boxes])
    return TebPlanner(TUNED, load_robot("zebrat"), LIMITS, walls)


def straight_path() -> GlobalPath:
    return GlobalPath(np.column_stack([np.arange(-0.271, 12.0, 0.05), np.zeros(246)]))


def test_an_infeasible_band_stops_the_car_and_halves_the_horizon_for_a_while() -> None:
    planner = planner_among((0.45, -0.5, 0.55, 0.5))  # a wall across the front of the car
    command = planner.plan(standing(), straight_path(), 0.0)
    assert (command.speed_mps, command.steering_rad) == (0.0, 0.0)
    assert planner.band is None
    reach = {}
    for time_s in (0.2, 10.2):
        planner.band = None
        assert planner.plan(standing(x=2.0), straight_path(), time_s).speed_mps > 0.1
        reach[time_s] = planner.band.poses[-1, 0] - planner.band.poses[0, 0]
    assert reach == pytest.approx({0.2: 1.5, 10.2: 3.0}, abs=0.15)


def test_a_wall_between_two_poses_far_apart_is_found() -> None:
    planner = planner_among((1.0, -0.5, 1.02, 0.5))
    leap = Band(np.array([[-0.3, 0.0, 0.0], [1.5, 0.0, 0.0]]), np.array([0.3]))
    assert not planner.feasible(leap)
    leap.poses[:, 1] = 1.0
    assert planner.feasible(leap)


def test_via_points_are_off_by_default_and_evenly_spaced_when_on() -> None:
    local = np.column_stack([np.arange(0.0, 3.01, 0.05), np.zeros(61)])
    assert len(via_points(local, 0.0)) == 0
    points = via_points(local, 0.5)
    assert len(points) == 6
    assert np.diff(points[:, 0]) == pytest.approx(0.5, abs=0.06)


def test_turning_to_and_fro_on_the_spot_is_held_to_one_direction_for_a_while() -> None:
    oscillation = Oscillation(TUNED, 0.2)
    for step in range(24):
        oscillation.update(0.05, (-1.0) ** step, 0.3, 0.2 * step)
        assert oscillation.preferred_turn(0.2 * step) == 0.0  # half of the 10 s must be known
    oscillation.update(0.05, 1.0, 0.3, 4.8)
    assert oscillation.preferred_turn(5.0) == 1.0
    assert oscillation.preferred_turn(14.9) == 0.0
    driving = Oscillation(TUNED, 0.2)
    for step in range(60):
        driving.update(0.9, (-1.0) ** step, 0.3, 0.2 * step)
    assert driving.preferred_turn(12.0) == 0.0


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("dt_hysteresis_s=0.3", "between 0 and dt_ref_s 0.3, got 0.3"),
        ("min_samples=2", "got 2 and 100"),
        ("acc_lim_x_mps2=0", "acc_lim_x_mps2 must be above 0, got 0"),
        ("max_global_plan_lookahead_dist_m=0", "max_global_plan_lookahead_dist_m must be above 0, got 0"),
        ("inflation_radius_m=-3", r"inflation_radius_m must be 0 to 1e\+06, got -3"),
        ("weight_obstacle=nan", r"weight_obstacle must be 0 to 1e\+06, got nan"),
        ("no_inner_iterations=0", "no_inner_iterations must be at least 1, got 0"),
        ("radius=1", "cannot set 'radius=1': write key=value with a key of costmap, dt_ref_s"),
    ],
)
def test_settings_out_of_range_are_refused(setting: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_agent(f"teb_tuned:{setting}", TaskConfig())


# --- drives ---

TASK = TaskConfig(lidar=LidarConfig(caster="embree"), episode=EpisodeConfig(stall_steps=40, max_steps=200))


def wall(x0: float, x1: float, y0: float, y1: float) -> Box:
    return ((x0, x1), (y0, y1), (0.0, 1.0))


def drive(boxes: tuple[Box, ...], goal: tuple[float, float], agent: str, start: Pose2 | None = None) -> EpisodeRecord:
    """Drive one episode from the origin, or `start`, towards a goal, at which the car stops."""
    world = box_world(*boxes)
    begin_at = replace(world.start, pose=start or world.start.pose)
    task_drive = Drive(TASK, replace(world, waypoints=np.array([goal]), start=begin_at))
    try:
        return run_episode(task_drive, load_agent(agent, TASK), 0, 0)
    finally:
        task_drive.close()


def arrives(record: EpisodeRecord, goal: tuple[float, float]) -> bool:
    """Return whether the car came to stand with its rear axle at the goal, untouched."""
    x, y, yaw = record.pose[-1]
    rear = np.array([x - 0.271 * math.cos(yaw), y - 0.271 * math.sin(yaw)])
    return record.outcome == "stall" and bool(np.hypot(*(rear - goal)) < 0.2) and record.min_gap_m > 0.03


CORRIDOR = (
    *(wall(-1.5, 8.0, 0.6, 0.7), wall(-1.5, 8.0, -0.7, -0.6)),
    *(wall(-1.5, -1.4, -0.7, 0.7), wall(8.0, 8.1, -0.7, 0.7)),
)
RIGHT_ANGLE = (  # 1.2 m wide: east along y = 0, then north along x = 4.6
    *(wall(-1.5, 4.0, 0.6, 0.7), wall(3.9, 4.0, 0.6, 8.0), wall(-1.5, 5.3, -0.7, -0.6), wall(5.2, 5.3, -0.7, 8.0)),
    *(wall(-1.5, -1.4, -0.6, 0.6), wall(3.9, 5.3, 8.0, 8.1)),
)
U_TURN = (  # 1.2 m wide round a thin wall: east along y = 0, back along y = -1.3
    *(wall(-1.5, 4.0, -0.7, -0.6), wall(-1.5, 5.3, 0.6, 0.7), wall(5.2, 5.3, -2.0, 0.7), wall(-1.5, 5.3, -2.0, -1.9)),
    wall(-1.5, -1.4, -1.9, 0.6),
)


@pytest.mark.parametrize("radius", [0.3, 0.5])
def test_a_corridor_of_1_2_m_is_driven_in_its_middle_at_full_speed(radius: float) -> None:
    record = drive(CORRIDOR, (6.0, 0.0), f"teb_tuned:inflation_radius_m={radius}")
    assert arrives(record, (6.0, 0.0))
    assert np.abs(record.pose[:, 1]).max() < 0.1
    assert record.pose[45, 0] > 4.0  # 9 s at up to 0.6 m/s


def test_a_right_angle_of_1_2_m_is_driven_in_one_go() -> None:
    record = drive(RIGHT_ANGLE, (4.6, 5.0), "teb_tuned:inflation_radius_m=0.5")
    assert arrives(record, (4.6, 5.0))
    assert record.command[:, 0].min() >= 0.0


def test_with_the_distance_of_the_paper_the_car_stands_to_and_fro_before_that_right_angle() -> None:
    record = drive(RIGHT_ANGLE, (4.6, 5.0), "teb:inflation_radius_m=0.5")
    assert record.outcome == "stall"
    assert record.pose[-1, 1] < 1.0
    assert (record.command[:, 0] < 0.0).sum() > 10


def test_a_u_turn_of_1_2_m_is_driven_with_reversing() -> None:
    record = drive(U_TURN, (1.0, -1.3), "teb_tuned:inflation_radius_m=0.5")
    assert arrives(record, (1.0, -1.3))
    assert record.command[:, 0].min() < 0.0


def test_a_goal_behind_makes_the_car_turn_round_where_there_is_room() -> None:
    room = (
        *(wall(-1.5, 6.0, 1.2, 1.3), wall(-1.5, 6.0, -1.3, -1.2)),
        *(wall(-1.5, -1.4, -1.2, 1.2), wall(6.0, 6.1, -1.2, 1.2)),
    )
    record = drive(room, (0.0, 0.0), "teb_tuned", Pose2(4.0, 0.0, 0.0))
    assert arrives(record, (0.0, 0.0))
    assert abs(record.pose[-1, 2]) > 2.8


def test_a_goal_behind_in_a_dead_end_too_narrow_to_turn_is_not_reached() -> None:
    record = drive(CORRIDOR, (0.0, 0.0), "teb_tuned", Pose2(6.0, 0.0, 0.0))
    assert not arrives(record, (0.0, 0.0))
    assert (record.command[:, 0] < 0.0).any()


def test_where_the_goal_is_behind_walls_the_car_stands_and_that_is_noted() -> None:
    with pytest.warns(Note, match="teb_tuned stands where an episode begins without a plan.*no way from"):
        record = drive(CORRIDOR, (10.0, 0.0), "teb_tuned")
    assert not record.command.any()


def test_the_same_start_gives_the_same_drive() -> None:
    first, second = (drive(U_TURN, (3.0, 0.0), "teb_tuned") for _ in range(2))
    assert np.array_equal(first.command, second.command)
