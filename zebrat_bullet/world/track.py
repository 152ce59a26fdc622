"""Segments of a corridor, laid end to end from the origin along +x: centre line, widths, free space."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.elements import Straight, Turn

SPACING_M = 0.1
GOAL_M = 1.0
WAY_OUT_M = GOAL_M + 0.5
# Facets of 5 degrees stay within 2 mm of the true arc at a radius of 2 m.
_FACET_RAD = math.radians(5.0)
# Two legs of a track that come closer than this have no wall between them worth the name.
THINNEST_WALL_M = 0.02
_HAIR_M = 1e-4


@dataclass(frozen=True)
class Track:
    """A corridor of known course.

    Attributes:
        free_space: from the closed end to the open-space line.
        points: (N, 2) float64, centre line at most `SPACING_M` apart, from the closed end to the goal.
        distances_m: (N,) float64, distance of each point along the centre line.
        widths_m: (N,) float64, declared width there.
        turns: distance of each corner (middle of a rounded turn), and by how many degrees it turns left.
        exit: pose on the open-space line, looking out.
        length_m: from the closed end to the open-space line.
    """

    free_space: shapely.Polygon
    points: NDArray[np.float64]
    distances_m: NDArray[np.float64]
    widths_m: NDArray[np.float64]
    turns: tuple[tuple[float, float], ...]
    exit: Pose2
    length_m: float

    def pose_at(self, distance_m: float) -> Pose2:
        """Return the pose on the centre line, looking along it."""
        i = int(np.clip(np.searchsorted(self.distances_m, distance_m, side="right") - 1, 0, len(self.points) - 2))
        step = self.points[i + 1] - self.points[i]
        part = (distance_m - self.distances_m[i]) / (self.distances_m[i + 1] - self.distances_m[i])
        x, y = self.points[i] + part * step
        return Pose2(float(x), float(y), math.atan2(step[1], step[0]))


def lay_track(segments: Sequence[Straight | Turn], source: str) -> Track:
    """Lay the segments and join them to one corridor.

    Raises:
        WorldError: a segment does not fit its neighbours, or the track runs into itself.
    """
    _check_order(segments, source)
    widths = _widths(segments)
    takes = [0.0, *(corner_extent(segment, width) for segment, width in zip(segments, widths, strict=True)), 0.0]
    pose, travelled = Pose2(0.0, 0.0, 0.0), 0.0
    line, line_widths = [pose], []
    laid, turns = [], []
    for i, (segment, width) in enumerate(zip(segments, widths, strict=True)):
        _check_fit(segment, width, takes[i] + takes[i + 2], f"{source}: segments[{i}]", (pose.x, pose.y))
        piece, course, pose = _lay(segment, width, pose, takes[i], takes[i + 1], takes[i + 2])
        run = sum(math.dist((a.x, a.y), (b.x, b.y)) for a, b in pairwise([line[-1], *course]))
        if isinstance(segment, Turn):
            turns.append((travelled + run / 2, segment.turn))
        if piece is not None:
            laid.append((i, piece))
        travelled += run
        line += course
        line_widths += [width] * len(course)
    # The way out must stay clear of the track too, as far as the goal and half a car beyond.
    way_out = strip(pose, 0.0, WAY_OUT_M, line_widths[-1])
    _check_apart([*laid, (len(segments) - 1, way_out)], takes[1:-1], source)
    corners = np.array([(p.x, p.y) for p in [*line, _ahead(pose, GOAL_M)]])
    points, distances, at_widths = resample(corners, np.array([*line_widths, line_widths[-1]]))
    return Track(join_ground([piece for _, piece in laid]), points, distances, at_widths, tuple(turns), pose, travelled)


def resample(
    line: NDArray[np.float64], edge_values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Divide each edge of a (K, 2) line evenly; keep its corners.

    Returns:
        (N, 2) points at most `SPACING_M` apart, (N,) distances along the line, (N,) the value of each point's edge.
    """
    points, values = [line[:1]], [edge_values[:1]]
    for a, b, value in zip(line[:-1], line[1:], edge_values, strict=True):
        n = max(1, math.ceil(math.dist(a, b) / SPACING_M - 1e-9))
        points.append(a + (b - a) * (np.arange(1, n + 1) / n)[:, None])
        values.append(np.full(n, value))
    joined = np.concatenate(points)
    distances = np.concatenate([[0.0], np.hypot(*np.diff(joined, axis=0).T).cumsum()])
    return joined, distances, np.concatenate(values)


