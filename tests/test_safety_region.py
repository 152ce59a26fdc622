"""The safety region watches the car's outline as Algorithm 1 says, and never cries wolf."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import affinity

from zebrat_bullet.config import SafetyRegionConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.geometry import footprint_hits
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.sensing.safety_region import FIFR, FIRect, SafetyRegion, make_region
from zebrat_bullet.types import FlatScan, Pose2

N, REACH = 360, 6.0
ROBOT = load_robot("zebrat")
# About the lidar: 0.9 m of tail, 0.1 m of nose, 0.3 m to either side.
RECTANGLE = np.array([[-0.9, -0.3], [0.1, -0.3], [0.1, 0.3], [-0.9, 0.3]])
HEXAGON = np.array([[-0.9, -0.1], [-0.5, -0.4], [0.05, -0.3], [0.15, 0.0], [0.05, 0.3], [-0.6, 0.35]])
AUTHORS_TABLE = [0, 6, 12, 19, 22, 24, 28, 32, 38, 46, 58, 72, 90, 109, 118, 136, 180]
AUTHORS_TABLE += [224, 242, 252, 270, 288, 302, 314, 322, 328, 332, 336, 338, 342, 348, 354]
SIDES = {"back": (-1.0, 0.0, 0.9), "right": (0.0, -1.0, 0.3), "front": (1.0, 0.0, 0.1), "left": (0.0, 1.0, 0.3)}


def region_of(outline: np.ndarray = RECTANGLE, **config: float | str) -> SafetyRegion:
    return SafetyRegion(outline, SafetyRegionConfig(**config), N)


def make(kind: str, outline: np.ndarray) -> SafetyRegion:
    classes = {"sr": SafetyRegion, "firect": FIRect, "fifr": FIFR}
    return classes[kind](outline, SafetyRegionConfig(kind=kind), N)


def exact_scan(walls: shapely.Geometry) -> FlatScan:
    """Return the exact ranges from the origin to the outlines of the walls (no height, no noise)."""
    bearings = beam_bearings(N)
    directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    ranges = np.full(N, REACH)
    for polygon in getattr(walls, "geoms", [walls]):
        corners = np.array(polygon.exterior.coords)
        a, side = corners[:-1], np.diff(corners, axis=0)
        across = directions[:, None, 0] * side[:, 1] - directions[:, None, 1] * side[:, 0]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            along_ray = (a[:, 0] * side[:, 1] - a[:, 1] * side[:, 0]) / across
            along_side = (a[:, 0] * directions[:, None, 1] - a[:, 1] * directions[:, None, 0]) / across
        hit = (along_ray >= 0) & (along_side >= 0) & (along_side <= 1)
        ranges = np.minimum(ranges, np.where(hit, along_ray, np.inf).min(axis=1))
    return FlatScan(ranges.astype(np.float32), REACH)


def touches(walls: shapely.Geometry, outline: np.ndarray, slack_m: float = 0.0) -> bool:
    return shapely.Polygon(outline).buffer(slack_m).intersects(walls)


def wall_at(side: str, gap_m: float, shift_m: float = 0.0) -> shapely.Polygon:
    """Return a wall 4 m long and 0.2 m thick, parallel to a side of the rectangle, `gap_m` outside of it."""
    nx, ny, distance = SIDES[side]
    outwards, along = np.array([nx, ny]), np.array([-ny, nx])
    near, far = (distance + gap_m) * outwards, (distance + gap_m + 0.2) * outwards
    right, left = (shift_m - 2.0) * along, (shift_m + 2.0) * along
    return shapely.Polygon([right + near, left + near, left + far, right + far])


def test_zebrat_has_32_bearings_from_straight_back_counter_clockwise() -> None:
    region = make_region(ROBOT, SafetyRegionConfig(), N)
    assert len(region.indices) == len(region.range_m) == 32 and region.range_m.dtype == np.float32
    assert (np.diff(region.indices) > 0).all()
    assert (region.back, region.right, region.front, region.left) == (0, 12, 16, 20)
    assert region.corners == (3, 13, 19, 29)


def test_the_axes_are_watched_exactly() -> None:
    region = make_region(ROBOT, SafetyRegionConfig(), N)
    axes = [region.back, region.right, region.front, region.left]
    assert region.indices[axes].tolist() == [0, 90, 180, 270]
    assert np.allclose(region.range_m[axes], [0.9, 0.3, 0.1, 0.3], atol=1e-6)


def test_the_corners_are_watched_by_their_nearest_index() -> None:
    region = region_of()
    # atan(0.3 / 0.9) = 18.4 degrees from the back, atan(0.1 / 0.3) = 18.4 degrees ahead of abeam.
    assert region.indices[list(region.corners)].tolist() == [18, 108, 252, 342]


def test_points_along_the_tail_and_the_side_lie_a_tenth_of_a_metre_apart() -> None:
    indices = region_of().indices
    back = [math.degrees(math.atan2(0.1 * k, 0.9)) for k in range(4)]
    side = [math.degrees(math.atan2(0.3, 0.9 - 0.1 * k)) for k in range(1, 10)]
    assert indices[:13].tolist() == [round(angle) for angle in back + side]


def test_the_authors_table_is_met_within_two_indices() -> None:
    assert np.abs(region_of().indices - AUTHORS_TABLE).max() <= 2


def test_ranges_end_on_the_outline() -> None:
    region = region_of()
    bearings = beam_bearings(N)[region.indices]
    points = shapely.points(region.range_m * np.cos(bearings), region.range_m * np.sin(bearings))
    assert shapely.distance(shapely.Polygon(RECTANGLE).exterior, points).max() < 1e-6


@pytest.mark.parametrize("kind", ["sr", "firect", "fifr"])
@pytest.mark.parametrize("n_bearings", [360, 720, 1440])
def test_left_and_right_are_mirror_images(kind: str, n_bearings: int) -> None:
    region = make_region(ROBOT, SafetyRegionConfig(kind=kind), n_bearings)
    mirrored = -np.arange(len(region.indices)) % len(region.indices)
    assert ((region.indices + region.indices[mirrored]) % n_bearings == 0).all()
    assert np.allclose(region.range_m, region.range_m[mirrored], atol=1e-7)


@pytest.mark.parametrize(("resolution_m", "n"), [(0.05, 64), (0.1, 32), (0.2, 18), (1.0, 8)])
def test_resolution_sets_the_number_of_bearings(resolution_m: float, n: int) -> None:
    assert len(region_of(resolution_m=resolution_m).indices) == n


@pytest.mark.parametrize("resolution_m", [0.095, 0.03])
def test_a_gap_puts_bearings_between_those_that_lie_farther_apart_and_moves_none(resolution_m: float) -> None:
    plain, filled = (region_of(resolution_m=resolution_m, gap_rad=gap) for gap in (2.0 * math.pi, 0.1))
    apart = [np.diff(region.indices, append=region.indices[0] + N).max() for region in (plain, filled)]
    assert apart[0] > 15 and apart[1] <= math.ceil(0.1 / (2.0 * math.pi) * N)
    assert set(plain.indices) <= set(filled.indices)
    assert set(filled.indices) == set(-filled.indices % N)
    axes = [
        region.indices[[region.back, region.right, region.front, region.left]].tolist() for region in (plain, filled)
    ]
    assert axes[0] == axes[1] == [0, 90, 180, 270]
    assert filled.indices[list(filled.corners)].tolist() == plain.indices[list(plain.corners)].tolist()


def test_the_numbers_of_a_reading_are_the_scan_at_the_regions_bearings() -> None:
    region, scan = region_of(), FlatScan(np.linspace(1.0, 4.59, N, dtype=np.float32), REACH)
    clearance = region.measure(scan)
    assert (clearance.obs_m == scan.ranges_m[region.indices]).all()
    assert clearance.range_m is region.range_m and not clearance.collision


def test_a_scan_of_another_size_is_refused() -> None:
    with pytest.raises(ConfigError, match="180 bearings"):
        region_of().measure(FlatScan(np.full(180, 6.0, np.float32), REACH))


def test_a_lidar_outside_of_the_outline_is_refused() -> None:
    with pytest.raises(ConfigError, match="inside the outline"):
        region_of(RECTANGLE - (0.2, 0.0))


convex_piece = st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)), min_size=3, max_size=6)
place = st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))


def moved_near(walls: shapely.Geometry, outline: np.ndarray, gap_m: float) -> shapely.Geometry:
    """Return walls that stand clear of an outline moved up to `gap_m` before it; others as they are."""
    if walls.is_empty or touches(walls, outline):
        return walls
    line = shapely.shortest_line(walls, shapely.Polygon(outline))
    share = max(0.0, 1.0 - gap_m / max(line.length, 1e-9))
    (ax, ay), (bx, by) = line.coords
    return affinity.translate(walls, share * (bx - ax), share * (by - ay))


@pytest.mark.parametrize("margin_m", [0.0, 0.06])
@pytest.mark.parametrize("outline", [RECTANGLE, HEXAGON], ids=["rectangle", "hexagon"])
def test_it_never_fires_unless_the_exact_check_of_its_outline_does(outline: np.ndarray, margin_m: float) -> None:
    region = region_of(outline, margin_m=margin_m)
    seen = {True: 0, False: 0}

    @settings(max_examples=300, deadline=None)
    @given(pieces=st.lists(st.tuples(convex_piece, place), min_size=1, max_size=3), gap_m=st.floats(1e-4, 5e-3))
    def holds(pieces: list, gap_m: float) -> None:
        hulls = [shapely.MultiPoint(np.array(points) + at).convex_hull for points, at in pieces]
        walls = shapely.union_all([hull for hull in hulls if hull.area > 1e-6])
        walls = moved_near(walls, region.outline_lidar, gap_m)
        fired = not walls.is_empty and region.measure(exact_scan(walls)).collision
        seen[fired] += 1
        assert not fired or touches(walls, region.outline_lidar, slack_m=1e-6)

    holds()
    assert min(seen.values()) > 20  # both answers were tried


@pytest.mark.parametrize("side", SIDES)
@settings(max_examples=60, deadline=None)
@given(gap_m=st.floats(-0.09, 0.5), shift_m=st.floats(-1.0, 1.0))
def test_it_agrees_with_the_exact_check_for_a_flat_wall_along_any_side(side: str, gap_m: float, shift_m: float) -> None:
    if abs(gap_m) < 1e-6:
        return  # flush within a float32: either answer is right
    wall = wall_at(side, gap_m, shift_m)
    assert region_of().measure(exact_scan(wall)).collision == touches(wall, RECTANGLE) == (gap_m < 0)


@pytest.mark.parametrize("side", SIDES)
def test_a_wall_flush_with_a_side_is_decided_to_a_tenth_of_a_millimetre(side: str) -> None:
    region = region_of()
    assert region.measure(exact_scan(wall_at(side, -1e-4))).collision
    assert not region.measure(exact_scan(wall_at(side, 1e-4))).collision


@pytest.mark.parametrize("side", SIDES)
def test_a_margin_keeps_walls_further_away(side: str) -> None:
    region = region_of(margin_m=0.05)
    assert region.measure(exact_scan(wall_at(side, 0.049))).collision
    assert not region.measure(exact_scan(wall_at(side, 0.051))).collision


def test_a_margin_with_its_resolution_keeps_32_bearings() -> None:
    assert len(region_of(margin_m=0.05, resolution_m=0.11).indices) == 32


def test_between_two_bearings_it_is_blind() -> None:
    """A post 1 cm thick stands 5 cm inside the tail, at 3 degrees from the back; the bearings are at 0 and 6."""
    bearing = math.radians(-177.0)
    post = shapely.Point(0.85 * math.cos(bearing), 0.85 * math.sin(bearing)).buffer(0.005)
    scan = exact_scan(post)
    assert touches(post, RECTANGLE)
    assert scan.ranges_m[3] < 0.9  # the whole scan has it
    assert not region_of().measure(scan).collision


@st.composite
def outlines_about_a_mount(draw: st.DrawFn) -> np.ndarray:
    """Return a convex outline, counter-clockwise, about a lidar at least 1 cm inside of it."""
    millimetres = st.integers(-1000, 1000)
    points = np.array(draw(st.lists(st.tuples(millimetres, millimetres), min_size=3, max_size=10))) / 1000.0
    hull = shapely.MultiPoint(points).convex_hull
    assume(hull.area > 0.05)
    outline = np.array(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1]
    weights = np.array(draw(st.lists(st.floats(0.0, 1.0), min_size=len(outline), max_size=len(outline))))
    assume(weights.sum() > 0.1)
    mount = weights @ outline / weights.sum()
    assume(shapely.distance(hull.exterior, shapely.Point(mount)) >= 0.01)
    return outline - mount


any_region = {
    "outline": outlines_about_a_mount(),
    "resolution_m": st.sampled_from([0.03, 0.095, 0.3]),
    "n_bearings": st.sampled_from([72, 360, 1000]),
}
OBTUSE = np.array([[-0.9, -0.3], [-0.4, -0.3001], [0.1, -0.3], [0.1, 0.3], [-0.9, 0.3]])  # a corner of 0.02 degrees
ON_AXIS = np.array([[-0.6, 0.0], [0.0, -0.4], [0.5, 0.0], [0.0, 0.4]])  # all corners on the axes
NEAR_SIDE = RECTANGLE + np.array([0.0, 0.29])  # 1 cm from the right side
SLIVER = np.array([[-0.05, -0.01], [3.0, -0.01], [3.0, 0.01], [-0.05, 0.01]])
ODD = {"obtuse": OBTUSE, "on axis": ON_AXIS, "near a side": NEAR_SIDE, "sliver": SLIVER}


def leaves(outline: np.ndarray, bearings: np.ndarray) -> np.ndarray:
    """Return where along the outline, in m, rays from the lidar cross it: shapely's answer, for comparison."""
    ring = shapely.LinearRing(outline)
    ends = 20.0 * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    rays = shapely.linestrings(np.stack([np.zeros_like(ends), ends], axis=1))
    crossings = shapely.intersection(rays, ring)
    return shapely.line_locate_point(ring, shapely.point_on_surface(crossings))


