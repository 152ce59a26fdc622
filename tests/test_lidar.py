"""The lidar sees what stands where, through both ray casters, in real PyBullet and Open3D scenes."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from boxes import box_world, standing

from zebrat_bullet.config import FlattenConfig, LidarConfig, NoiseConfig, PhysicsConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing import embree_caster
from zebrat_bullet.sensing.beams import beam_bearings, beam_directions
from zebrat_bullet.sensing.cloud import save_cloud, to_open3d
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import Command
from zebrat_bullet.world.world import World

ROBOT = load_robot("zebrat")
LIDAR_X = 0.4  # the lidar stands 0.4 m ahead of the body centre, 0.75 m high
LIDAR_Z = 0.75
AHEAD, LEFT, BACK, RIGHT = 180, 270, 0, 90
RNG = np.random.default_rng(0)
WALL = (0.0, 2.0)  # heights
BOX_AT_2_M = ((LIDAR_X + 2.0, LIDAR_X + 3.0), (-1.0, 1.0), WALL)


@pytest.fixture(scope="module")
def sim() -> Iterator[Simulation]:
    simulation = Simulation(ROBOT, PhysicsConfig())
    yield simulation
    simulation.close()


def make_lidar(
    sim: Simulation,
    world: World,
    caster: str,
    noise: NoiseConfig | None = None,
    config: LidarConfig | None = None,
) -> Lidar:
    config = replace(config or LidarConfig(), caster=caster)
    lidar = Lidar(ROBOT, config, noise or NoiseConfig(), FlattenConfig(), sim.client_id)
    sim.set_world(world)
    lidar.set_world(world)
    return lidar


both_casters = pytest.mark.parametrize("caster", ["bullet", "embree"])


def test_bearings_run_from_straight_back_counter_clockwise() -> None:
    bearings = beam_bearings(360)
    assert bearings[BACK] == -math.pi
    assert np.allclose(bearings[[RIGHT, AHEAD, LEFT]], [-math.pi / 2, 0.0, math.pi / 2])


def test_beams_are_unit_vectors_lowest_channel_first() -> None:
    directions = beam_directions(LidarConfig())
    assert directions.shape == (5760, 3) and directions.dtype == np.float32
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-6)
    assert np.allclose(directions[:360, 2], -math.sin(math.radians(15)))
    assert np.allclose(directions[-360:, 2], math.sin(math.radians(15)))
    assert np.allclose(directions[-360 + LEFT], [0.0, math.cos(math.radians(15)), math.sin(math.radians(15))])


@both_casters
def test_a_box_at_2_m_reads_2_m(sim: Simulation, caster: str) -> None:
    lidar = make_lidar(sim, box_world(BOX_AT_2_M), caster)
    ranges = lidar.scan(standing(), RNG).ranges_m
    assert ranges[AHEAD] == pytest.approx(2.0, abs=1e-5)
    assert ranges[AHEAD + 20] == pytest.approx(2.0 / math.cos(math.radians(20)), abs=1e-5)
    assert ranges[[BACK, RIGHT, LEFT]].tolist() == [6.0, 6.0, 6.0]


@both_casters
def test_the_scan_turns_with_the_car(sim: Simulation, caster: str) -> None:
    lidar = make_lidar(sim, box_world(((2.0, 3.0), (-2.0, 2.0), WALL)), caster)
    ranges = lidar.scan(standing(0.5, 0.1, -math.pi / 2), RNG).ranges_m  # the lidar at (0.5, -0.3), the box on its left
    assert ranges[LEFT] == pytest.approx(1.5, abs=1e-5)


@both_casters
def test_the_cloud_holds_box_floor_and_no_returns(sim: Simulation, caster: str) -> None:
    lidar = make_lidar(sim, box_world(BOX_AT_2_M), caster)
    cloud = lidar.cloud(lidar.sweep(standing(), RNG))
    assert cloud.points_lidar.shape == (5760, 3) and cloud.height_m == pytest.approx(LIDAR_Z)
    lowest_back, highest_back = cloud.points_lidar[BACK], cloud.points_lidar[15 * 360 + BACK]
    floor_distance = LIDAR_Z / math.tan(math.radians(15))
    assert np.allclose(lowest_back, [-floor_distance, 0.0, -LIDAR_Z], atol=1e-5)
    assert cloud.valid[BACK] and not cloud.valid[15 * 360 + BACK]
    assert np.linalg.norm(highest_back) == pytest.approx(6.0)
    assert np.allclose(cloud.points_lidar[AHEAD], [2.0, 0.0, -2.0 * math.tan(math.radians(15))], atol=1e-5)


@both_casters
def test_a_world_without_walls_still_has_its_floor(sim: Simulation, caster: str) -> None:
    lidar = make_lidar(sim, box_world(), caster)
    sweep = lidar.sweep(standing(3.0, -20.0, 1.0), RNG)
    assert np.allclose(sweep.ranges_m[:360], LIDAR_Z / math.sin(math.radians(15)), atol=1e-4)
    assert (lidar.flat(sweep).ranges_m == 6.0).all()


@both_casters
def test_the_car_hides_nothing_from_its_own_lidar(sim: Simulation, caster: str) -> None:
    lidar = make_lidar(sim, box_world(), caster)
    sim.reset(standing().pose)
    state = sim.step(Command(0.6, 0.6))
    cloud = lidar.cloud(lidar.sweep(state, RNG))
    assert np.allclose(cloud.points_lidar[cloud.valid, 2], -LIDAR_Z, atol=5e-3)  # the floor alone


@both_casters
@pytest.mark.parametrize("n_bearings", [512, 1100], ids=["exactly 16384 rays", "35200 rays"])
def test_more_rays_than_one_bullet_call_takes(sim: Simulation, caster: str, n_bearings: int) -> None:
    config = LidarConfig(n_channels=32, n_bearings=n_bearings)
    lidar = make_lidar(sim, box_world(((-1.5, 1.5), (-1.0, -0.9), WALL), BOX_AT_2_M), caster, config=config)
    sweep = lidar.sweep(standing(), RNG)
    expected = 2.0 / np.cos(np.linspace(-math.pi / 12, math.pi / 12, 32))
    assert np.allclose(sweep.ranges_m.reshape(32, n_bearings)[:, n_bearings // 2], expected, atol=1e-5)
    assert np.allclose(sweep.ranges_m.reshape(32, n_bearings)[-1, -3:], 6.0)


@both_casters
@pytest.mark.parametrize(("distance_m", "range_m"), [(2.5, 2.5), (2.1, 2.1), (1.9, 6.0), (1.0, 6.0)])
def test_a_low_kerb_is_lost_within_the_blind_zone(
    sim: Simulation, caster: str, distance_m: float, range_m: float
) -> None:
    kerb = ((5.0, 5.1), (-1.0, 1.0), (0.0, 0.2))  # below the lowest beam from (0.75 - 0.2) / tan 15 degrees = 2.05 m
    lidar = make_lidar(sim, box_world(kerb), caster)
    ranges = lidar.scan(standing(5.0 - LIDAR_X - distance_m), RNG).ranges_m
    assert ranges[AHEAD] == pytest.approx(range_m, abs=1e-4)


@both_casters
@pytest.mark.parametrize(("bottom_m", "range_m"), [(1.0, 6.0), (0.5, 3.0)], ids=["passes under", "must stop"])
def test_a_raised_bar_counts_where_the_car_would_hit_it(
    sim: Simulation, caster: str, bottom_m: float, range_m: float
) -> None:
    bar = ((LIDAR_X + 3.0, LIDAR_X + 3.2), (-1.0, 1.0), (bottom_m, bottom_m + 0.6))
    lidar = make_lidar(sim, box_world(bar), caster)
    assert lidar.scan(standing(), RNG).ranges_m[AHEAD] == pytest.approx(range_m, abs=1e-5)


@both_casters
@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.08), (0.0, -0.08), (0.06, 0.0), (0.05, 0.07)])
def test_a_tilted_car_sees_the_box_and_not_the_floor(sim: Simulation, caster: str, roll: float, pitch: float) -> None:
    lidar = make_lidar(sim, box_world(BOX_AT_2_M), caster)
    ranges = lidar.scan(standing(roll=roll, pitch=pitch), RNG).ranges_m
    # The tilt swings the mast: the lidar moves ahead by about 0.75 m * pitch.
    ahead = LIDAR_X * math.cos(pitch) + LIDAR_Z * math.cos(roll) * math.sin(pitch)
    assert ranges[AHEAD] == pytest.approx(LIDAR_X + 2.0 - ahead, abs=0.005)
    assert (ranges[:60] == 6.0).all() and (ranges[-60:] == 6.0).all()


@both_casters
def test_a_mount_error_moves_what_is_seen(sim: Simulation, caster: str) -> None:
    world = box_world(BOX_AT_2_M)
    ahead = make_lidar(sim, world, caster, NoiseConfig(mount_xyz_m=(0.1, 0.0, 0.0)))
    assert ahead.scan(standing(), RNG).ranges_m[AHEAD] == pytest.approx(1.9, abs=1e-5)
    turned_left = make_lidar(sim, world, caster, NoiseConfig(mount_yaw_rad=math.radians(10)))
    ranges = turned_left.scan(standing(), RNG).ranges_m
    assert ranges[AHEAD - 10] == pytest.approx(2.0, abs=1e-5)  # the car takes what is ahead for 10 degrees to the right
    assert ranges[AHEAD] == pytest.approx(2.0 / math.cos(math.radians(10)), abs=1e-5)


def test_a_lidar_mounted_backwards_still_scans_in_the_cars_heading(sim: Simulation) -> None:
    robot = replace(ROBOT, lidar_rpy=np.array([0.0, 0.0, math.pi]))
    lidar = Lidar(robot, LidarConfig(caster="embree"), NoiseConfig(), FlattenConfig())
    lidar.set_world(box_world(BOX_AT_2_M))
    ranges = lidar.scan(standing(), RNG).ranges_m
    assert ranges[AHEAD] == pytest.approx(2.0, abs=1e-5) and ranges[BACK] == 6.0


@both_casters
def test_the_same_seed_gives_the_same_noisy_scan(sim: Simulation, caster: str) -> None:
    noise = NoiseConfig(range_sigma_m=0.008, dropout=0.1)
    lidar = make_lidar(sim, box_world(BOX_AT_2_M), caster, noise)
    first, again, other = (lidar.scan(standing(), np.random.default_rng(seed)).ranges_m for seed in (1, 1, 2))
    assert (first == again).all() and (first != other).any()


@both_casters
def test_a_sweep_keeps_its_ranges_after_the_next_one(sim: Simulation, caster: str) -> None:
    lidar = make_lidar(sim, box_world(BOX_AT_2_M), caster)
    first = lidar.sweep(standing(), RNG)
    kept = first.ranges_m.copy()
    lidar.sweep(standing(1.0), RNG)
    assert (first.ranges_m == kept).all()


@both_casters
def test_the_bare_call_answers_for_every_ray(sim: Simulation, caster: str) -> None:
    lidar = make_lidar(sim, box_world(BOX_AT_2_M), caster)
    lidar.scan(standing(), RNG)
    answer = lidar.caster.trace()
    n_rays = answer["t_hit"].shape[0] if caster == "embree" else sum(map(len, answer))
    assert n_rays == 5760


def test_embree_goes_between_worlds_and_forgets_the_oldest(sim: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(embree_caster, "MAX_SCENES", 2)
    worlds = [box_world(((x, x + 0.5), (-1.0, 1.0), WALL)) for x in (1.4, 2.4, 3.4)]
    lidar = Lidar(ROBOT, LidarConfig(caster="embree"), NoiseConfig(), FlattenConfig())
    seen = []
    for world in (*worlds, *worlds):
        lidar.set_world(world)
        seen.append(lidar.scan(standing(), RNG).ranges_m[AHEAD])
    assert np.allclose(seen, [1.0, 2.0, 3.0, 1.0, 2.0, 3.0], atol=1e-5)
    assert len(lidar.caster._scenes) == 2


def test_bullet_without_a_client_says_what_to_pass() -> None:
    with pytest.raises(ConfigError, match="client_id"):
        Lidar(ROBOT, LidarConfig(caster="bullet"), NoiseConfig(), FlattenConfig(), None)


def test_embree_without_a_world_says_so() -> None:
    with pytest.raises(RuntimeError, match="set_world"):
        Lidar(ROBOT, LidarConfig(caster="embree"), NoiseConfig(), FlattenConfig()).scan(standing(), RNG)


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_a_saved_cloud_reads_back(sim: Simulation, tmp_path: object, suffix: str) -> None:
    lidar = make_lidar(sim, box_world(BOX_AT_2_M), "embree")
    cloud = lidar.cloud(lidar.sweep(standing(), RNG))
    path = f"{tmp_path}/cloud{suffix}"
    save_cloud(cloud, path)
    points = np.asarray(o3d.io.read_point_cloud(path).points)
    assert np.allclose(points, cloud.points_lidar[cloud.valid], atol=1e-6)
    assert len(to_open3d(cloud).points) == cloud.valid.sum()


def test_a_cloud_of_another_format_is_refused(sim: Simulation) -> None:
    lidar = make_lidar(sim, box_world(BOX_AT_2_M), "embree")
    with pytest.raises(ConfigError, match=r"\.ply or \.pcd"):
        save_cloud(lidar.cloud(lidar.sweep(standing(), RNG)), "cloud.csv")
