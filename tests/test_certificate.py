"""Certificates prove what they say, and nothing else passes for one."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from zebrat_bullet.assets import list_assets
from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import AssetError, ConfigError, PlanError, WorldError
from zebrat_bullet.planning.arc_path import ArcPath, along_arc, axle_pose, outlines
from zebrat_bullet.planning.certificate import (
    Certificate,
    _shortest_m,
    check_certificate,
    guaranteed_clearance_m,
    load_certificate,
    save_certificate,
)
from zebrat_bullet.planning.certify import certify, certify_all
from zebrat_bullet.planning.no_way import proves_no_way
from zebrat_bullet.robot import RobotModel, load_robot, most_steering_rad
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, generate_tracks, load_world
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.elements import Straight, Turn
from zebrat_bullet.world.schema import StartSpec, WorldSpec


@pytest.fixture(scope="module")
def world() -> World:
    return load_world("track_6")


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    return load_certificate("track_6")


def test_every_shipped_world_has_a_certificate_and_nothing_else_has() -> None:
    assert list_assets("worlds/certificates", ".json") == list_assets("worlds", ".yaml")


@pytest.mark.parametrize("name", list_assets("worlds", ".yaml"))
def test_a_shipped_certificate_holds(name: str, robot: RobotModel) -> None:
    certificate = load_certificate(name)
    check_certificate(load_world(name), robot, certificate)
    assert certificate.world == name
    assert certificate.n_reversals == 0 and certificate.clearance_m > 0.07
    assert 0.5 * certificate.length_m < certificate.shortest_m < certificate.length_m


def corner(width: float, turn_deg: float = 90.0) -> World:
    """Return a sharp corner between two straights, tighter than the rules for shipped worlds allow."""
    straight = Straight(straight=4.0, width=width)
    spec = WorldSpec(
        name=f"corner-{width}",
        start=StartSpec(at_m=1.5, range_x_m=0.0, range_y_m=0.0, range_yaw_rad=0.0),
        segments=[straight, Turn(turn=turn_deg), straight],
    )
    return build_world(spec, Path(spec.name))


def test_a_path_holds_by_geometry_that_knows_nothing_of_the_search(robot: RobotModel) -> None:
    tracks = list(generate_tracks(range(40, 44), robot=robot))
    for world in [*tracks, corner(0.95), corner(0.9)]:
        made = certify(world, robot)
        poses = np.array(made.path)
        assert made.clearance_m >= 0.003
        for (x, y, yaw), after, direction in zip(poses, poses[1:], made.directions, strict=False):
            # Stepped by hand: a circle about a point on the rear axle's line, or a straight.
            turn = after[2] - yaw
            chord = np.hypot(*(after[:2] - (x, y)))
            length = chord if abs(turn) < 1e-9 else chord * (turn / 2) / np.sin(turn / 2)
            assert abs(turn) / length <= np.tan(0.6) / robot.wheelbase_m
            distance = np.append(np.arange(0.0, length, 0.002), length)
            yaws = yaw + turn * distance / length
            steps = direction * np.diff(distance)
            middle = (yaws[1:] + yaws[:-1]) / 2
            xs = x + np.append(0.0, np.cumsum(steps * np.cos(middle)))
            ys = y + np.append(0.0, np.cumsum(steps * np.sin(middle)))
            assert (xs[-1], ys[-1]) == pytest.approx(after[:2], abs=1e-4)
            cars = outlines(np.column_stack([xs, ys, yaws]), robot)
            assert shapely.distance(world.walls, cars).min() >= made.clearance_m - 1e-4
            assert shapely.distance(world.walls, shapely.union_all(cars)) >= made.clearance_m - 1e-4
        lidar = poses[-1, :2] + 0.671 * np.array([np.cos(poses[-1, 2]), np.sin(poses[-1, 2])])
        assert world.past_open_line(*lidar)


@pytest.mark.parametrize("margin", [0.003, 0.02, 0.06])
def test_no_drive_keeps_less_than_the_margin_asked_for(margin: float, robot: RobotModel) -> None:
    for world in generate_tracks(range(50, 54), robot=robot):
        assert certify(world, robot, margin_m=margin).clearance_m >= margin


def test_a_start_nearer_to_a_wall_than_the_margin_shows_in_the_certificate(world: World, robot: RobotModel) -> None:
    at = world.start.pose._replace(y=world.start.pose.y + 0.57)
    near = replace(world, start=replace(world.start, pose=at))
    made = certify(near, robot, margin_m=0.05)
    assert made.start_clearance_m < 0.05
    assert 0.39 * made.start_clearance_m <= made.clearance_m <= made.start_clearance_m
    check_certificate(near, robot, made)


def test_the_clearance_of_a_path_is_its_smallest_between_samples_too(robot: RobotModel) -> None:
    # A post 5 mm beside the car's left side, half a metre on: no pose at an end of the arc is near it.
    post = shapely.MultiPolygon([shapely.box(0.5, 0.305, 0.51, 0.4)])
    path = ArcPath(np.array([(-1.0, 0.0, 0.0), (2.0, 0.0, 0.0)]), np.array([1]))
    assert 0.0049 - 1e-9 <= guaranteed_clearance_m(path, post, robot) <= 0.005
    assert guaranteed_clearance_m(path, shapely.MultiPolygon([shapely.box(0.5, 0.299, 0.51, 0.4)]), robot) == 0.0


@pytest.mark.parametrize("width", [0.70, 0.75])
def test_a_corner_too_narrow_for_any_drive_is_proven_impossible(width: float, robot: RobotModel) -> None:
    # A box of 1.0 m by 0.6 m goes round a corner of (0.5 + 0.6) / sqrt(2) = 0.778 m, if it could slide sideways.
    with pytest.raises(PlanError, match="no drive leads out") as refusal:
        certify(corner(width), robot)
    assert refusal.value.proven


def test_a_corner_for_which_no_drive_was_found_is_given_up_and_not_called_impossible(robot: RobotModel) -> None:
    with pytest.raises(PlanError, match="does not prove") as refusal:
        certify(corner(0.79), robot)
    assert not refusal.value.proven


def test_what_has_a_drive_is_never_proven_to_have_none(robot: RobotModel) -> None:
    for world in [corner(0.9), corner(0.9, -90.0), *generate_tracks(range(60, 62), robot=robot)]:
        assert not proves_no_way(world, robot)
    # What slides and turns freely gets through, by a finger's breadth: that no car was shown to do it is no proof.
    assert not proves_no_way(corner(0.785), robot)


def test_many_worlds_are_answered_in_order_the_same_in_processes(robot: RobotModel) -> None:
    worlds = [corner(1.2), corner(0.7), replace(corner(1.1), open_line=None), load_world("real_1")]
    here = list(certify_all(worlds, robot, workers=1))
    assert [type(answer) for answer in here] == [Certificate, PlanError, WorldError, Certificate]
    there = list(certify_all(worlds, robot, workers=2))
    assert there[0] == here[0] and there[3] == here[3]
    assert isinstance(there[1], PlanError) and there[1].proven and str(there[1]) == str(here[1])
    with pytest.raises(ConfigError, match="workers"):
        certify_all(worlds, robot, workers=0)


def test_a_dead_end_that_is_entered_nose_first_is_left_in_reverse(robot: RobotModel) -> None:
    world = corner(1.0)
    pose = world.start.pose
    turned = replace(world, start=replace(world.start, pose=Pose2(pose.x - 0.3, pose.y, np.pi)))
    made = certify(turned, robot)
    assert made.directions[0] == -1
    assert made.path[0] == pytest.approx(tuple(axle_pose(turned.start.pose, robot)), abs=1e-6)
    check_certificate(turned, robot, made)


def test_least_time_of_a_straight_is_its_length_at_full_speed(world: World, robot: RobotModel) -> None:
    # From x = 0 the lidar, at 0.4 m, has 3.6 m to the line at x = 4.
    sides = [shapely.box(-1.5, y, 4.0, y + 0.1) for y in (-0.8, 0.7)]
    straight = replace(
        world,
        walls=shapely.MultiPolygon(sides),
        free_space=shapely.box(-1.5, -0.7, 4.0, 0.7),
        start=replace(world.start, pose=Pose2(0.0, 0.0, 0.0)),
        waypoints=np.array([(5.0, 0.0)]),
        open_line=np.array([(4.0, -0.7), (4.0, 0.7)]),
    )
    made = certify(straight, robot)
    assert made.shortest_m == pytest.approx(3.6, abs=1e-3)
    assert made.least_time_s == pytest.approx(6.0, abs=0.01)
    assert made.path[0] == (-0.271, 0.0, 0.0)
    assert made.clearance_m == pytest.approx(0.4, abs=2e-4)


def driven_to_the_line_m(world: World, certificate: Certificate) -> float:
    poses = np.array(certificate.path)
    poses, _ = ArcPath(poses, np.array(certificate.directions)).sample(0.005)
    lidars = poses[:, :2] + 0.671 * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    past = next(i for i, lidar in enumerate(lidars) if world.past_open_line(*lidar))
    return float(np.hypot(*np.diff(poses[: past + 1, :2], axis=0).T).sum())


def test_no_drive_beats_the_lower_bound_forward_or_backward(robot: RobotModel) -> None:
    backward = corner(1.1)
    pose = backward.start.pose
    backward = replace(backward, start=replace(backward.start, pose=Pose2(pose.x, pose.y, np.pi)))
    shipped = [load_world("track_6"), load_world("track_4")]
    for world in [*shipped, backward, corner(0.9), *generate_tracks(range(70, 74), robot=robot)]:
        made = certify(world, robot)
        assert made.shortest_m <= driven_to_the_line_m(world, made) <= 1.4 * made.shortest_m


@pytest.mark.parametrize(("line", "last"), [([(5.0, 2.0), (0.0, 2.0)], 0.0), ([(-2.0, 4.0), (-2.0, 0.5)], np.pi / 2)])
def test_the_bound_round_the_tip_of_a_wall_is_what_one_works_out_by_hand(line, last, world, robot) -> None:
    # The wall ends at the origin; the car comes from the lower left, rear axle at (-2.271, -0.6), and goes up (a right
    # angle) or back to the left above the wall (a U-turn). Points 0 and 0.0734 m ahead of the axle have discs of 0.229
    # and 0.3 m about them; the second moves faster than the axle, most on the circle of 0.56 m / tan(0.6).
    thin = shapely.MultiPolygon([shapely.box(-9.0, -1e-4, 0.0, 1e-4)])
    start = replace(world.start, pose=Pose2(-2.0, -0.6, 0.0))
    found = _shortest_m(replace(world, walls=thin, start=start), robot, np.array(line), PhysicsConfig())
    bounds = []
    for ahead, radius in [(0.0, 0.229), (7 / 64 * 0.671, 0.3)]:
        x, y = -2.271 + ahead, -0.6
        away = np.hypot(x, y)
        tangent = np.sqrt(away**2 - radius**2)
        arc = radius * (last - np.arctan2(y, x) - np.arccos(radius / away))
        driven = tangent + arc + 2.0 - (0.671 - ahead)
        bounds.append(driven / np.hypot(1.0, ahead * np.tan(0.6) / 0.56))
    assert bounds[0] < bounds[1] - 0.05
    assert bounds[1] - 0.01 < found <= bounds[1] + 1e-3


def random_drive(rng: np.random.Generator, most: float) -> ArcPath:
    """Return a drive from the origin of 2 to 6 arcs, each forward or backward, the last forward."""
    n = int(rng.integers(2, 7))
    directions = np.where(rng.random(n) < 0.3, -1, 1)
    directions[-1] = 1
    poses = [np.zeros(3)]
    for direction in directions:
        length, curvature = rng.uniform(0.2, 1.5), most * float(np.clip(rng.uniform(-1.5, 1.5), -1.0, 1.0))
        poses.append(along_arc(poses[-1], np.array([direction * length]), direction * length * curvature)[0])
    return ArcPath(np.array(poses), directions)


def test_no_random_drive_through_a_tube_made_to_measure_beats_the_bound(world: World, robot: RobotModel) -> None:
    rng, least, n = np.random.default_rng(0), [], 0
    while n < 40:
        path = random_drive(rng, np.tan(0.6) / robot.wheelbase_m)
        poses, _ = path.sample(0.1)
        lidars = poses[:, :2] + 0.671 * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        ahead = np.array([np.cos(poses[-1, 2]), np.sin(poses[-1, 2])])
        line = lidars[-1] + np.outer([-1.0, 1.0], 0.6 * np.array([-ahead[1], ahead[0]]))
        beyond = shapely.Polygon([*line, *(line[::-1] + 0.6 * ahead)])
        if shapely.LineString(lidars[:-1]).distance(shapely.LineString(line)) < 0.01:
            continue  # an earlier crossing, perhaps from outside
        gap = rng.uniform(0.01, 0.1)
        tube = shapely.union_all(outlines(poses, robot)).buffer(gap, join_style="mitre").simplify(0.004)
        walls = shapely.MultiPolygon(
            shapely.get_parts(tube.buffer(0.3, join_style="mitre").difference(tube).difference(beyond)).tolist()
        )
        start = replace(world.start, pose=Pose2(-robot.rear_axle_x_m, 0.0, 0.0))
        made = replace(world, walls=walls, start=start)
        bound, driven = _shortest_m(made, robot, line, PhysicsConfig()), float(path.lengths_m.sum())
        assert bound <= driven + 1e-6
        least.append(bound / driven)
        n += 1
    assert np.quantile(least, 0.9) > 0.95  # the tubes are narrow enough for a bound that is too long to be noticed


def moved(certificate: Certificate, i: int, dx: float = 0.0, dyaw: float = 0.0) -> tuple:
    path = [list(pose) for pose in certificate.path]
    path[i][0] += dx
    path[i][2] += dyaw
    return tuple(map(tuple, path))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: {"path": moved(c, 2, dx=0.01)}, "no arc joins"),
        (lambda c: {"path": moved(c, 0, dx=-0.3)}, "start range"),
        (lambda c: {"path": c.path[:3], "directions": c.directions[:2]}, "past the open line"),
        (lambda c: {"path": c.path[:-1]}, "needs a direction"),
        (lambda c: {"directions": (0, *c.directions[1:])}, "needs a direction"),
        (lambda c: {"directions": (-1, *c.directions[1:])}, "no arc joins"),
        (lambda c: {"clearance_m": c.clearance_m + 0.001}, "another clearance"),
        (lambda c: {"start_clearance_m": c.start_clearance_m + 0.01}, "another clearance where it starts"),
        (lambda c: {"n_reversals": 1}, "another number of reversals"),
        (lambda c: {"length_m": c.length_m - 0.1}, "another length"),
        (lambda c: {"shortest_m": c.shortest_m + 0.1}, "another lower bound"),
        (lambda c: {"least_time_s": c.least_time_s - 1.0}, "another least time"),
        (lambda c: {"sha256": "0" * 64}, "not those certified"),
    ],
)
def test_a_forged_certificate_is_refused(change, message, world, robot, certificate) -> None:
    with pytest.raises(PlanError, match=message):
        check_certificate(world, robot, replace(certificate, **change(certificate)))


def test_a_path_that_cuts_a_corner_is_refused(robot: RobotModel) -> None:
    world, certificate = load_world("real_1"), load_certificate("real_1")
    # Straight on where the corridor turns left, through the wall.
    begin = certificate.path[0]
    through = replace(certificate, path=(begin, (begin[0] + 6.0, *begin[1:])), directions=(1,))
    with pytest.raises(PlanError, match="too near to a wall"):
        check_certificate(world, robot, through)


def test_a_bend_tighter_than_the_wheels_can_steer_is_refused(world, robot, certificate) -> None:
    # A circle of 0.7 m, three quarters round in three arcs, and 0.819 m is the tightest.
    x, y, _ = certificate.path[0]
    path = tuple((x + 0.7 * np.sin(a), y + 0.7 * (1 - np.cos(a)), a) for a in np.linspace(0, 4.7, 4))
    with pytest.raises(PlanError, match="more than the car can steer"):
        check_certificate(world, robot, replace(certificate, path=path, directions=(1, 1, 1)))


@pytest.mark.parametrize("what", ["wall", "start", "robot"])
def test_a_certificate_is_stale_when_world_or_robot_changed(what, world, robot, certificate) -> None:
    if what == "wall":
        walls = shapely.transform(world.walls, lambda points: points + np.where(points > 5.0, 1e-5, 0.0))
        world = replace(world, walls=walls)
    elif what == "start":
        world = replace(world, start=replace(world.start, range_y_m=0.2))
    else:
        robot = replace(robot, wheelbase_m=0.57)
    with pytest.raises(PlanError, match="not those certified"):
        check_certificate(world, robot, certificate)


def test_another_car_is_certified_with_its_own_numbers(tmp_path: Path) -> None:
    small = load_robot(Path(__file__).parent / "data" / "small_car.urdf")
    world = load_world("track_1")
    made = certify(world, small)
    check_certificate(world, small, made)
    assert made.sha256 != load_certificate("track_1").sha256


def test_a_car_that_steers_less_and_drives_slower_than_the_task_is_certified_within_its_own_limits(
    tmp_path: Path, world: World, robot: RobotModel
) -> None:
    text = (Path(__file__).parent.parent / "urdf/zebrat.urdf").read_text(encoding="utf-8")
    text = text.replace('lower="-0.85" upper="0.85"', 'lower="-0.4" upper="0.4"').replace(
        'velocity="20"', 'velocity="2"'
    )
    (tmp_path / "stiff.urdf").write_text(text, encoding="utf-8")
    stiff = load_robot(tmp_path / "stiff.urdf")
    found = certify(world, stiff)
    check_certificate(world, stiff, found)
    path = ArcPath(np.array(found.path), np.array(found.directions))
    tightest = np.abs(path.turns_rad / path.lengths_m).max() * stiff.wheelbase_m
    assert np.tan(0.3) < tightest <= np.tan(most_steering_rad(stiff)) + 1e-6
    assert found.least_time_s == pytest.approx(found.shortest_m / (2.0 * stiff.wheel_radius_m), abs=0.01)
    with pytest.raises(PlanError, match="the robot or its limits"):
        check_certificate(world, stiff, certify(world, robot))


def test_a_certificate_survives_being_written(tmp_path: Path, certificate: Certificate) -> None:
    path = save_certificate(certificate, tmp_path / "new")
    assert load_certificate(str(path)) == certificate
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(ConfigError):
        load_certificate(str(path))


def test_a_world_without_exit_cannot_be_certified(world: World, robot: RobotModel) -> None:
    with pytest.raises(WorldError, match="open_line"):
        certify(replace(world, open_line=None), robot)


def test_what_is_no_world_is_refused_and_a_car_may_be_named(world: World, robot: RobotModel) -> None:
    with pytest.raises(ConfigError, match=r"a world must be a World, got 'track_2'; give load_world"):
        certify("track_2", robot)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="a robot must be a RobotModel, got 5; name one"):
        certify(world, 5)  # type: ignore[arg-type]
    with pytest.raises(AssetError, match="no urdf named 'zebra'"):
        certify(world, "zebra")


def test_the_command_writes_what_it_could_certify_and_says_what_not(tmp_path: Path) -> None:
    narrow = tmp_path / "narrow.yaml"
    narrow.write_text(
        "name: narrow\nstart: {at_m: 1.2, range_x_m: 0, range_y_m: 0, range_yaw_rad: 0}\n"
        "segments:\n  - {straight: 3, width: 0.7}\n  - {turn: 90}\n  - {straight: 3, width: 0.7}\n",
        encoding="utf-8",
    )
    zebrat = Path(sys.executable).parent / "zebrat"
    command = [zebrat, "worlds", "real_1", narrow, "--certify", tmp_path / "proofs"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert [path.name for path in (tmp_path / "proofs").iterdir()] == ["real_1.json"]
    assert "zebrat worlds: narrow: not certified, proven: no drive leads out" in done.stderr
    assert "real_1: 6.4 m with 0 reversals lead out" in done.stdout and "| narrow |" in done.stdout