def check_region(outline: np.ndarray, resolution_m: float, n_bearings: int) -> None:
    """Hold all that is promised of the region of an outline."""
    region = SafetyRegion(outline, SafetyRegionConfig(resolution_m=resolution_m), n_bearings)
    indices, step = region.indices, 2.0 * math.pi / n_bearings
    bearings = beam_bearings(n_bearings)[indices]

    ascending = np.concatenate([indices[:1], indices[1:][indices[1:] > 0]])
    assert indices[0] == 0 and (np.diff(ascending) >= 0).all()
    assert (indices[len(np.trim_zeros(indices, "b")) :] == 0).all()  # what is 0 again comes last

    axes = [region.back, region.right, region.front, region.left]
    assert indices[axes].tolist() == [0, n_bearings // 4, n_bearings // 2, 3 * n_bearings // 4]
    corners = np.arctan2(outline[:, 1], outline[:, 0])
    watched = bearings[list(region.corners)]
    off = np.abs(np.angle(np.exp(1j * (watched[None] - corners[:, None])))).min(axis=1)
    assert len(region.corners) == len(outline) and off.max() <= step / 2 + 1e-8

    points = shapely.points(region.range_m * np.cos(bearings), region.range_m * np.sin(bearings))
    assert shapely.distance(shapely.LinearRing(outline), points).max() < 1e-6

    turns = np.diff(np.append(bearings, math.pi)) % (2.0 * math.pi)
    apart = turns > step * (1 + 1e-9)  # between these the outline is further apart than the scan's own step
    at, after = leaves(outline, bearings + step / 2)[apart], leaves(outline, bearings + turns - step / 2)[apart]
    assert ((after - at) % shapely.LinearRing(outline).length < 1.5 * resolution_m + 1e-6).all()


@settings(max_examples=150, deadline=None)
@given(**any_region)
def test_any_convex_outline_is_watched_as_promised(outline: np.ndarray, resolution_m: float, n_bearings: int) -> None:
    check_region(outline, resolution_m, n_bearings)


@pytest.mark.parametrize("outline", ODD.values(), ids=ODD)
@pytest.mark.parametrize("resolution_m", [0.03, 0.095, 0.3])
def test_odd_outlines_are_watched_as_promised(outline: np.ndarray, resolution_m: float) -> None:
    check_region(outline, resolution_m, N)


def flush_wall(outline: np.ndarray, side: int, gap_m: float) -> shapely.Polygon:
    """Return a wall 8 m long and 0.2 m thick along a side of the outline, `gap_m` outside of it."""
    a, b = outline[side], outline[(side + 1) % len(outline)]
    along = (b - a) / np.hypot(*(b - a))
    outwards = np.array([along[1], -along[0]])
    near = a + gap_m * outwards
    corners = [near - 4 * along, near + 4 * along]
    return shapely.Polygon([*corners, corners[1] + 0.2 * outwards, corners[0] + 0.2 * outwards])


def watches_every_side(outline: np.ndarray, resolution_m: float) -> None:
    """Hold that a wall flush with any long enough side is told from one that is not."""
    region = SafetyRegion(outline, SafetyRegionConfig(resolution_m=resolution_m), N)
    for side, length in enumerate(np.hypot(*(np.roll(outline, -1, axis=0) - outline).T)):
        span = np.arctan2(*outline[[side, (side + 1) % len(outline)]].T[::-1])
        wide_enough = (span[1] - span[0]) % (2 * math.pi) > 1.01 * 2 * math.pi / N
        if length >= resolution_m and wide_enough:
            assert region.measure(exact_scan(flush_wall(outline, side, -1e-4))).collision
        assert not region.measure(exact_scan(flush_wall(outline, side, 1e-4))).collision


@settings(max_examples=100, deadline=None)
@given(outline=outlines_about_a_mount(), resolution_m=st.sampled_from([0.095, 0.3, 1.0]))
def test_a_wall_flush_with_any_long_enough_side_is_seen(outline: np.ndarray, resolution_m: float) -> None:
    watches_every_side(outline, resolution_m)


def test_a_side_that_falls_between_two_indices_gets_a_bearing_of_its_own() -> None:
    """A nose 0.105 m wide and 5 m ahead spans 20.4 to 21.6 degrees: its corners round to 20 and 22, beside it."""
    angles = np.radians([-130.0, -40.0, 20.4, 21.6, 100.0])
    outline = np.stack([np.cos(angles), np.sin(angles)], axis=1) * [[1.0], [1.0], [5.0], [5.0], [1.0]]
    watches_every_side(outline, 0.1)
    assert {200, 201, 202} <= set(SafetyRegion(outline, SafetyRegionConfig(resolution_m=0.1), N).indices.tolist())


@settings(max_examples=200, deadline=None)
@given(outline=outlines_about_a_mount(), piece=convex_piece, at=place, kind=st.sampled_from(["sr", "firect"]))
def test_no_outline_fires_unless_the_exact_check_does(outline: np.ndarray, piece: list, at: tuple, kind: str) -> None:
    wall = shapely.MultiPoint(np.array(piece) + at).convex_hull
    if wall.area > 1e-6 and make(kind, outline).measure(exact_scan(wall)).collision:
        assert touches(wall, outline, slack_m=1e-6)


def test_an_outline_that_is_not_convex_is_refused() -> None:
    with pytest.raises(ConfigError, match="convex hull"):
        region_of(np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [0.0, 0.2], [-1.0, 1.0]]))