def course_m(segments: Sequence[Straight | Turn]) -> float:
    """Return how long the centre line of segments is up to the open-space line, its facets counted as laid."""
    return sum(
        segment.straight if isinstance(segment, Straight) else _facets(segment.turn) * _facet_m(segment)
        for segment in segments
    )


def _facets(turn_deg: float) -> int:
    return math.ceil(abs(math.radians(turn_deg)) / _FACET_RAD)


def _facet_m(turn: Turn) -> float:
    return 2.0 * turn.radius * math.sin(abs(math.radians(turn.turn)) / _facets(turn.turn) / 2.0)


def corner_extent(segment: Straight | Turn, width: float) -> float:
    """Return how much of each neighbouring straight a sharp corner takes up."""
    if isinstance(segment, Straight) or segment.radius > 0:
        return 0.0
    return width / 2 * math.tan(abs(math.radians(segment.turn)) / 2)


def _check_order(segments: Sequence[Straight | Turn], source: str) -> None:
    for i, segment in enumerate(segments):
        sharp = isinstance(segment, Turn) and segment.radius == 0
        sides = [segments[j] for j in (i - 1, i + 1) if 0 <= j < len(segments)]
        if sharp and (len(sides) < 2 or not all(isinstance(side, Straight) for side in sides)):
            raise WorldError(f"{source}: segments[{i}]: a sharp turn stands between two straights; add one beside it")
    if not isinstance(segments[0], Straight) or not isinstance(segments[-1], Straight):
        raise WorldError(f"{source}: segments: a track begins and ends with a straight; add one")


def _check_fit(segment: Straight | Turn, width: float, taken: float, where: str, at: tuple[float, float]) -> None:
    """Refuse a straight shorter than what the sharp corners beside it take, or a turn tighter than its inner wall."""
    if isinstance(segment, Straight) and segment.straight < taken - 1e-9:
        raise WorldError(
            f"{where}.straight: {segment.straight} m is shorter than the {taken:.2f} m that its sharp corners take; "
            "lengthen it or give the turns a radius",
            at=at,
        )
    if isinstance(segment, Turn) and 0 < segment.radius < width / 2:
        raise WorldError(
            f"{where}.radius: {segment.radius} m is less than half the width {width} m, so the inner wall would cross "
            "itself; enlarge the radius, or 0 for a sharp corner",
            at=at,
        )


def _widths(segments: Sequence[Straight | Turn]) -> list[float]:
    """Return a width for every segment; a turn without one is as wide as its wider neighbour."""
    widths: list[float] = []
    for i, segment in enumerate(segments):
        # The first and the last segment are straights, and so have a width.
        widths.append(segment.width or max(widths[-1], segments[i + 1].width or 0.0))
    return widths


def _lay(
    segment: Straight | Turn, width: float, pose: Pose2, before: float, extent: float, after: float
) -> tuple[shapely.Polygon | None, list[Pose2], Pose2]:
    """Return the ground of a segment, the centre line that it adds, and the pose at its end.

    Args:
        segment, width, pose: what to lay, and where it begins.
        before, extent, after: how much of straights the corner before it, it itself, and the one after it take.
    """
    if isinstance(segment, Straight):
        end = _ahead(pose, segment.straight)
        return strip(pose, before, segment.straight - after, width), [end], end
    if segment.radius == 0:
        end = Pose2(pose.x, pose.y, pose.yaw + math.radians(segment.turn))
        return _corner(pose, segment.turn, width, extent), [], end
    piece, course = _arc(pose, segment.turn, segment.radius, width)
    return piece, course, course[-1]


