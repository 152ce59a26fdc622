"""A flat scan holds the nearest return of each bearing within the height band, by the fast way and the exact way."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zebrat_bullet.config import FlattenConfig, LidarConfig, NoiseConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.beams import beam_directions
from zebrat_bullet.sensing.flatten import LEVEL_TILT_RAD, LevelFlattener, flatten_cloud
from zebrat_bullet.sensing.lidar import Lidar, Sweep
from zebrat_bullet.types import FlatScan, PointCloud

REACH, HEIGHT = 6.0, 0.75
CONFIG = FlattenConfig()
LIDAR = Lidar(load_robot("zebrat"), LidarConfig(caster="embree"), NoiseConfig(), CONFIG)


def flatten_points(points: list[list[float]], rotation: np.ndarray | None = None) -> np.ndarray:
    """Flatten a few returns at (x, y, z) in m in the lidar frame."""
    rotation = np.eye(3) if rotation is None else rotation
    cloud = PointCloud(np.array(points, np.float32), np.ones(len(points), bool), rotation, HEIGHT)
    return flatten_cloud(cloud, CONFIG, 360, REACH).ranges_m


def flatten_both(ranges: np.ndarray) -> tuple[FlatScan, FlatScan]:
    """Flatten a level sweep the fast way and the exact way."""
    sweep = Sweep(ranges.astype(np.float32), np.eye(3), HEIGHT)
    return (
        LevelFlattener(LidarConfig(), CONFIG).flatten(sweep.ranges_m, HEIGHT),
        flatten_cloud(LIDAR.cloud(sweep), CONFIG, 360, REACH),
    )


def test_points_fall_on_the_bearings_of_a_ros_laser_scan() -> None:
    scan = flatten_points([[-1, 0, 0], [0, -2, 0], [3, 0, 0], [0, 4, 0]])
    assert scan[[0, 90, 180, 270]].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert (np.delete(scan, [0, 90, 180, 270]) == REACH).all()


def test_a_point_goes_to_its_nearest_bearing_also_across_the_back() -> None:
    just_right_of_back, just_left_of_back = [-1.0, -0.008, 0.0], [-2.0, 0.016, 0.0]  # 0.46 degrees off
    assert flatten_points([just_right_of_back])[0] == pytest.approx(1.0, abs=1e-4)
    assert flatten_points([just_left_of_back])[0] == pytest.approx(2.0, abs=1e-4)


def test_the_nearest_of_two_points_counts() -> None:
    assert flatten_points([[3, 0, 0], [2, 0, -0.2], [4, 0, 0]])[180] == 2.0


def test_ranges_are_horizontal() -> None:
    assert flatten_points([[3.0, 4.0, -0.5]]).min() == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("height_m", "seen"), [(0.0, False), (0.049, False), (0.051, True), (0.799, True), (0.801, False)]
)
def test_only_the_height_band_counts(height_m: float, seen: bool) -> None:
    assert flatten_points([[2.0, 0.0, height_m - HEIGHT]])[180] == (2.0 if seen else REACH)


def test_tilt_is_levelled_before_heights_are_judged() -> None:
    nose_down = rotation_from_rpy(0.0, 0.2, 0.0)
    level = np.array([2.0, 0.0, 0.0])
    assert flatten_points([(nose_down.T @ level).tolist()], nose_down)[180] == pytest.approx(2.0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_lost=st.integers(0, 5760))
def test_fast_and_exact_way_agree_when_level(seed: int, n_lost: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.1, REACH, 5760)
    ranges[rng.permutation(5760)[:n_lost]] = REACH
    fast, exact = flatten_both(ranges)
    assert np.allclose(fast.ranges_m, exact.ranges_m, atol=1e-5)


@pytest.mark.parametrize("height_m", [0.2, 0.9, 1.5])
def test_fast_and_exact_way_agree_at_other_heights(height_m: float) -> None:
    ranges = np.random.default_rng(0).uniform(0.1, REACH, 5760).astype(np.float32)
    fast = LevelFlattener(LidarConfig(), CONFIG).flatten(ranges, height_m)
    exact = flatten_cloud(LIDAR.cloud(Sweep(ranges, np.eye(3), height_m)), CONFIG, 360, REACH)
    assert np.allclose(fast.ranges_m, exact.ranges_m, atol=1e-5)


def wall_ranges(distance_m: float, rotation_level: np.ndarray) -> np.ndarray:
    """Return exact ranges to a round wall `distance_m` away and the floor, from a tilted lidar."""
    beams = beam_directions(LidarConfig()).astype(float) @ rotation_level.T
    to_wall = distance_m / np.hypot(beams[:, 0], beams[:, 1])
    to_floor = np.where(beams[:, 2] < 0, HEIGHT / np.maximum(-beams[:, 2], 1e-9), np.inf)
    return np.minimum(np.minimum(to_wall, to_floor), REACH).astype(np.float32)


@pytest.mark.parametrize("tilt", [0.0, 0.9 * LEVEL_TILT_RAD, 1.1 * LEVEL_TILT_RAD, 0.05, 0.15])
def test_a_round_wall_is_round_at_any_tilt(tilt: float) -> None:
    rotation = rotation_from_rpy(tilt / math.sqrt(2), tilt / math.sqrt(2), 0.0)
    scan = LIDAR.flat(Sweep(wall_ranges(2.0, rotation), rotation, HEIGHT))
    assert np.allclose(scan.ranges_m, 2.0, atol=2e-3)


def test_tilt_below_the_threshold_takes_no_floor_for_a_wall() -> None:
    rotation = rotation_from_rpy(0.0, 0.9 * LEVEL_TILT_RAD, 0.0)
    scan = LIDAR.flat(Sweep(wall_ranges(100.0, rotation), rotation, HEIGHT))
    assert (scan.ranges_m == REACH).all()


def test_an_upside_down_height_band_is_refused() -> None:
    with pytest.raises(ConfigError, match="below"):
        FlattenConfig(height_min_m=0.8, height_max_m=0.1)
