"""Walls and outline, laid out so that the compiled search can ask a million times whether one touches the other."""

import math
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.geometry import wall_segments
from zebrat_bullet.robot import RobotModel

_BUCKET_M = 0.25
# Gaps are measured up to here; further off no search cares.
_REACH_M = 0.15


class WallIndex(NamedTuple):
    """The wall segments, and for every bucket of a square grid those that a car centred in it may touch.

    Attributes:
        segments: (S, 4) float64, x and y of both ends in m, world frame.
        first: (ny * nx + 1,) int64, where each bucket's entries begin in `entries`.
        entries: segment numbers, bucket after bucket.
        x, y: lower corner of the grid in m; nx, ny: its buckets; bucket_m: edge of one.
        reach_m: every segment nearer than this to a car centred in a bucket is among the bucket's entries.
    """

    segments: NDArray[np.float64]
    first: NDArray[np.int64]
    entries: NDArray[np.int64]
    x: float
    y: float
    nx: int
    ny: int
    bucket_m: float
    reach_m: float


class Outline(NamedTuple):
    """A convex outline: the points p with `normals @ p <= offsets`.

    Attributes:
        normals: (K, 2) float64, unit, outward.
        offsets: (K,) float64, m.
        corners: (K, 2) float64, m.
        centre_x, centre_y: a point in its middle.
    """

    normals: NDArray[np.float64]
    offsets: NDArray[np.float64]
    corners: NDArray[np.float64]
    centre_x: float
    centre_y: float


def outline_of(corners: NDArray[np.float64]) -> Outline:
    """Return the convex outline with (K, 2) corners in m, counter-clockwise."""
    sides = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.hypot(*sides.T)[:, None]
    centre = corners.mean(axis=0)
    offsets = np.einsum("kd,kd->k", normals, corners)
    return Outline(normals, offsets, np.ascontiguousarray(corners), float(centre[0]), float(centre[1]))


def index_walls(walls: shapely.MultiPolygon, robot: RobotModel) -> WallIndex:
    """Sort the segments of the wall outlines into buckets."""
    segments = wall_segments(walls)
    corners = robot.footprint_base - robot.footprint_base.mean(axis=0)
    reach = float(np.hypot(*corners.T).max()) + _REACH_M + _BUCKET_M / math.sqrt(2.0)
    x, y, x_end, y_end = (0.0, 0.0, 0.0, 0.0) if walls.is_empty else walls.buffer(reach).bounds
    nx, ny = int((x_end - x) / _BUCKET_M) + 1, int((y_end - y) / _BUCKET_M) + 1
    column, row = np.meshgrid(np.arange(nx), np.arange(ny))
    centres = shapely.points(x + (column.ravel() + 0.5) * _BUCKET_M, y + (row.ravel() + 0.5) * _BUCKET_M)
    tree = shapely.STRtree(shapely.linestrings(segments))
    bucket, entries = tree.query(centres, predicate="dwithin", distance=reach)
    order = np.argsort(bucket, kind="stable")
    first = np.searchsorted(bucket[order], np.arange(nx * ny + 1)).astype(np.int64)
    entries = entries[order].astype(np.int64)
    return WallIndex(segments.reshape(-1, 4), first, entries, x, y, nx, ny, _BUCKET_M, _REACH_M)
