"""Both ray casters give the same cloud everywhere a car can stand, but for rays that graze an edge."""

from collections.abc import Iterator

import numpy as np
import pytest

from zebrat_bullet.assets import list_assets
from zebrat_bullet.config import FlattenConfig, LidarConfig, NoiseConfig, PhysicsConfig
from zebrat_bullet.geometry import footprint_hits
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import Pose2, RobotState
from zebrat_bullet.world import World, load_world

ROBOT = load_robot("zebrat")
N_POSES = 200
SAME_M = 1e-4
MAX_GRAZING = 1e-3


@pytest.fixture(scope="module")
def senses() -> Iterator[tuple[Simulation, Lidar, Lidar]]:
    sim = Simulation(ROBOT, PhysicsConfig())
    lidars = [
        Lidar(ROBOT, LidarConfig(caster=caster), NoiseConfig(), FlattenConfig(), sim.client_id)
        for caster in ("bullet", "embree")
    ]
    yield sim, *lidars
    sim.close()


def free_states(world: World, rng: np.random.Generator) -> Iterator[RobotState]:
    """Draw states anywhere in the free space, a little tilted, where the car fits."""
    x0, y0, x1, y1 = world.free_space.bounds
    still = {"speed_mps": 0.0, "yaw_rate_radps": 0.0, "steering_rad": 0.0, "contact": False, "unseen_contact": False}
    n = 0
    while n < N_POSES:
        pose = Pose2(rng.uniform(x0, x1), rng.uniform(y0, y1), rng.uniform(-np.pi, np.pi))
        if footprint_hits(world.walls, ROBOT.footprint_base, pose) or not footprint_hits(
            world.free_space, ROBOT.footprint_base, pose
        ):
            continue
        n += 1
        roll, pitch, height = rng.uniform(-0.02, 0.02, 3)
        yield RobotState(pose, height, roll, pitch, knuckle_rad=np.zeros(2), wheel_rad=np.zeros(4), **still)


@pytest.mark.parametrize("name", list_assets("worlds", ".yaml"))
def test_both_casters_see_the_same_cloud(senses: tuple[Simulation, Lidar, Lidar], name: str) -> None:
    sim, bullet, embree = senses
    world = load_world(name)
    sim.set_world(world)
    bullet.set_world(world)
    embree.set_world(world)
    rng = np.random.default_rng(0)
    n_rays = n_grazing = n_floor = 0
    for state in free_states(world, rng):
        clouds = [lidar.cloud(lidar.sweep(state, rng)) for lidar in (bullet, embree)]
        apart = np.linalg.norm(clouds[0].points_lidar - clouds[1].points_lidar, axis=1)
        n_grazing += int((apart > SAME_M).sum())
        n_rays += len(apart)
        n_floor += int((clouds[0].points_lidar @ clouds[0].rotation_level[2] + clouds[0].height_m < 0.01).sum())
    assert n_rays == N_POSES * 16 * 360
    assert n_floor > 0.01 * n_rays  # the floor is part of the comparison
    assert n_grazing < MAX_GRAZING * n_rays, f"{n_grazing} of {n_rays} rays differ by more than {SAME_M} m"
    print(f"{name}: {n_grazing} of {n_rays} rays graze an edge")
