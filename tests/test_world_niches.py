"""Niches open pockets where a file says, and nowhere else."""

from pathlib import Path

import pytest
import shapely

from zebrat_bullet.errors import WorldError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import World
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.schema import parse_spec
from zebrat_bullet.world.solid import is_watertight
from zebrat_bullet.world.validate import validate_world

CORNER = [{"straight": 4.0, "width": 1.4}, {"turn": 90}, {"straight": 3.0, "width": 1.4}]


def corner_world(*niches: dict[str, object], **fields: object) -> World:
    data = {"name": "corner", "segments": CORNER, "niches": list(niches), **fields}
    return build_world(parse_spec(data, "corner.yaml"), Path("corner.yaml"))


def test_a_niche_is_free_floor_beside_the_corridor_walled_on_three_sides() -> None:
    without, world = corner_world(), corner_world({"niche": "left", "at_m": 2.0, "length": 1.0, "depth": 0.8})
    pocket = world.free_space.difference(without.free_space)
    assert pocket.symmetric_difference(shapely.box(1.5, 0.7, 2.5, 1.5)).area < 1e-3
    assert not world.walls.intersects(pocket.buffer(-1e-3))
    for x, y in ((1.45, 1.0), (2.55, 1.0), (2.0, 1.55)):
        assert world.walls.contains(shapely.Point(x, y))
    assert is_watertight(world.mesh)
    assert (world.centre_line == without.centre_line).all() and (world.widths_m == without.widths_m).all()
    validate_world(world, load_robot(), "corner.yaml")


def test_a_niche_at_the_corner_point_goes_straight_ahead() -> None:
    world = corner_world({"niche": "right", "at_m": 4.01, "length": 1.36, "depth": 1.0})
    assert world.free_space.contains(shapely.box(4.0, -0.6, 5.65, 0.6))
    assert not world.free_space.intersects(shapely.Point(5.75, 0.0))


def test_a_world_with_a_niche_in_a_wall_of_boxes_is_closed_round_it() -> None:
    niche = {"niche": "right", "at_m": 1.8, "length": 1.2, "depth": 0.8}
    world = corner_world(niche, wall={"thickness_m": 0.3, "boxes": {"seed": 3, "gap_m": [0.0, 0.0]}})
    assert world.walls.buffer(0.04).contains(shapely.LineString([(1.2, -0.75), (1.2, -1.5), (2.4, -1.5), (2.4, -0.75)]))


@pytest.mark.parametrize(
    ("niche", "message"),
    [
        ({"niche": "left", "at_m": 3.2, "length": 1.0, "depth": 0.5}, r"niches\[0\].at_m: no straight wall is 1.0 m"),
        ({"niche": "left", "at_m": 9.0, "length": 0.5, "depth": 0.5}, "no straight wall"),
        ({"niche": "left", "at_m": 2.7, "length": 1.0, "depth": 0.0}, "depth"),
        ({"niche": "left", "at_m": 2.0, "length": 1.0, "depth": 1.8}, r"niches\[0\]: runs into the track"),
        ({"niche": "up", "at_m": 2.0, "length": 1.0, "depth": 1.0}, "'left' or 'right'"),
    ],
)
def test_a_niche_that_cannot_be_there_is_refused(niche: dict[str, object], message: str) -> None:
    back = [*CORNER[:-1], {"straight": 3.0, "width": 1.4}, {"turn": 90}, {"straight": 6.0, "width": 1.4}]
    with pytest.raises(WorldError, match=message):
        corner_world(niche, segments=back if niche["depth"] == 1.8 else CORNER)


def test_two_niches_that_meet_are_refused() -> None:
    first = {"niche": "right", "at_m": 1.5, "length": 1.0, "depth": 0.5}
    with pytest.raises(WorldError, match=r"niches\[1\]: runs into"):
        corner_world(first, first | {"at_m": 2.2})


def test_niches_belong_to_segments() -> None:
    square = [(0, 0), (3, 0), (3, 2), (0, 2)]
    data = {"name": "x", "free_space": [square], "centre_line": [(1, 1), (4, 1)], "open_line": [(3, 0), (3, 2)]}
    niche = {"niche": "right", "at_m": 1.5, "length": 1.0, "depth": 0.5}
    with pytest.raises(WorldError, match="niches open in the walls of a `segments` track"):
        parse_spec(data | {"start": {"pose": (1, 1, 0)}, "niches": [niche]}, "x.yaml")
