"""Every representation gives the answer that geometry gives: 10,000 poses near the walls of every shipped world.

The truth is found apart from what is tested: Bullet's own distance between the body's collision shape and the wall mesh
for the polygon; for SR, FIRect and FIFR their rays, cut off at their ranges, against the outlines of the walls.

A scan takes some milliseconds, so one channel of the lidar, cast by Embree, looks at all 10,000 poses: walls of shipped
worlds are upright and higher than the height band, so any channel sees what sixteen do. The whole lidar looks at some
of the poses with either caster, which holds that too.
"""

import math
import zlib
from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from boxes import standing
from numpy.typing import NDArray
from poses import SLACK_M, RayTruth, near_wall_poses, physics_gaps, placed, ray_truth

from zebrat_bullet.assets import list_assets
from zebrat_bullet.config import FlattenConfig, LidarConfig, NoiseConfig, PhysicsConfig, SafetyRegionConfig
from zebrat_bullet.detection.representations import RAY_REPRESENTATIONS
from zebrat_bullet.geometry import footprint_hits
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.cloud_check import cloud_gap
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, load_world

N_POSES = 10_000
N_WHOLE_LIDAR = {"embree": 80, "bullet": 40}
ROBOT = load_robot()
REGIONS = {kind: make_region(ROBOT, SafetyRegionConfig(kind=kind), 360) for kind in RAY_REPRESENTATIONS}
ELEVATION = math.radians(-1.0)
ONE_CHANNEL = LidarConfig(caster="embree", n_channels=1, elevation_min_rad=ELEVATION, elevation_max_rad=ELEVATION)


@dataclass(frozen=True)
class Judged:
    """Poses in a world, what is true of them and what was said of them; arrays are (N,).

    Attributes:
        distances_m: of the footprint to the outlines of the walls.
        bullet_m: Bullet's distance of body and walls, negative inside, at most 2 mm.
        truths, fires: what the rays of each region must and may report, and what it does report.
        cloud_m: gap of the cloud.
    """

    world: World
    poses: list[Pose2]
    distances_m: NDArray[np.float64]
    bullet_m: NDArray[np.float64]
    truths: dict[str, RayTruth]
    fires: dict[str, NDArray[np.bool_]]
    cloud_m: NDArray[np.float64]


@pytest.fixture(scope="module")
def simulation():
    simulation = Simulation(ROBOT, PhysicsConfig())
    yield simulation
    simulation.close()


@pytest.fixture(scope="module", params=list_assets("worlds", ".yaml"))
def judged(request: pytest.FixtureRequest, simulation: Simulation) -> Judged:
    world, rng = load_world(request.param), np.random.default_rng(zlib.crc32(request.param.encode()))
    poses = near_wall_poses(world, ROBOT, N_POSES, rng)
    simulation.set_world(world)
    lidar = Lidar(ROBOT, ONE_CHANNEL, NoiseConfig(), FlattenConfig())
    lidar.set_world(world)
    sweeps = [lidar.sweep(standing(pose.x, pose.y, pose.yaw), rng) for pose in poses]
    scans = np.stack([lidar.flat(sweep).ranges_m for sweep in sweeps])
    outline = REGIONS["sr"].outline_lidar
    return Judged(
        world,
        poses,
        distances_m=shapely.distance(world.walls, shapely.polygons(placed(ROBOT.footprint_base, poses))),
        bullet_m=physics_gaps(simulation, poses),
        truths={kind: ray_truth(region, ROBOT, world, poses) for kind, region in REGIONS.items()},
        fires={kind: (scans[:, region.indices] <= region.range_m).any(axis=1) for kind, region in REGIONS.items()},
        cloud_m=np.array([cloud_gap(lidar.cloud(sweep), FlattenConfig(), outline) for sweep in sweeps]),
    )


@pytest.mark.slow
def test_the_poses_are_hard_ones(judged: Judged) -> None:
    off = judged.distances_m
    assert len(judged.poses) == 10_000
    assert (off == 0.0).mean() > 1 / 3 and ((off > 0.0) & (off < 0.05)).mean() > 1 / 3


@pytest.mark.slow
def test_the_polygon_agrees_with_bullet_wherever_they_do_not_just_touch(judged: Judged) -> None:
    """Bullet keeps the walls' corners, and GEOS the turned footprint, with other roundings: within 10 micrometres of
    touching either answer is right. Few of the 10,000 stand so close."""
    polygon = np.array([footprint_hits(judged.world.walls, ROBOT.footprint_base, pose) for pose in judged.poses])
    touching = np.abs(judged.bullet_m) < SLACK_M
    assert touching.sum() <= 10
    assert (polygon == (judged.bullet_m <= 0.0))[~touching].all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", RAY_REPRESENTATIONS)
def test_a_region_reports_what_its_rays_meet_and_nothing_else(judged: Judged, kind: str) -> None:
    truth, fires = judged.truths[kind], judged.fires[kind]
    assert (truth.may & ~truth.must).sum() <= 10  # rounding decides these
    assert fires[truth.must].all() and truth.may[fires].all()


@pytest.mark.slow
def test_what_sr_or_firect_reports_the_cloud_does_and_what_that_reports_the_polygon_does(judged: Judged) -> None:
    sr_or_firect = judged.fires["sr"] | judged.fires["firect"]
    assert (judged.cloud_m[sr_or_firect] < SLACK_M).all()
    assert (judged.distances_m[sr_or_firect | (judged.cloud_m <= 0.0)] < SLACK_M).all()


@pytest.mark.slow
@pytest.mark.parametrize("caster", N_WHOLE_LIDAR)
def test_the_whole_lidar_says_the_same_with_either_caster(judged: Judged, caster: str, checkers) -> None:
    for i, pose in enumerate(judged.poses[: N_WHOLE_LIDAR[caster]]):
        said = checkers[caster].check(judged.world, pose)
        collides = said.collides
        if abs(judged.bullet_m[i]) > SLACK_M:
            assert collides["polygon"] == collides["physics"] == (judged.bullet_m[i] <= 0.0), said.table()
        for kind, truth in judged.truths.items():
            assert bool(truth.must[i]) <= collides[kind] <= bool(truth.may[i]), f"{kind}\n{said.table()}"
        if abs(judged.cloud_m[i]) > SLACK_M:
            assert (judged.cloud_m[i] <= 0.0) <= collides["cloud"] <= collides["polygon"], said.table()
