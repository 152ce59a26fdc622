"""The rays of planar cars against brute force, the 3D lidar and numbers worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from boxes import box_world, standing
from numpy.typing import NDArray
from planar_cars import brute_ranges, planar, stand

from zebrat_bullet.config import LidarConfig, NoiseConfig, SafetyRegionConfig, TaskConfig
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.task.episode import anywhere_poses
from zebrat_bullet.world import World, load_world
from zebrat_bullet.world.generate import generate_track

BACK, RIGHT, AHEAD, LEFT = 0, 90, 180, 270
LIDAR_X_M = 0.4  # ZebraT's, from the middle of the car
WORLDS = ["big_track", "real_2", "track_3", "generated_1", "generated_2"]


def world_of(name: str) -> World:
    kind, _, seed = name.partition("_")
    return generate_track(np.random.default_rng(int(seed))) if kind == "generated" else load_world(name)


def ranges_at(world: World, poses: object, **settings: object) -> NDArray[np.float32]:
    """Return the (N, B) ranges of cars that stand at (N, 3) or (3,) poses."""
    sim = planar(world, np.atleast_2d(poses).shape[0], **settings)
    stand(sim, poses)
    sim.look()
    return sim.ranges


def test_boxes_read_what_they_are_away() -> None:
    boxes = box_world(
        ((2.4, 3.0), (-1.0, 1.0), (0.0, 1.0)),
        ((-4.0, -2.6), (-1.0, 1.0), (0.0, 1.0)),
        ((0.0, 1.0), (1.0, 2.0), (0.0, 1.0)),
        ((0.0, 1.0), (-2.5, -1.5), (0.0, 1.0)),
    )
    (here,) = ranges_at(boxes, (0.0, 0.0, 0.0))
    assert here[[AHEAD, BACK, LEFT, RIGHT]] == pytest.approx([2.0, 3.0, 1.0, 1.5], abs=1e-5)
    assert here[AHEAD + 20] == pytest.approx(2.0 / np.cos(np.radians(20.0)), abs=1e-5)
    (turned,) = ranges_at(boxes, (0.4, -0.4, np.pi / 2))  # the lidar stands where it stood, and looks to the left
    assert turned[[RIGHT, LEFT, AHEAD, BACK]] == pytest.approx([2.0, 3.0, 1.0, 1.5], abs=1e-5)


def test_the_reach_ends_where_the_last_beam_below_the_top_of_a_wall_does() -> None:
    """The beams nearest to the horizon rise and fall by 1 degree; the falling one meets a wall up to 6 m cos 1."""
    horizon = 6.0 * np.cos(np.radians(1.0))
    for away, read in ((horizon - 0.001, horizon - 0.001), (horizon + 0.001, 6.0), (6.5, 6.0)):
        wall = box_world(((LIDAR_X_M + away, 8.0), (-1.0, 1.0), (0.0, 1.0)))
        assert ranges_at(wall, (0.0, 0.0, 0.0))[0, AHEAD] == pytest.approx(read, abs=2e-6)


def test_a_beam_that_meets_the_floor_sees_no_wall_beyond() -> None:
    """One channel falls by 0.2 rad from 0.75 m and leaves the band at 0.05 m, 0.7 / tan 0.2 = 3.453 m away."""
    down = TaskConfig(lidar=LidarConfig(n_channels=1, elevation_min_rad=-0.2, elevation_max_rad=-0.2))
    for away, read in ((0.5, 0.5), (3.45, 3.45), (3.46, 6.0)):
        wall = box_world(((LIDAR_X_M + away, 8.0), (-1.0, 1.0), (0.0, 1.0)))
        assert ranges_at(wall, (0.0, 0.0, 0.0), task=down)[0, AHEAD] == pytest.approx(read, abs=1e-5)


def free_poses(world: World, robot: RobotModel, n: int) -> NDArray[np.float64]:
    """Return (n, 3) poses whose lidar stands in no wall: along the passage, about it, and outside of all there is."""
    rng = np.random.default_rng(7)
    x0, y0, x1, y1 = world.walls.bounds
    about = rng.uniform((x0 - 2.0, y0 - 2.0, -np.pi), (x1 + 2.0, y1 + 2.0, np.pi), (4 * n, 3))
    lidar = about[:, :2] + LIDAR_X_M * np.stack([np.cos(about[:, 2]), np.sin(about[:, 2])], axis=1)
    free = ~shapely.dwithin(world.walls, shapely.points(lidar), 0.01)
    return np.concatenate([anywhere_poses(world, robot, rng, n // 2), about[free][: n - n // 2]])


def brute_at(world: World, poses: NDArray[np.float64], indices: NDArray[np.intp]) -> NDArray[np.float64]:
    lidar = poses[:, :2] + LIDAR_X_M * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    found = brute_ranges(world, lidar, poses[:, 2:] - np.pi + indices * (2 * np.pi / 360), 6.0)
    return np.where(found >= 6.0 * np.cos(np.radians(1.0)), 6.0, found)


@pytest.mark.parametrize("name", WORLDS)
def test_all_rays_read_what_brute_force_finds(robot: RobotModel, name: str) -> None:
    """A ray that grazes a corner may read what is behind it or not: its neighbours beside it, 2e-6 rad off, decide.

    Far along a wall made of short pieces, float32 is good to some tenths of a millimetre.
    """
    world, everything = world_of(name), np.arange(360)
    poses = free_poses(world, robot, 200)
    ours = ranges_at(world, poses)
    either = np.stack([brute_at(world, poses + np.array([0.0, 0.0, by]), everything) for by in (-2e-6, 0.0, 2e-6)])
    least, most = either.min(axis=0), either.max(axis=0)
    off = np.maximum(least - ours, ours - most)
    assert (off > 1e-4).mean() < 1e-4 and off.max() < 5e-4, poses[off.max(axis=1).argmax()]
    assert (ours < 6.0).mean() > 0.3 and (most - least > 1e-3).mean() < 1e-3


@pytest.mark.parametrize("kind", ["sr", "firect", "fifr"])
@pytest.mark.parametrize("name", ["hexagon", "long"])
def test_fewer_bearings_read_the_same_along_them(name: str, kind: str) -> None:
    task, world, robot = TaskConfig(robot=name), world_of("track_3"), load_robot(name)
    poses = free_poses(world, robot, 60)
    indices = np.unique(make_region(robot, SafetyRegionConfig(kind=kind), 360).indices)
    every = ranges_at(world, poses, task=task)
    few = ranges_at(world, poses, task=task, indices=indices)
    assert len(indices) < 60 and np.array_equal(few, every[:, indices])


def test_cars_see_the_world_that_each_is_in(robot: RobotModel) -> None:
    """Cars of three worlds in one simulation read what they read alone, also after a world was added."""
    worlds = [world_of(name) for name in ("track_3", "big_track", "generated_1")]
    poses = [free_poses(world, robot, 20) for world in worlds]
    sim = planar(worlds[:2], 60)
    sim.add_worlds(worlds[2:])
    stand(sim, np.concatenate(poses), np.repeat([0, 1, 2], 20))
    sim.look()
    alone = [ranges_at(world, at) for world, at in zip(worlds, poses, strict=True)]
    np.testing.assert_allclose(sim.ranges, np.concatenate(alone), atol=2e-5)


@pytest.mark.parametrize("name", ["track_2", "real_2"])
@pytest.mark.parametrize("noise", [NoiseConfig(), NoiseConfig(mount_xyz_m=(0.03, -0.02, 0.0), mount_yaw_rad=0.05)])
def test_the_plane_sees_what_the_3d_lidar_sees(robot: RobotModel, name: str, noise: NoiseConfig) -> None:
    task = TaskConfig(lidar=LidarConfig(caster="embree"), noise=noise)
    world = load_world(name)
    poses = anywhere_poses(world, robot, np.random.default_rng(2), 40)
    lidar = Lidar(robot, task.lidar, task.noise, task.flatten)
    lidar.set_world(world)
    rng = np.random.default_rng(0)
    scans = np.stack([lidar.scan(standing(*pose), rng).ranges_m for pose in poses])
    apart = np.abs(ranges_at(world, poses, task=task) - scans)
    assert (apart < 1e-3).mean() > 0.998  # the others graze a corner


def test_a_mount_error_moves_the_rays_and_not_what_the_car_believes() -> None:
    wall = box_world(((2.4, 3.0), (-3.0, 3.0), (0.0, 1.0)))
    shifted = TaskConfig(noise=NoiseConfig(mount_xyz_m=(0.1, 0.0, 0.0)))
    yawed = TaskConfig(noise=NoiseConfig(mount_yaw_rad=np.radians(30.0)))
    assert ranges_at(wall, (0.0, 0.0, 0.0), task=shifted)[0, AHEAD] == pytest.approx(1.9, abs=1e-5)
    read = ranges_at(wall, (0.0, 0.0, 0.0), task=yawed)[0]
    assert read[AHEAD] == pytest.approx(2.0 / np.cos(np.radians(30.0)), abs=1e-5)
    assert read[AHEAD - 30] == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize("away", [0.6, 2.0, 4.5])
@pytest.mark.parametrize(("sigma", "dropout"), [(0.008, 0.0), (0.03, 0.0), (0.03, 0.5), (0.0, 0.7)])
def test_noise_and_dropout_are_those_of_the_3d_lidar(
    robot: RobotModel, away: float, sigma: float, dropout: float
) -> None:
    """Of all channels that meet the wall the nearest return counts, so noise brings it nearer and few are lost."""
    n = 4000
    task = TaskConfig(
        lidar=LidarConfig(caster="embree", n_bearings=8), noise=NoiseConfig(range_sigma_m=sigma, dropout=dropout)
    )
    wall = box_world(((LIDAR_X_M + away, 8.0), (-3.0, 3.0), (0.0, 1.0)))
    lidar = Lidar(robot, task.lidar, task.noise, task.flatten)
    lidar.set_world(wall)
    rng = np.random.default_rng(5)
    theirs = np.array([lidar.scan(standing(), rng).ranges_m[4] for _ in range(n)])
    sim = planar(wall, n, task)
    stand(sim, (0.0, 0.0, 0.0))
    sim.draws[:] = np.random.default_rng(6).integers(2**31, size=n)
    sim.look()
    ours = sim.ranges[:, 4]
    lost = [np.mean(read == 6.0) for read in (ours, theirs)]
    assert lost[0] == pytest.approx(lost[1], abs=0.02)
    ours, theirs = ours[ours < 6.0], theirs[theirs < 6.0]
    if sigma:
        assert ours.mean() == pytest.approx(theirs.mean(), abs=0.25 * sigma)
        assert ours.std() == pytest.approx(theirs.std(), rel=0.15)
    else:
        assert ours == pytest.approx(np.full(len(ours), away), abs=1e-5)


def test_noise_is_a_function_of_the_draw_and_other_for_every_ray() -> None:
    task = replace(TaskConfig(), noise=NoiseConfig(range_sigma_m=0.05))
    box = box_world(((2.4, 3.0), (-9.0, 9.0), (0.0, 1.0)))
    sim = planar(box, 3, task)
    stand(sim, (0.0, 0.0, 0.0))
    sim.draws[:] = [1, 2, 1]
    sim.look()
    first = sim.ranges.copy()
    assert np.array_equal(first[0], first[2]) and not np.array_equal(first[0], first[1])
    sim.look(np.array([1]))
    assert np.array_equal(sim.ranges, first)
    clean = ranges_at(box, (0.0, 0.0, 0.0))[0]
    off = (first[0] - clean)[120:241]
    assert len(np.unique(off.round(5))) > 100 and abs(np.corrcoef(off[:-1], off[1:])[0, 1]) < 0.3
