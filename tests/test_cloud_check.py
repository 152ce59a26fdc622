"""The cloud's gap is that of the nearest point of the height band to the car's outline."""

import math

import numpy as np
import pytest
import shapely

from zebrat_bullet.config import FlattenConfig, SafetyRegionConfig
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.sensing.cloud_check import cloud_gap, side_distances
from zebrat_bullet.sensing.safety_region import SafetyRegion
from zebrat_bullet.types import PointCloud

# About the lidar: 0.9 m of tail, 0.1 m of nose, 0.3 m to either side.
RECTANGLE = np.array([[-0.9, -0.3], [0.1, -0.3], [0.1, 0.3], [-0.9, 0.3]])
HEXAGON = np.array([[-0.9, -0.1], [-0.5, -0.4], [0.05, -0.3], [0.15, 0.0], [0.05, 0.3], [-0.6, 0.35]])
BAND = FlattenConfig(height_min_m=0.05, height_max_m=0.80)


def gap_of(*points: tuple[float, float, float], seen: bool = True, pitch: float = 0.0) -> float:
    """Return the gap of points in the frame of a lidar 0.75 m above the floor."""
    valid = np.full(len(points), seen)
    cloud = PointCloud(np.array(points, np.float32).reshape(-1, 3), valid, rotation_from_rpy(0.0, pitch, 0.0), 0.75)
    return cloud_gap(cloud, BAND, RECTANGLE)


@pytest.mark.parametrize(
    ("point", "gap_m"),
    [
        ((0.2, 0.0), 0.1),  # ahead
        ((-0.4, 0.25), -0.05),  # 5 cm inside the left side
        ((-1.4, 0.1), 0.5),  # behind
        ((0.13, 0.34), 0.04),  # off a corner: mitred, so the farther of both sides, not 0.05
    ],
)
def test_a_gap_is_the_distance_to_the_farthest_side_line(point: tuple[float, float], gap_m: float) -> None:
    assert gap_of((*point, 0.0)) == pytest.approx(gap_m, abs=1e-6)


def test_the_nearest_point_counts() -> None:
    assert gap_of((2.0, 0.0, 0.0), (-0.4, 0.5, 0.0), (0.0, -3.0, 0.0)) == pytest.approx(0.2, abs=1e-6)


def test_points_on_the_floor_overhead_or_without_a_return_do_not_count() -> None:
    assert gap_of((0.0, 0.0, -0.71), (0.0, 0.0, 0.06)) == math.inf
    assert gap_of((0.0, 0.0, 0.0), seen=False) == math.inf
    assert gap_of() == math.inf


def test_a_tilted_lidar_is_levelled_first() -> None:
    """Nose down by 30 degrees, a point 1 m along the lidar's x axis is cos 30 degrees ahead and 0.5 m lower."""
    pitch = math.radians(30.0)
    assert gap_of((1.0, 0.0, 0.0), pitch=pitch) == pytest.approx(math.cos(pitch) - 0.1, abs=1e-6)
    assert gap_of((1.5, 0.0, 0.0), pitch=pitch) == math.inf  # on the floor


@pytest.mark.parametrize("outline", [RECTANGLE, HEXAGON], ids=["rectangle", "hexagon"])
@pytest.mark.parametrize("margin_m", [0.0, 0.05])
def test_a_gap_within_the_margin_is_inside_of_the_enlarged_outline(outline: np.ndarray, margin_m: float) -> None:
    points = np.random.default_rng(0).uniform(-1.2, 0.6, (5000, 2))
    region = SafetyRegion(outline, SafetyRegionConfig(margin_m=margin_m), 360)
    inside = shapely.contains_xy(shapely.Polygon(region.outline_lidar), points[:, 0], points[:, 1])
    assert ((side_distances(points, outline) <= margin_m) == inside).all() and 0.1 < inside.mean() < 0.9
