"""Does the car's outline touch a wall? Exact on the wall segments, and fast enough to ask a million times."""

from typing import NamedTuple

import numba
import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.robot import RobotModel

_BUCKET_M = 0.25


class WallIndex(NamedTuple):
    """The wall segments, and for every bucket of a square grid those that a car centred in it may touch.

    Attributes:
        segments: (S, 4) float64, x and y of both ends in m, world frame.
        first: (ny * nx + 1,) int64, where each bucket's entries begin in `entries`.
        entries: segment numbers, bucket after bucket.
        x, y: lower corner of the grid in m; nx, ny: its buckets.
    """

    segments: NDArray[np.float64]
    first: NDArray[np.int64]
    entries: NDArray[np.int64]
    x: float
    y: float
    nx: int
    ny: int


class Outline(NamedTuple):
    """A convex outline about the rear axle: the points p with `normals @ p <= offsets`.

    Attributes:
        normals: (K, 2) float64, unit, outward.
        offsets: (K,) float64, m.
        centre_x, centre_y: a point in its middle.
    """

    normals: NDArray[np.float64]
    offsets: NDArray[np.float64]
    centre_x: float
    centre_y: float


def outline_about_axle(robot: RobotModel, margin_m: float = 0.0) -> Outline:
    """Return the robot's footprint with every side moved outwards, so no point of it is nearer than the margin."""
    corners = robot.footprint_base - (robot.rear_axle_x_m, 0.0)
    sides = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.hypot(*sides.T)[:, None]
    centre = corners.mean(axis=0)
    offsets = np.einsum("kd,kd->k", normals, corners) + margin_m
    return Outline(normals, offsets, float(centre[0]), float(centre[1]))


def index_walls(walls: shapely.MultiPolygon, robot: RobotModel, margin_m: float) -> WallIndex:
    """Sort the segments of the wall outlines into buckets, for footprints enlarged by at most `margin_m`."""
    segments = _segments(walls)
    corners = robot.footprint_base - robot.footprint_base.mean(axis=0)
    # The enlarged outline has sharp corners, which stand out by more than the margin.
    reach = float(np.hypot(*corners.T).max()) + 2.0 * margin_m + _BUCKET_M
    x, y, x_end, y_end = (0.0, 0.0, 0.0, 0.0) if walls.is_empty else walls.buffer(reach).bounds
    nx, ny = int((x_end - x) / _BUCKET_M) + 1, int((y_end - y) / _BUCKET_M) + 1
    column, row = np.meshgrid(np.arange(nx), np.arange(ny))
    centres = shapely.points(x + (column.ravel() + 0.5) * _BUCKET_M, y + (row.ravel() + 0.5) * _BUCKET_M)
    tree = shapely.STRtree(shapely.linestrings(segments.reshape(-1, 2, 2)))
    bucket, entries = tree.query(centres, predicate="dwithin", distance=reach)
    order = np.argsort(bucket, kind="stable")
    first = np.searchsorted(bucket[order], np.arange(nx * ny + 1))
    return WallIndex(segments, first.astype(np.int64), entries[order].astype(np.int64), x, y, nx, ny)


@numba.njit(cache=True)
def touches(walls: WallIndex, outline: Outline, x: float, y: float, yaw: float) -> bool:
    """Return whether the outline of a car with its rear axle at this pose meets a wall segment."""
    c, s = np.cos(yaw), np.sin(yaw)
    column = int(np.floor((x + c * outline.centre_x - s * outline.centre_y - walls.x) / _BUCKET_M))
    row = int(np.floor((y + s * outline.centre_x + c * outline.centre_y - walls.y) / _BUCKET_M))
    if not (0 <= column < walls.nx and 0 <= row < walls.ny):
        return False
    bucket = row * walls.nx + column
    for i in range(walls.first[bucket], walls.first[bucket + 1]):
        if _cuts(walls.segments[walls.entries[i]], outline, x, y, c, s):
            return True
    return False


@numba.njit(cache=True)
def _cuts(segment: NDArray[np.float64], outline: Outline, x: float, y: float, c: float, s: float) -> bool:
    """Clip a segment by the outline's half-planes (Cyrus and Beck): it cuts the outline where something is left."""
    ax, ay = segment[0] - x, segment[1] - y
    dx, dy = segment[2] - segment[0], segment[3] - segment[1]
    begin, end = 0.0, 1.0
    for k in range(len(outline.offsets)):
        nx = c * outline.normals[k, 0] - s * outline.normals[k, 1]
        ny = s * outline.normals[k, 0] + c * outline.normals[k, 1]
        outside = nx * ax + ny * ay - outline.offsets[k]
        slope = nx * dx + ny * dy
        if slope == 0.0:
            if outside > 0.0:
                return False
        elif slope < 0.0:
            begin = max(begin, -outside / slope)
        else:
            end = min(end, -outside / slope)
        if begin > end:
            return False
    return True


def _segments(walls: shapely.MultiPolygon) -> NDArray[np.float64]:
    """Return the (S, 4) edges of all rings."""
    rings = shapely.get_rings(shapely.get_parts(walls))
    lines = [np.hstack([points[:-1], points[1:]]) for points in map(shapely.get_coordinates, rings)]
    return np.concatenate([np.empty((0, 4)), *lines])
