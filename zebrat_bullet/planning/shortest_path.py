"""The length of the shortest way for a disc among walls: no car whose outline holds the disc can do with less."""

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

# Lines of sight may reach so far into the grown walls: along a wall's edge they would else depend on rounding.
_HAIR_M = 1e-3


def shortest_length_m(
    walls: shapely.MultiPolygon, start_xy: NDArray[np.float64], line: NDArray[np.float64], radius_m: float
) -> float:
    """Return a lower bound, tight within millimetres a corner, for the way of a disc from a point to a line.

    The shortest way of the disc's centre is a chain of straights between the convex corners of the walls grown by the
    radius. Their rounded corners are replaced by chords, which can only shorten the way.

    Args:
        walls: what the disc must not enter.
        start_xy: (2,) m, world frame, its centre.
        line: (2, 2) m, end points.
        radius_m: of the disc.

    Returns:
        Metres; inf where no way is wide enough.
    """
    grown = walls.buffer(radius_m, quad_segs=4)
    seen_through = walls.buffer(radius_m - _HAIR_M, quad_segs=4)
    shapely.prepare(seen_through)
    corners, before, after = _convex_corners(grown)
    points = np.vstack([start_xy, corners])
    i, j = np.triu_indices(len(points), k=1)
    taut = _touches_only(points, before, after, i, j) & _touches_only(points, before, after, j, i)
    i, j = i[taut], j[taut]
    sights = shapely.linestrings(np.stack([points[i], points[j]], axis=1))
    open_ = ~shapely.intersects(seen_through, sights)
    lengths = sparse.coo_matrix((shapely.length(sights[open_]), (i[open_], j[open_])), shape=(len(points), len(points)))
    to_corner = csgraph.dijkstra(lengths.tocsr(), directed=False, indices=0)
    # Not a hair more of the line: of the straight to a point inside a grown wall, another wall may be in the way.
    target = shapely.LineString(line).difference(grown)
    if target.is_empty:
        return np.inf
    shortest = np.inf
    for part in shapely.get_parts(target):  # each for itself: a way may end on one that is not the nearest
        last = shapely.shortest_line(shapely.points(points), part)
        visible = ~shapely.crosses(seen_through, last)
        shortest = float(np.min(to_corner + shapely.length(last), where=visible, initial=shortest))
    return shortest


def _convex_corners(shape: shapely.Geometry) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the (C, 2) vertices at which the outlines bulge outwards, and the (C, 2) sides before and after each."""
    corners = [np.empty((3, 0, 2))]
    for ring in shapely.get_rings(shapely.orient_polygons(shapely.get_parts(shape))):
        points = shapely.get_coordinates(ring)[:-1]
        before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
        convex = _cross(before, after) > 0.0
        corners.append(np.stack([points[convex], before[convex], after[convex]]))
    points, before, after = np.concatenate(corners, axis=1)
    return points, before, after


def _touches_only(
    points: NDArray[np.float64],
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    here: NDArray[np.intp],
    there: NDArray[np.intp],
) -> NDArray[np.bool_]:
    """Return which (P,) straights from corner `here`, prolonged, do not enter its wall: only these a taut string uses.

    The start, point 0, has no wall.
    """
    sight, at = points[there] - points[here], np.maximum(here, 1) - 1
    hair = _HAIR_M * np.hypot(*sight.T)
    # A line supports a convex corner where both of its sides turn to the same side of the line.
    left = (_cross(before[at], sight) >= -hair) & (_cross(after[at], sight) <= hair)
    right = (_cross(before[at], sight) <= hair) & (_cross(after[at], sight) >= -hair)
    return (here == 0) | left | right


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
