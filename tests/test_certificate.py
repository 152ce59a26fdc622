"""Certificates prove what they say, and nothing else passes for one."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from zebrat_bullet.assets import list_assets
from zebrat_bullet.errors import ConfigError, PlanError, WorldError
from zebrat_bullet.planning.certificate import (
    Certificate,
    certify,
    check_certificate,
    load_certificate,
    save_certificate,
)
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, generate_track, load_world


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


def test_generated_tracks_can_be_certified(robot: RobotModel) -> None:
    rng = np.random.default_rng(0)
    for _ in range(3):
        certify(generate_track(rng, robot=robot), robot)


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
    assert made.clearance_m == pytest.approx(0.4 - 0.0025, abs=1e-3)


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
        (lambda c: {"path": c.path[:-1], "directions": c.directions[:-1]}, "past the open line"),
        (lambda c: {"path": c.path[:-1]}, "needs a direction"),
        (lambda c: {"directions": (0, *c.directions[1:])}, "needs a direction"),
        (lambda c: {"directions": (-1, *c.directions[1:])}, "no arc joins"),
        (lambda c: {"clearance_m": c.clearance_m + 0.001}, "another clearance"),
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


def test_a_certificate_survives_being_written(tmp_path: Path, certificate: Certificate) -> None:
    path = save_certificate(certificate, tmp_path / "new")
    assert load_certificate(str(path)) == certificate
    path.write_text("{}")
    with pytest.raises(ConfigError):
        load_certificate(str(path))


def test_a_world_without_exit_cannot_be_certified(world: World, robot: RobotModel) -> None:
    with pytest.raises(WorldError, match="open_line"):
        certify(replace(world, open_line=None), robot)


def test_the_command_writes_what_it_could_certify_and_says_what_not(tmp_path: Path) -> None:
    narrow = tmp_path / "narrow.yaml"
    narrow.write_text(
        "name: narrow\nstart: {at_m: 1.2, range_x_m: 0, range_y_m: 0, range_yaw_rad: 0}\n"
        "segments:\n  - {straight: 3, width: 0.8}\n  - {turn: 90}\n  - {straight: 3, width: 0.8}\n"
    )
    zebrat = Path(sys.executable).parent / "zebrat"
    command = [zebrat, "worlds", "real_1", narrow, "--certify", tmp_path / "proofs"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert [path.name for path in (tmp_path / "proofs").iterdir()] == ["real_1.json"]
    assert "narrow: not certified: found no drive from" in printed
    assert "real_1: 6.2 m with 0 reversals lead out" in printed
