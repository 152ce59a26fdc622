"""The obstacles that a car knows from its own lidar: a window that rolls with it, as move_base's local costmap.

costmap_2d's obstacle layer with the defaults of ROS noetic: every scan first frees the cells along its rays, then marks
those of its returns, and at last frees the cells under the car. What no ray passes stays as it was. A bearing without a
return says nothing (`inf_is_valid` false), and what was never seen counts as free (`track_unknown_space` false).
"""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.geometry import rotation_2d, to_world
from zebrat_bullet.planning.compiled import compiled
from zebrat_bullet.planning.grid import OccupancyGrid
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import FlatScan, Pose2

COSTMAPS = ("map", "live")
"""What a local planner's obstacles come from: the premade map, or the scans of the drive itself."""

OBSTACLE_RANGE_M, RAYTRACE_RANGE_M = 2.5, 3.0
"""Returns farther than the first are not marked; rays free no cell beyond the second."""


def check_costmap(name: str) -> None:
    """Refuse a name that is none of `COSTMAPS`.

    Raises:
        ConfigError: it is none.
    """
    if name not in COSTMAPS:
        raise ConfigError(f"costmap must be one of {', '.join(COSTMAPS)}, got {name!r}")


class LocalCostmap:
    """Cells about the car in the world frame, as far as the car knows where it is in it.

    Args:
        robot: the car; its outline, and where its lidar stands.
        resolution_m: edge of a cell; cell edges lie on whole multiples of it.
        window_m: edge of the square window.
    """

    def __init__(self, robot: RobotModel, resolution_m: float = 0.05, window_m: float = 6.0) -> None:
        self._resolution_m = resolution_m
        self._half = round(window_m / 2.0 / resolution_m)
        self._lidar_base = robot.lidar_xyz_base[:2]
        self._outline = shapely.Polygon(robot.footprint_base)
        shapely.prepare(self._outline)
        self.forget()

    def forget(self) -> None:
        """Forget all that was seen."""
        self._grid: OccupancyGrid | None = None

    def see(self, scan: FlatScan, pose: Pose2) -> OccupancyGrid:
        """Take in a scan and return the window about the car.

        Args:
            scan: about the lidar.
            pose: of the base frame in the world, where the car believes to be. An error in it moves all that this scan
                shows together with the car; only what is left of earlier scans stays where it was.
        """
        grid = self._grid = self._rolled_to(pose)
        (origin,) = to_world(self._lidar_base[None], pose)
        bearings = pose.yaw - math.pi + np.arange(len(scan.ranges_m)) * (2.0 * math.pi / len(scan.ranges_m))
        seen = scan.ranges_m < scan.range_max_m  # nan, which was not cast, is not
        directions = np.stack([np.cos(bearings[seen]), np.sin(bearings[seen])], axis=1)
        start = (origin - grid.origin_world) / self._resolution_m
        _free_and_mark(grid.occupied, start, directions, scan.ranges_m[seen].astype(float), self._resolution_m)
        self._free_under(grid, pose)
        return grid

    def _rolled_to(self, pose: Pose2) -> OccupancyGrid:
        """Return the window moved by whole cells so that the car is in its middle; what enters it is free."""
        n = 2 * self._half + 1
        corner = np.floor(np.array([pose.x, pose.y]) / self._resolution_m) - self._half
        occupied = np.zeros((n, n), dtype=bool)
        if self._grid is not None:
            right, up = (corner - np.rint(self._grid.origin_world / self._resolution_m)).astype(int).tolist()
            if max(abs(right), abs(up)) < n:
                kept = self._grid.occupied[max(up, 0) : n + min(up, 0), max(right, 0) : n + min(right, 0)]
                occupied[max(-up, 0) : n - max(up, 0), max(-right, 0) : n - max(right, 0)] = kept
        return OccupancyGrid(occupied, self._resolution_m, corner * self._resolution_m)

    def _free_under(self, grid: OccupancyGrid, pose: Pose2) -> None:
        """Free the cells whose centres the car stands on: it could not stand on an obstacle."""
        marked = np.argwhere(grid.occupied)
        centres_base = (grid.centres_of(marked) - (pose.x, pose.y)) @ rotation_2d(pose.yaw)
        under = shapely.contains_xy(self._outline, *centres_base.T)
        grid.occupied[tuple(marked[under].T)] = False


@compiled
def _free_and_mark(
    occupied: NDArray[np.bool_],
    start: NDArray[np.float64],
    directions: NDArray[np.float64],
    ranges_m: NDArray[np.float64],
    resolution_m: float,
) -> None:
    """Free the cells along all rays, then mark those of their ends, in place.

    Args:
        occupied: (H, W) bool.
        start: (2,) where the rays begin, in cells from the corner of cell (0, 0), x first.
        directions: (K, 2) unit vectors.
        ranges_m: (K,) lengths.
        resolution_m: edge of a cell.
    """
    n_rows, n_cols = occupied.shape
    for marking in (False, True):
        for k in range(len(ranges_m)):
            if marking and ranges_m[k] >= OBSTACLE_RANGE_M:
                continue
            end = (ranges_m[k] if marking else min(ranges_m[k], RAYTRACE_RANGE_M)) / resolution_m
            at = end if marking else 0.0
            while at <= end:
                col = math.floor(start[0] + at * directions[k, 0])
                row = math.floor(start[1] + at * directions[k, 1])
                if 0 <= row < n_rows and 0 <= col < n_cols:
                    occupied[row, col] = marking
                at += 0.5
