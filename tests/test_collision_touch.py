"""Poses that touch: each side and each corner of the car, a millimetre inside and outside, at every yaw, either caster;
and what the representations cannot see."""

import math
from itertools import product

import numpy as np
import pytest
import shapely
from boxes import box_world
from numpy.typing import NDArray
from poses import placed, ray_truth, upright_world

from zebrat_bullet.config import SafetyRegionConfig
from zebrat_bullet.detection.check import REPRESENTATIONS, PoseCheck
from zebrat_bullet.detection.representations import RAY_REPRESENTATIONS
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World

MM = 0.001
ROBOT = load_robot()
REGIONS = {kind: make_region(ROBOT, SafetyRegionConfig(kind=kind), 360) for kind in RAY_REPRESENTATIONS}
LIDAR_X = 0.4
# Outward direction and place of each side's middle, and of each corner, of the footprint of 1.0 m x 0.6 m.
SIDES = {
    "back": ((-1.0, 0.0), (-0.5, 0.0)),
    "right": ((0.0, -1.0), (0.0, -0.3)),
    "front": ((1.0, 0.0), (0.5, 0.0)),
    "left": ((0.0, 1.0), (0.0, 0.3)),
}
CORNERS = {
    (sx, sy): ((sx * math.sqrt(0.5), sy * math.sqrt(0.5)), (sx * 0.5, sy * 0.3)) for sx in (-1, 1) for sy in (-1, 1)
}


@pytest.fixture(params=["embree", "bullet"])
def check(request: pytest.FixtureRequest, checkers):
    return checkers[request.param].check


def world_round(pose: Pose2, *outlines_base: NDArray, **heights: float) -> World:
    """Return a world with walls that are given in the frame of a car at `pose`."""
    return upright_world(*(shapely.Polygon(placed(outline, [pose])[0]) for outline in outlines_base), **heights)


def block(direction: tuple[float, float], at: tuple[float, float], half_width: float) -> NDArray[np.float64]:
    """Return a wall 0.2 m thick whose flat face, square to `direction`, has its middle at `at`."""
    out, along = np.array(direction), np.array([-direction[1], direction[0]])
    near, far = np.array(at), np.array(at) + 0.2 * out
    return np.array(
        [near - half_width * along, far - half_width * along, far + half_width * along, near + half_width * along]
    )


def tip(direction: tuple[float, float], at: tuple[float, float]) -> NDArray[np.float64]:
    """Return a square pillar on edge whose right-angled edge, at `at`, points against `direction`."""
    out, along, edge = np.array(direction), np.array([-direction[1], direction[0]]), np.array(at)
    return np.array([edge, edge + 0.1 * (out - along), edge + 0.2 * out, edge + 0.1 * (out + along)])


def beside(direction: tuple[float, float], at: tuple[float, float], gap_m: float) -> tuple[float, float]:
    return at[0] + gap_m * direction[0], at[1] + gap_m * direction[1]


@pytest.mark.parametrize("side", SIDES)
def test_a_flat_wall_flush_with_a_side_is_decided_to_a_millimetre_at_every_yaw(side: str, check) -> None:
    direction, middle = SIDES[side]
    for degrees, gap_m in product(range(0, 360, 15), (-MM, MM)):
        pose = Pose2(1.0, -2.0, math.radians(degrees))
        said = check(world_round(pose, block(direction, beside(direction, middle, gap_m), 2.0)), pose)
        # FIFR's one range, 0.3 m, ends short of the tail and beyond the nose.
        expected = dict.fromkeys(REPRESENTATIONS, gap_m < 0) | {"back": {"fifr": False}, "front": {"fifr": True}}.get(
            side, {}
        )
        assert said.collides == expected, said.table()


def test_each_corner_at_a_flat_wall_is_decided_to_a_millimetre_by_the_polygon(check) -> None:
    world = box_world(((1.0, 1.3), (-3.0, 3.0), (0.0, 1.0)))
    touching = set()
    for degrees, gap_m in product(np.arange(2.5, 360.0, 5.0), (-MM, MM)):
        ahead = placed(ROBOT.footprint_base, [Pose2(0.0, 0.0, math.radians(degrees))])[0][:, 0]
        touching.add(int(ahead.argmax()))
        pose = Pose2(1.0 - ahead.max() - gap_m, 0.2, math.radians(degrees))
        expect(check(world, pose), world, gap_m < 0)
    assert touching == {0, 1, 2, 3}


@pytest.mark.parametrize("place", [*SIDES, *CORNERS], ids=str)
def test_the_edge_of_a_pillar_at_a_side_or_corner_is_decided_to_a_millimetre_by_the_polygon(place, check) -> None:
    direction, at = (SIDES | CORNERS)[place]
    for degrees, gap_m in product(range(0, 360, 30), (-MM, MM)):
        pose = Pose2(-1.0, 3.0, math.radians(degrees))
        world = world_round(pose, tip(direction, beside(direction, at, gap_m)))
        expect(check(world, pose), world, gap_m < 0)