def join_ground(pieces: list[shapely.Polygon]) -> shapely.Polygon:
    """Return the one outline of pieces that share edges."""
    # Rounding leaves hair-thin gaps between pieces that share an edge; grown by a hair they overlap instead.
    grown = shapely.union_all(shapely.buffer(pieces, _HAIR_M, join_style="mitre"))
    shrunk = grown.buffer(-_HAIR_M, join_style="mitre")
    # No leg touches another, so a corridor has no holes; rounding sometimes makes a hair-thin one, even an invalid one.
    return shapely.Polygon(shrunk.exterior).simplify(_HAIR_M / 2)


def _ahead(pose: Pose2, distance: float, left: float = 0.0) -> Pose2:
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return Pose2(pose.x + c * distance - s * left, pose.y + s * distance + c * left, pose.yaw)


def _polygon(poses: Sequence[Pose2]) -> shapely.Polygon:
    return shapely.Polygon([(p.x, p.y) for p in poses])


def strip(pose: Pose2, begin: float, end: float, width: float) -> shapely.Polygon | None:
    """Return a rectangle along a pose, from `begin` to `end` m ahead of it; None where that is no length."""
    if end - begin < 1e-6:
        return None
    return _polygon([_ahead(pose, d, left) for d, left in _box(begin, end, width / 2)])


def _box(begin: float, end: float, half: float) -> list[tuple[float, float]]:
    return [(begin, -half), (end, -half), (end, half), (begin, half)]


def _corner(pose: Pose2, turn_deg: float, width: float, extent: float) -> shapely.Polygon:
    """Return the kite between the two straights of a sharp corner whose corner point is at `pose`."""
    outer = -math.copysign(width / 2, turn_deg)
    out = Pose2(pose.x, pose.y, pose.yaw + math.radians(turn_deg))
    return _polygon(
        [
            _ahead(pose, -extent, outer),
            _ahead(pose, extent, outer),
            _ahead(out, extent, outer),
            _ahead(pose, -extent, -outer),
        ]
    )


def _arc(pose: Pose2, turn_deg: float, radius: float, width: float) -> tuple[shapely.Polygon, list[Pose2]]:
    turn = math.radians(turn_deg)
    centre = _ahead(pose, 0.0, math.copysign(radius, turn))
    yaws = pose.yaw + np.linspace(0.0, turn, _facets(turn_deg) + 1)
    # Seen from the turning centre, the centre line lies on the right of a left turn and on the left of a right turn.
    rims = [
        [_ahead(Pose2(centre.x, centre.y, yaw), 0.0, -math.copysign(r, turn)) for yaw in yaws]
        for r in (radius - width / 2, radius, radius + width / 2)
    ]
    return _polygon(rims[0] + rims[2][::-1]), rims[1][1:]


def _check_apart(laid: list[tuple[int, shapely.Polygon]], takes: list[float], source: str) -> None:
    """Refuse a track of which two parts that do not follow each other overlap or share a wall too thin to build."""
    owners = [owner for owner, _ in laid]
    sharp = np.array([takes[owner] > 0 for owner in owners])
    shapes = np.array([piece for _, piece in laid])
    first, second = np.triu_indices(len(shapes), k=2)
    # The two straights of a sharp corner meet in its inner corner point: they may touch, but not overlap.
    joined = (second - first == 2) & sharp[(first + second) // 2]
    bad = np.zeros(len(first), dtype=bool)
    bad[joined] = shapely.area(shapely.intersection(shapes[first[joined]], shapes[second[joined]])) > 1e-6
    bad[~joined] = shapely.distance(shapes[first[~joined]], shapes[second[~joined]]) < THINNEST_WALL_M
    if bad.any():
        i, j = owners[first[bad][0]], owners[second[bad][0]]
        meet = shapely.shortest_line(shapes[first[bad][0]], shapes[second[bad][0]]).centroid
        raise WorldError(
            f"{source}: segments[{j}]: the track runs into its own segments[{i}], so their walls would cross; "
            "lengthen a straight between them or enlarge the radius of a turn",
            at=(meet.x, meet.y),
        )