def test_fifr_takes_half_the_width_wherever_the_lidar_is() -> None:
    for offset in (-0.2, 0.0, 0.25):
        assert np.allclose(make("fifr", RECTANGLE + np.array([0.0, offset])).range_m, 0.3)


def test_fixed_intervals_have_as_many_bearings_at_equal_angles() -> None:
    for kind in (FIRect, FIFR):
        region = kind(RECTANGLE, SafetyRegionConfig(), N)
        assert len(region.indices) == 32
        assert np.abs(region.indices - np.arange(32) * 11.25).max() <= 0.5
        assert (region.back, region.right, region.front, region.left) == (0, 8, 16, 24)


def test_fifr_covers_the_width_only_and_misses_a_wall_in_the_tail() -> None:
    tail_hit = exact_scan(wall_at("back", -0.05))
    sr, firect, fifr = (kind(RECTANGLE, SafetyRegionConfig(), N) for kind in (SafetyRegion, FIRect, FIFR))
    assert np.allclose(fifr.range_m, 0.3)
    assert sr.measure(tail_hit).collision and firect.measure(tail_hit).collision
    assert not fifr.measure(tail_hit).collision


def test_equal_angles_are_blinder_along_the_tail_than_the_safety_region() -> None:
    """Posts 4 cm thick, their centres 3 cm inside the outline, all round the car: count those that are noticed."""
    sr, firect, fifr = (kind(RECTANGLE, SafetyRegionConfig(), N) for kind in (SafetyRegion, FIRect, FIFR))
    track = shapely.Polygon(RECTANGLE).buffer(-0.03).exterior
    scans = [exact_scan(track.interpolate(s, normalized=True).buffer(0.02)) for s in np.linspace(0, 1, 300)]
    found = [sum(region.measure(scan).collision for scan in scans) for region in (sr, firect, fifr)]
    assert found[0] > found[1] > found[2]


def test_the_exact_check_follows_the_car() -> None:
    wall = shapely.box(1.0, -1.0, 2.0, 1.0)
    footprint = ROBOT.footprint_base  # 1.0 m long, 0.6 m wide
    assert not footprint_hits(wall, footprint, Pose2(0.49, 0.0, 0.0))
    assert footprint_hits(wall, footprint, Pose2(0.51, 0.0, 0.0))
    assert not footprint_hits(wall, footprint, Pose2(0.69, 0.0, math.pi / 2))
    assert footprint_hits(wall, footprint, Pose2(0.71, 0.0, math.pi / 2))
