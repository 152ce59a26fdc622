"""When a planar car touches a wall: against shapely, at every corner of every shipped robot."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from boxes import box_world
from numpy.typing import NDArray
from planar_cars import AS_BUILT, drive, planar, stand, world_poses
from poses import near_wall_poses, placed

from zebrat_bullet.config import PhysicsConfig, TaskConfig
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.planar.simulation import PlanarSimulation
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.task.episode import anywhere_poses
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, load_world
from zebrat_bullet.world.generate import generate_track

NO_RAYS = np.array([0])
N = 1500


def gaps(world: World, robot: RobotModel, poses: list[Pose2]) -> NDArray[np.float64]:
    """Return the (N,) distances in m between outlines and the faces of the walls, 0 where they cross."""
    return shapely.distance(shapely.polygons(placed(robot.footprint_base, poses)), world.walls.boundary)


def touched(world: World, poses: list[Pose2], robot: str = "zebrat", margin_m: float = 0.0) -> NDArray[np.bool_]:
    """Return which of N cars that stand at these poses touch a wall."""
    sim = planar(world, len(poses), TaskConfig(robot=robot), indices=NO_RAYS, margin_m=margin_m)
    stand(sim, [(pose.x, pose.y, pose.yaw) for pose in poses])
    sim.step()
    return sim.contact.copy()


@pytest.mark.parametrize("name", ["zebrat", "hexagon", "long"])
@pytest.mark.parametrize("world", ["big_track", "real_3", "generated"])
def test_contact_is_where_the_outlines_cross(name: str, world: str) -> None:
    place = generate_track(np.random.default_rng(4)) if world == "generated" else load_world(world)
    robot = load_robot(name)
    poses = near_wall_poses(place, robot, N, np.random.default_rng(11))
    gap = gaps(place, robot, poses)
    decided = (gap > 1e-5) | (gap == 0.0) & ~grazing(place, robot, poses)
    hits = touched(place, poses, name)
    wrong = np.flatnonzero(decided & (hits != (gap == 0.0)))
    assert not len(wrong), (len(wrong), poses[wrong[0]], gap[wrong[0]])
    assert decided.mean() > 0.99 and 0.2 < hits.mean() < 0.8


def grazing(world: World, robot: RobotModel, poses: list[Pose2]) -> NDArray[np.bool_]:
    """Return which outlines cross a wall's face so little that one shrunk by 10 um does not."""
    shrunk = shapely.buffer(shapely.polygons(placed(robot.footprint_base, poses)), -1e-5, join_style="mitre")
    return ~shapely.intersects(shrunk, world.walls.boundary)


def test_contact_begins_with_the_gap_at_zero() -> None:
    wall = box_world(((0.6, 1.0), (-2.0, 2.0), (0.0, 1.0)))
    poses = [Pose2(0.1 + by, 0.0, 0.0) for by in (-1e-5, 1e-5)]  # the nose is 0.5 m ahead of the middle
    assert touched(wall, poses).tolist() == [False, True]
    turned = [Pose2(0.3 + by, 0.0, np.pi / 2) for by in (-1e-5, 1e-5)]  # and its side 0.3 m beside it
    assert touched(wall, turned).tolist() == [False, True]


@pytest.mark.parametrize("thick_m", [0.3, 0.01, 0.001])
@pytest.mark.parametrize("speed", [0.6, -0.6])
def test_no_car_drives_through_a_wall_however_thin(thick_m: float, speed: float) -> None:
    """A physics step moves it 5 mm at most, and it stops in the one that touches: no end reaches further in."""
    side = np.sign(speed)
    x = sorted((side * 1.5, side * (1.5 + thick_m)))
    sim = planar(box_world((tuple(x), (-2.0, 2.0), (0.0, 1.0))), 50, indices=NO_RAYS)
    stand(sim, [(side * back, 0.0, 0.0) for back in np.linspace(0.0, 0.12, 50)])
    deep = first_touch(sim, speed) * side + 0.5 - 1.5
    assert ((deep > -1e-6) & (deep < 0.0051)).all()


def first_touch(sim: PlanarSimulation, speed: float) -> NDArray[np.float64]:
    """Drive straight on, and return the (N,) x at which each car first touched a wall; nan where it did not."""
    x = np.full(len(sim.pose), np.nan)
    for _ in range(14):
        at = drive(sim, [(speed, 0.0)])[-1, :, 0]
        x = np.where(np.isnan(x) & sim.contact, at, x)
    return x


def test_a_post_thinner_than_the_spacing_of_any_rays_stops_the_car() -> None:
    post = box_world(((1.5, 1.501), (0.2, 0.201), (0.0, 1.0)))
    sim = planar(post, indices=NO_RAYS)
    stand(sim, (0.0, 0.0, 0.0))
    assert 1.0 - 1e-6 < first_touch(sim, 0.6)[0] < 1.0051


