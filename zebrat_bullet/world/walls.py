"""Walls round a free space: a smooth ring, or a row of cardboard boxes."""

import math

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import affinity

from zebrat_bullet.world.elements import Box, Boxes, Buttress, Obstacle, PolygonObstacle, Post, Wall
from zebrat_bullet.world.solid import Solid, polygons_of
from zebrat_bullet.world.track import Track

# A mitred wall corner may reach this many thicknesses out; sharper ones are cut off.
_MITRE_LIMIT = 2.0
# Walls end this much before the open-space line, or rounding could leave a skin across it.
_HAIR_M = 1e-3


def wall_solids(free_space: shapely.Polygon, open_line: NDArray[np.float64] | None, wall: Wall) -> list[Solid]:
    """Return the walls that close a free space everywhere but along its (2, 2) open-space line, if it has one."""
    outside: shapely.Geometry = free_space
    if open_line is not None:
        outside = shapely.union_all([free_space, _beyond(open_line, wall.thickness_m)])
    if wall.boxes is not None:
        return _box_row(free_space, open_line, outside, wall, wall.boxes)
    ring = free_space.buffer(wall.thickness_m, join_style="mitre", mitre_limit=_MITRE_LIMIT).difference(outside)
    return [Solid(part, 0.0, wall.height_m) for part in polygons_of(ring)]


def _beyond(open_line: NDArray[np.float64], thickness: float) -> shapely.Polygon:
    """Return the strip past the open-space line that a ring of walls would stand in."""
    along = open_line[1] - open_line[0]
    along = along / np.hypot(*along)
    out = np.array([along[1], -along[0]])
    reach = (_MITRE_LIMIT + 1) * thickness
    a, b = open_line[0] - reach * along - _HAIR_M * out, open_line[1] + reach * along - _HAIR_M * out
    return shapely.Polygon([a, a + reach * out, b + reach * out, b])


def walls_are_whole(
    free_space: shapely.Polygon, walls: shapely.MultiPolygon, open_line: NDArray[np.float64], wall: Wall
) -> bool:
    """Return whether walls stand all along a free space but for its exit and the gaps between boxes.

    What is cleared for the way out can take the wall of a leg beside it too, and rounding can lose a box.
    """
    boxes = wall.boxes
    beside_m = 2 * _HAIR_M + (math.hypot(boxes.setback_m, boxes.gap_m[1] / 2) if boxes is not None else 0.0)
    bare = free_space.boundary.difference(walls.buffer(beside_m))
    # The walls reach so far into the exit from both its ends.
    return bool(bare.length < math.dist(*open_line) - 2 * beside_m + _HAIR_M)


def _box_row(
    free_space: shapely.Polygon,
    open_line: NDArray[np.float64] | None,
    outside: shapely.Geometry,
    wall: Wall,
    boxes: Boxes,
) -> list[Solid]:
    rng = np.random.default_rng(boxes.seed)
    corners = np.array(shapely.geometry.polygon.orient(free_space).exterior.coords)[:-1]
    exit_middle = shapely.Point() if open_line is None else shapely.Point(open_line.mean(axis=0))
    solids = []
    for a, b, c in zip(corners, np.roll(corners, -1, axis=0), np.roll(corners, -2, axis=0), strict=True):
        if shapely.LineString([a, b]).distance(exit_middle) < 1e-3:
            continue
        # The free space lies to the left of its boundary, so the boxes stand to the right.
        along = (b - a) / math.dist(a, b)
        out = np.array([along[1], -along[0]])
        # A row runs on past an outer corner, or the next row would leave a slit there to see through.
        outer_corner = along[0] * (c - b)[1] - along[1] * (c - b)[0] > 0
        length = math.dist(a, b) + (wall.thickness_m if outer_corner else 0.0)
        for begin, end, setback in _divide(length, boxes, rng):
            near, far = setback * out, (setback + wall.thickness_m) * out
            front, back = a + begin * along, a + end * along
            outline = shapely.Polygon([front + near, front + far, back + far, back + near]).difference(outside)
            height = float(rng.uniform(*boxes.height_m))
            solids += [Solid(part, 0.0, height) for part in polygons_of(outline)]
    return solids


def _divide(length: float, boxes: Boxes, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    """Return (begin, end, setback) of the boxes that fill a straight of a wall."""
    row, at = [], 0.0
    while at < length:
        end = at + float(rng.uniform(*boxes.length_m))
        # A remainder too short for a box of its own goes to the last one.
        end = length if length - end < boxes.length_m[0] + boxes.gap_m[1] else end
        # The boxes at both ends stand flush, so that rows meet without a slit.
        inner = at > 0.0 and end < length
        row.append((at, end, float(rng.uniform(0.0, boxes.setback_m)) if inner else 0.0))
        at = end + float(rng.uniform(*boxes.gap_m))
    return row


def obstacle_solid(obstacle: Obstacle, track: Track | None) -> Solid:
    """Return the prism of one obstacle; a buttress needs the track on whose wall it stands."""
    return Solid(_outline(obstacle, track), obstacle.bottom_m, obstacle.height_m, obstacle.low)


def _outline(obstacle: Obstacle, track: Track | None) -> shapely.Polygon:
    match obstacle:
        case Box(box=(x, y), size=(length, width)):
            upright = shapely.box(x - length / 2, y - width / 2, x + length / 2, y + width / 2)
            return affinity.rotate(upright, obstacle.yaw_deg, origin=(x, y))
        case PolygonObstacle():
            return shapely.Polygon(obstacle.polygon)
        case Post():
            return shapely.Point(obstacle.post).buffer(obstacle.radius, quad_segs=6)
        case Buttress():
            assert track is not None
            return _buttress(obstacle, track)
    raise AssertionError(obstacle)


def _buttress(obstacle: Buttress, track: Track) -> shapely.Polygon:
    pose = track.pose_at(obstacle.at_m)
    half = float(np.interp(obstacle.at_m, track.distances_m, track.widths_m)) / 2
    outer, inner = half + 0.02, half - obstacle.depth
    block = shapely.box(-obstacle.length / 2, inner, obstacle.length / 2, outer)
    if obstacle.buttress == "right":
        block = affinity.scale(block, yfact=-1, origin=(0, 0))
    turned = affinity.rotate(block, pose.yaw, origin=(0, 0), use_radians=True)
    return affinity.translate(turned, pose.x, pose.y)
