"""Occupancy grids of the walls, the costs ROS gives their cells, and ROS map_server files."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import shapely
import yaml
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.ndimage import distance_transform_edt

LETHAL, INSCRIBED = 254, 253
"""Costs of a cell that a wall stands in, and of one so near to a wall that a car centred there must touch it."""

# A wall that reaches into a cell by less than this part of it leaves it free: walls along cell edges fill one side.
_HAIR_CELLS = 0.02


@dataclass(frozen=True)
class OccupancyGrid:
    """Square cells of the floor: does a wall stand in them?

    Attributes:
        occupied: (H, W) bool, row 0 lowest in y, column 0 lowest in x.
        resolution_m: edge of a cell.
        origin_world: (2,) float64, m, lower left corner of cell (0, 0).
    """

    occupied: NDArray[np.bool_]
    resolution_m: float
    origin_world: NDArray[np.float64]

    @classmethod
    def of_walls(
        cls,
        walls: shapely.MultiPolygon,
        resolution_m: float = 0.05,
        padding_m: float = 1.0,
        also_inside: ArrayLike = (),
    ) -> "OccupancyGrid":
        """Return the grid round the walls; a cell that a wall reaches into is occupied.

        Args:
            walls: outlines, m, world frame.
            resolution_m: edge of a cell; cell edges lie on whole multiples of it.
            padding_m: free cells round the walls and the points of `also_inside`.
            also_inside: (K, 2) points in m, world frame, that the grid must hold too, such as start and goal.
        """
        corners = np.vstack([np.reshape(walls.bounds, (2, 2)), np.reshape(also_inside, (-1, 2))])
        low = np.floor((np.nanmin(corners, axis=0) - padding_m) / resolution_m + _HAIR_CELLS)
        high = np.ceil((np.nanmax(corners, axis=0) + padding_m) / resolution_m - _HAIR_CELLS)
        n_cols, n_rows = (high - low).astype(int)
        shapely.prepare(walls)
        x = (low[0] + np.arange(n_cols)) * resolution_m
        y = (low[1] + np.arange(n_rows))[:, None] * resolution_m
        hair, edge = _HAIR_CELLS * resolution_m, (1.0 - _HAIR_CELLS) * resolution_m
        occupied = shapely.intersects(walls, shapely.box(x + hair, y + hair, x + edge, y + edge))
        return cls(occupied, resolution_m, low * resolution_m)

    @cached_property
    def distance_m(self) -> NDArray[np.float64]:
        """(H, W) float64, m from each cell's centre to the centre of the nearest occupied cell; inf without walls."""
        if not self.occupied.any():
            return np.full(self.occupied.shape, np.inf)
        return distance_transform_edt(~self.occupied, sampling=self.resolution_m)

    def cells_of(self, points_world: ArrayLike) -> NDArray[np.intp]:
        """Return the (..., 2) row and column of the cells that (..., 2) points in m lie in, also outside the grid."""
        cells = np.floor((np.asarray(points_world) - self.origin_world) / self.resolution_m)
        return cells[..., ::-1].astype(np.intp)

    def centres_of(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 2) centres in m, world frame, of (..., 2) cells given as row and column."""
        return self.origin_world + (np.asarray(cells)[..., ::-1] + 0.5) * self.resolution_m

    def contains(self, cells: ArrayLike) -> NDArray[np.bool_]:
        """Return which of (..., 2) cells lie in the grid."""
        inside = (np.asarray(cells) >= 0) & (np.asarray(cells) < self.occupied.shape)
        return np.asarray(inside.all(axis=-1))


def inscribed_radius_m(outline: NDArray[np.float64], about: ArrayLike = (0.0, 0.0)) -> float:
    """Return the radius in m of the largest disc about a (2,) point that a (K, 2) outline holds; 0 outside it."""
    inside, point = shapely.Polygon(outline), shapely.Point(about)
    return float(inside.exterior.distance(point)) if inside.contains(point) else 0.0


def inflate(
    grid: OccupancyGrid, inflation_radius_m: float, inscribed_radius_m: float, cost_scaling_factor: float = 10.0
) -> NDArray[np.uint8]:
    """Return the (H, W) cell costs of ROS's inflation layer.

    254 in a wall, 253 within the inscribed radius of one, then 252 exp(-cost_scaling_factor (d - inscribed radius)) up
    to the inflation radius, and 0 beyond. A smaller inflation radius than the inscribed one cuts off the 253, as there.
    """
    distance = grid.distance_m - 1e-9  # a whole number of cells may come out a rounding error too far
    decay = (INSCRIBED - 1) * np.exp(-cost_scaling_factor * np.maximum(distance - inscribed_radius_m, 0.0))
    costs = np.where(distance <= inscribed_radius_m, INSCRIBED, decay)
    costs[distance > inflation_radius_m] = 0
    costs[grid.occupied] = LETHAL
    return costs.astype(np.uint8)


def write_ros_map(grid: OccupancyGrid, path: Path) -> Path:
    """Write a ROS map_server map as `path` + .yaml and `path` + .pgm, and return the former; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image, text = path.with_name(f"{path.name}.pgm"), path.with_name(f"{path.name}.yaml")
    Image.fromarray(np.where(np.flipud(grid.occupied), 0, 254).astype(np.uint8)).save(image)
    fields = {
        "image": image.name,
        "resolution": grid.resolution_m,
        "origin": [*grid.origin_world.tolist(), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    text.write_text(yaml.safe_dump(fields, sort_keys=False), encoding="utf-8")
    return text