def expect(said: PoseCheck, world: World, hit: bool) -> None:
    """Hold polygon and physics to the truth, the regions to their own rays, and the cloud to lie between."""
    collides = said.collides
    assert collides["polygon"] == collides["physics"] == hit, said.table()
    for kind, region in REGIONS.items():
        truth = ray_truth(region, ROBOT, world, [said.pose])
        assert bool(truth.must[0]) <= collides[kind] <= bool(truth.may[0]), f"{kind}\n{said.table()}"
    assert (collides["sr"] or collides["firect"]) <= collides["cloud"] <= hit, said.table()


def test_a_post_between_two_rays_is_invisible_to_all_that_watch_32(check) -> None:
    """1 cm thick, 5 cm inside the tail, 3 degrees off its middle: SR looks at 0 and 6 degrees, FIRect at 0 and 11."""
    bearing = math.radians(-177.0)
    middle = shapely.Point(LIDAR_X + 0.85 * math.cos(bearing), 0.85 * math.sin(bearing))
    post = np.array(middle.buffer(0.005).exterior.coords)
    for degrees in range(0, 360, 45):
        pose = Pose2(0.5, 0.5, math.radians(degrees))
        said = check(world_round(pose, post), pose)
        assert [name for name, hit in said.collides.items() if hit] == ["polygon", "physics", "cloud"], said.table()


def test_a_kerb_in_the_blind_zone_is_known_to_polygon_and_physics_alone(check) -> None:
    pose = Pose2(0.0, 0.0, 0.0)
    said = check(world_round(pose, block((1.0, 0.0), (0.4, 0.0), 2.0), top_m=0.2), pose)
    assert [name for name, hit in said.collides.items() if hit] == ["polygon", "physics"], said.table()


def test_under_a_beam_that_hangs_over_its_roof_only_physics_passes(check) -> None:
    """The roof is at 0.47 m, the band of the scan ends at 0.80 m; walls that begin in the band count as walls."""
    pose = Pose2(0.0, 0.0, 0.0)
    said = check(world_round(pose, block((1.0, 0.0), (0.45, 0.0), 2.0), bottom_m=0.5), pose)
    assert [name for name, hit in said.collides.items() if not hit] == ["physics"], said.table()


def test_a_car_wholly_inside_of_a_wall_is_known_to_the_polygon_alone(check) -> None:
    """Physics, rays and cloud meet surfaces, and those are out of reach."""
    said = check(box_world(((-4.0, 4.0), (-4.0, 4.0), (0.0, 1.0))), Pose2(0.0, 0.0, 0.3))
    assert [name for name, hit in said.collides.items() if hit] == ["polygon"], said.table()


def test_a_nose_inside_of_a_wall_sees_its_surface_from_within(check) -> None:
    said = check(box_world(((0.2, 3.0), (-3.0, 3.0), (0.0, 1.0))), Pose2(0.0, 0.0, 0.0))
    assert all(said.collides.values())
    # Deepest along the bearing nearest to the tail's corners: from the lidar at x = 0.4 the face is 0.2 m back.
    assert said.gaps_m["sr"] == pytest.approx((0.2 - 0.9) / math.cos(math.radians(18)), abs=1e-4)


def test_gaps_and_bearings_say_where_the_nearest_wall_is(check) -> None:
    """A wall 0.25 m off the left side, its near end abreast of the lidar."""
    pose = Pose2(2.0, 1.0, math.pi / 2)
    said = check(world_round(pose, block((0.0, 1.0), (LIDAR_X, 0.55), 1.0)), pose)
    assert not any(said.collides.values())
    for name in ("polygon", "cloud", "sr", "firect", "fifr"):
        assert said.gaps_m[name] == pytest.approx(0.25, abs=1e-3), said.table()
    assert said.findings["sr"].bearing_rad == pytest.approx(math.pi / 2)
    assert said.gaps_m["physics"] == math.inf


def test_in_an_empty_world_nothing_is_seen(check) -> None:
    said = check(box_world(), Pose2(0.0, 0.0, 0.0))
    assert not any(said.collides.values()) and set(said.gaps_m.values()) == {math.inf}
    assert said.table().count("-") >= 2 * len(REPRESENTATIONS)


def test_a_pose_that_is_not_finite_is_refused(check) -> None:
    with pytest.raises(ConfigError, match="must be finite"):
        check(box_world(), Pose2(0.0, math.inf, 0.0))


def test_a_far_wall_ahead_is_the_nearest_although_the_long_tail_sees_nothing_sooner(check) -> None:
    """Ahead 5.4 m are left of 5.5 m; straight back the beam ends after 6 m, 5.1 m behind the tail."""
    said = check(box_world(((5.9, 6.1), (-3.0, 3.0), (0.0, 1.0))), Pose2(0.0, 0.0, 0.0))
    assert said.gaps_m["sr"] == pytest.approx(5.4, abs=1e-3), said.table()
