"""Many worlds packed into flat arrays: outlines as segments, and for every cell of a grid which of them matter there.

A cell's list is conservative: for any point of the cell it holds every segment that a car or a ray from there can meet,
so that what is left out changes no number. This is the broad phase of contact and ray cast alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import WorldError
from zebrat_bullet.geometry import wall_segments
from zebrat_bullet.world.world import World

CELL_M = 0.5
_SHORTEST_M = 1e-6
_AT_ONCE = 5_000_000


@dataclass(frozen=True)
class Atlas:
    """W worlds as arrays. Segments keep the solid on their right, so that a free point sees them run to its left.

    Attributes:
        origin: (W, 2) float64, m, world frame; every other position of a world is relative to its origin, which keeps
            float32 exact to a micrometre wherever a map has its zero.
        segments: (S, 4) float32, m: ax, ay, bx, by of the outlines of all worlds, one after the other.
        grid: (W, 4) float32: x and y of the grid's corner in m, its number of columns and of rows.
        first_cell: (W,) int32, index of each world's first cell; its cells are row-major.
        cells: (C + 1, 2) int32: where in `near_far` the list of each cell begins, and how many of it are near. The list
            of a cell ends where the next begins.
        near_far: (L,) int32, segment indices: those a car with its middle in the cell can touch within a control step,
            then the others whose front a ray from the cell can meet.
        all_first, all_last: (W,) int32, range of the segments of each world, for points outside of its grid.
    """

    origin: NDArray[np.float64]
    segments: NDArray[np.float32]
    grid: NDArray[np.float32]
    first_cell: NDArray[np.int32]
    cells: NDArray[np.int32]
    near_far: NDArray[np.int32]
    all_first: NDArray[np.int32]
    all_last: NDArray[np.int32]


@dataclass(frozen=True)
class Chart:
    """One world of an atlas, not yet joined to others; the fields are those of `Atlas`."""

    origin: NDArray[np.float64]
    segments: NDArray[np.float32]
    grid: NDArray[np.float32]
    lengths: NDArray[np.int32]
    n_near: NDArray[np.int32]
    near_far: NDArray[np.int32]


def chart(world: World, near_m: float, reach_m: float) -> Chart:
    """Lay a grid over a world.

    Args:
        world: its walls.
        near_m: how far from the middle of a car a wall can be that it touches within a control step.
        reach_m: of the lidar.

    Raises:
        WorldError: the world has no walls.
    """
    ends = wall_segments(shapely.orient_polygons(world.walls))
    ends = ends[np.abs(ends[:, 1] - ends[:, 0]).max(axis=1) > _SHORTEST_M]
    if not len(ends):
        raise WorldError(f"{world.name}: has no walls, so there is nothing to sense; give it some")
    low, high = ends.reshape(-1, 2).min(axis=0), ends.reshape(-1, 2).max(axis=0)
    origin = (low + high) / 2
    ends = ends - origin
    a, b = np.moveaxis(ends[(ends[:, 0] != ends[:, 1]).any(axis=1)], 1, 0)  # an outline may name a corner twice
    n_columns, n_rows = np.maximum(np.ceil((high - low) / CELL_M).astype(int), 1)
    corner = -0.5 * CELL_M * np.array([n_columns, n_rows])
    columns, rows = np.meshgrid(np.arange(n_columns), np.arange(n_rows))
    middle = corner + CELL_M * (np.stack([columns, rows], axis=-1).reshape(-1, 2) + 0.5)
    # Cells by segments are too many to hold at once in a world of many corners.
    step = _AT_ONCE // len(a) + 1
    parts = [_lists(middle[i : i + step], a, b, near_m, reach_m) for i in range(0, len(middle), step)]
    lengths, n_near, near_far = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Chart(
        origin=origin,
        segments=np.hstack([b, a]).astype(np.float32),
        grid=np.array([*corner, n_columns, n_rows], dtype=np.float32),
        lengths=lengths.astype(np.int32),
        n_near=n_near.astype(np.int32),
        near_far=near_far.astype(np.int32),
    )


def _lists(
    middle: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64], near_m: float, reach_m: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return the lengths of the lists of (C, 2) cells, how many in each are near, and the lists, one after another."""
    half_diagonal = CELL_M * np.sqrt(0.5) + 1e-3
    distance = _distance(middle, a, b)
    normal = np.stack([(b - a)[:, 1], (a - b)[:, 0]], axis=1)
    normal /= np.hypot(*normal.T)[:, None]
    # The outlines of solids run counter-clockwise, so their normals point out, at who can see them.
    height = middle @ normal.T - (a * normal).sum(axis=1)
    near = distance <= near_m + half_diagonal
    far = (distance <= reach_m + half_diagonal) & (height > -half_diagonal) & ~near
    order = np.where(near, 0, np.where(far, 1, 2))
    by_rank = np.argsort(order, axis=1, kind="stable")
    lengths = (near | far).sum(axis=1)
    kept = np.arange(len(a)) < lengths[:, None]
    return lengths, near.sum(axis=1), by_rank[kept]


def bind(charts: Sequence[Chart]) -> Atlas:
    """Join the charts of worlds to an atlas."""
    n_segments = np.array([len(chart.segments) for chart in charts])
    n_cells = np.array([len(chart.lengths) for chart in charts])
    ends = np.cumsum(n_segments)
    lengths = np.concatenate([chart.lengths for chart in charts])
    cells = np.zeros((len(lengths) + 1, 2), dtype=np.int32)
    cells[1:, 0] = np.cumsum(lengths)
    cells[:-1, 1] = np.concatenate([chart.n_near for chart in charts])
    begins = ends - n_segments
    return Atlas(
        origin=np.stack([chart.origin for chart in charts]),
        segments=np.concatenate([chart.segments for chart in charts]),
        grid=np.stack([chart.grid for chart in charts]),
        first_cell=(np.cumsum(n_cells) - n_cells).astype(np.int32),
        cells=cells,
        near_far=np.concatenate([c.near_far + np.int32(begin) for c, begin in zip(charts, begins, strict=True)]),
        all_first=begins.astype(np.int32),
        all_last=ends.astype(np.int32),
    )


def _distance(points: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (P, S) distances in m of (P, 2) points to the segments between (S, 2) ends."""
    along = b - a
    part = ((points[:, None] - a) * along).sum(axis=-1) / (along * along).sum(axis=-1)
    foot = a + np.clip(part, 0.0, 1.0)[..., None] * along
    return np.hypot(*np.moveaxis(points[:, None] - foot, -1, 0))