def test_a_margin_fires_at_that_distance() -> None:
    wall = box_world(((2.0, 3.0), (-2.0, 2.0), (0.0, 1.0)))
    ahead = [Pose2(1.4 + by, 0.0, 0.0) for by in (-1e-4, 1e-4)]  # nose at 1.9
    assert touched(wall, ahead, margin_m=0.1).tolist() == [False, True]
    sim = planar(wall, indices=NO_RAYS, margin_m=0.1)
    stand(sim, (0.0, 0.0, 0.0))
    assert 1.4 - 1e-6 < first_touch(sim, 0.6)[0] < 1.4051


def test_of_a_range_of_margins_each_episode_draws_its_own() -> None:
    wall = box_world(((2.0, 3.0), (-2.0, 2.0), (0.0, 1.0)))
    poses = [Pose2(1.48, 0.0, 0.0)] * 4000  # nose at 1.98, within a tenth of the margins
    drive = PlanarDrive(TaskConfig(), [wall], len(poses), margin_m=(0.0, 0.2 - 1e-9))
    share = []
    for _ in range(2):
        drive.begin_at(np.zeros(len(poses), dtype=np.int32), poses)
        drive.sim.step()
        share.append(drive.sim.contact.copy())
    assert abs(np.mean(share) - 0.9) < 0.02
    assert (share[0] != share[1]).any()


def test_tracks_of_a_family_may_have_a_margin_of_their_own() -> None:
    wall = box_world(((2.0, 3.0), (-2.0, 2.0), (0.0, 1.0)))
    worlds = [replace(wall, family=family) for family in ("narrowing", "corners", "")]
    near, touched_in = [Pose2(1.45, 0.0, 0.0)] * len(worlds), []  # nose at 1.95
    for margin_m in ({"narrowing": 0.01, "other": 0.06}, {"other": 0.01, "corners": (0.055, 0.06)}):
        drive = PlanarDrive(TaskConfig(), worlds[:1], len(near), margin_m=margin_m)
        drive.add_worlds(worlds[1:])
        drive.begin_at(np.arange(3, dtype=np.int32), near)
        drive.sim.step()
        touched_in.append(drive.sim.contact.tolist())
    assert touched_in == [[False, True, True], [False, True, False]]


def test_a_margin_never_fires_late_and_at_a_corner_no_earlier_than_a_mitre(robot: RobotModel) -> None:
    """Corner to corner the gap is measured along a side's normal: at most the distance, and at least 0.7 of it."""
    world, margin = load_world("big_track"), 0.05
    poses = near_wall_poses(world, robot, N, np.random.default_rng(12))
    gap, hits = gaps(world, robot, poses), touched(world, poses, margin_m=margin)
    assert hits[gap < margin - 1e-5].all()
    assert not hits[gap > margin * 2.0].any()
    assert (hits & (gap > margin)).sum() < 0.05 * N


def test_looking_only_where_a_wall_can_be_reached_finds_what_looking_at_every_step_does(robot: RobotModel) -> None:
    world = load_world("track_2")
    n, rng = 300, np.random.default_rng(5)
    starts = anywhere_poses(world, robot, rng, n)
    commands = rng.uniform((0.2, -0.6), (0.6, 0.6), (20, n, 2)).astype(np.float32)
    seldom = planar(world, n, indices=NO_RAYS)
    every = planar(world, n, TaskConfig(physics=PhysicsConfig(control_step_s=1 / 120)), indices=NO_RAYS)
    stand(seldom, starts)
    stand(every, starts)
    running = np.ones(n, bool)
    for command in commands:
        seldom.command[:] = every.command[:] = command
        seldom.step()
        hit, stood = np.zeros(n, bool), world_poses(every)
        for _ in range(24):
            every.state()["clear"][:] = 0.0  # looks anew
            every.step()
            stood[~hit] = world_poses(every)[~hit]
            hit |= every.contact
        alike = running & (hit == seldom.contact)
        apart = np.abs(stood - world_poses(seldom)).max(axis=1)
        assert alike.sum() >= running.sum() - 1  # a touch within a rounding may be seen a step later
        assert np.median(apart[alike]) < 1e-4 and apart[alike].max() < 6e-3
        running &= ~hit & ~seldom.contact
    assert 0.2 < running.mean() < 0.9


def test_a_car_placed_anew_has_touched_nothing() -> None:
    wall = box_world(((0.6, 1.0), (-2.0, 2.0), (0.0, 1.0)))
    sim = planar(wall, indices=NO_RAYS)
    stand(sim, (0.2, 0.0, 0.0))
    drive(sim, [(0.6, 0.0)])
    assert sim.contact[0]
    stand(sim, (-1.0, 0.0, 0.0), dynamics=AS_BUILT)
    assert not sim.contact[0]
    drive(sim, [(0.6, 0.0)])
    assert not sim.contact[0] and world_poses(sim)[0, 0] > -0.95
