"""Segments of a corridor, laid end to end from the origin along +x: centre line, widths, free space."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.schema import Straight, Turn

SPACING_M = 0.1
GOAL_M = 1.0
# Facets of 5 degrees stay within 2 mm of the true arc at a radius of 2 m.
_FACET_RAD = math.radians(5.0)
# Two legs of a track that come closer than this have no wall between them worth the name.
_THINNEST_WALL_M = 0.02
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
    widths = _widths(segments, source)
    takes = [_corner_extent(segment, width) for segment, width in zip(segments, widths, strict=True)]
    pose = Pose2(0.0, 0.0, 0.0)
    pieces: list[shapely.Polygon] = []
    owners: list[int] = []
    line: list[tuple[float, float]] = [(0.0, 0.0)]
    line_widths: list[float] = []
    turns: list[tuple[float, float]] = []
    travelled = 0.0
    for i, (segment, width) in enumerate(zip(segments, widths, strict=True)):
        if isinstance(segment, Straight):
            before = takes[i - 1] if i > 0 else 0.0
            after = takes[i + 1] if i + 1 < len(segments) else 0.0
            if segment.straight < before + after - 1e-9:
                raise WorldError(
                    f"{source}: segments[{i}].straight: {segment.straight} m is shorter than the "
                    f"{before + after:.2f} m that its sharp corners take; lengthen it or give the turns a radius"
                )
            piece = _strip(pose, before, segment.straight - after, width)
            course = [_ahead(pose, segment.straight)]
        elif segment.radius == 0:
            piece, course = _corner(pose, segment.turn, width, takes[i]), []
            pose = Pose2(pose.x, pose.y, pose.yaw + math.radians(segment.turn))
            turns.append((travelled, segment.turn))
        else:
            if segment.radius < width / 2:
                raise WorldError(
                    f"{source}: segments[{i}].radius: {segment.radius} m is less than half the width {width} m, "
                    "so the inner wall would cross itself; enlarge the radius, or 0 for a sharp corner"
                )
            piece, course = _arc(pose, segment.turn, segment.radius, width)
            turns.append((travelled + abs(math.radians(segment.turn)) * segment.radius / 2, segment.turn))
        if piece is not None:
            pieces.append(piece)
            owners.append(i)
        if course:
            pose = course[-1]
            steps = np.diff([line[-1], *((p.x, p.y) for p in course)], axis=0)
            travelled += float(np.hypot(*steps.T).sum())
            line += [(p.x, p.y) for p in course]
            line_widths += [width] * len(course)
    # The way out must stay clear of the track too, as far as the goal and half a car beyond.
    way_out = _strip(pose, 0.0, GOAL_M + 0.5, line_widths[-1])
    sharp = [takes[owner] > 0 for owner in owners]
    _check_apart([*pieces, way_out], [*owners, len(segments) - 1], [*sharp, False], source)
    # Rounding leaves hair-thin gaps between pieces that share an edge; grown by a hair they overlap instead.
    grown = shapely.union_all(shapely.buffer(pieces, _HAIR_M, join_style="mitre"))
    free_space = grown.buffer(-_HAIR_M, join_style="mitre").simplify(_HAIR_M / 2)
    goal = _ahead(pose, GOAL_M)
    points, distances, at_widths = resample(
        np.array([*line, (goal.x, goal.y)]), np.array([*line_widths, line_widths[-1]])
    )
    return Track(free_space, points, distances, at_widths, tuple(turns), pose, travelled)


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


def _widths(segments: Sequence[Straight | Turn], source: str) -> list[float]:
    """Return a width for every segment; a turn without one is as wide as its wider neighbour."""
    for i, segment in enumerate(segments):
        sharp = isinstance(segment, Turn) and segment.radius == 0
        sides = [segments[j] for j in (i - 1, i + 1) if 0 <= j < len(segments)]
        if sharp and (len(sides) < 2 or not all(isinstance(side, Straight) for side in sides)):
            raise WorldError(f"{source}: segments[{i}]: a sharp turn stands between two straights; add one beside it")
    if not isinstance(segments[0], Straight) or not isinstance(segments[-1], Straight):
        raise WorldError(f"{source}: segments: a track begins and ends with a straight; add one")
    widths = [segment.width for segment in segments]
    for i, width in enumerate(widths):
        if width is None:
            sides = [w for w in (widths[i - 1], segments[i + 1].width) if w is not None]
            widths[i] = max(sides)
    return widths


def _corner_extent(segment: Straight | Turn, width: float) -> float:
    """Return how much of each neighbouring straight a sharp corner takes up."""
    if isinstance(segment, Straight) or segment.radius > 0:
        return 0.0
    return width / 2 * math.tan(abs(math.radians(segment.turn)) / 2)


def _ahead(pose: Pose2, distance: float, left: float = 0.0) -> Pose2:
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return Pose2(pose.x + c * distance - s * left, pose.y + s * distance + c * left, pose.yaw)


def _polygon(poses: Sequence[Pose2]) -> shapely.Polygon:
    return shapely.Polygon([(p.x, p.y) for p in poses])


def _strip(pose: Pose2, begin: float, end: float, width: float) -> shapely.Polygon | None:
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
    yaws = pose.yaw + np.linspace(0.0, turn, math.ceil(abs(turn) / _FACET_RAD) + 1)
    # Seen from the turning centre, the centre line lies on the right of a left turn and on the left of a right turn.
    rims = [
        [_ahead(Pose2(centre.x, centre.y, yaw), 0.0, -math.copysign(r, turn)) for yaw in yaws]
        for r in (radius - width / 2, radius, radius + width / 2)
    ]
    return _polygon(rims[0] + rims[2][::-1]), rims[1][1:]


def _check_apart(pieces: list[shapely.Polygon], owners: list[int], sharp: list[bool], source: str) -> None:
    """Refuse a track of which two parts that do not follow each other overlap or share a wall too thin to build."""
    shapes = np.array(pieces)
    first, second = np.triu_indices(len(shapes), k=2)
    # The two straights of a sharp corner meet in its inner corner point: they may touch, but not overlap.
    joined = (second - first == 2) & np.array(sharp)[first + 1]
    bad = np.zeros(len(first), dtype=bool)
    bad[joined] = shapely.area(shapely.intersection(shapes[first[joined]], shapes[second[joined]])) > 1e-6
    bad[~joined] = shapely.distance(shapes[first[~joined]], shapes[second[~joined]]) < _THINNEST_WALL_M
    if bad.any():
        i, j = owners[first[bad][0]], owners[second[bad][0]]
        raise WorldError(
            f"{source}: segments[{j}]: the track runs into its own segments[{i}], so their walls would cross; "
            "lengthen a straight between them or enlarge the radius of a turn"
        )
