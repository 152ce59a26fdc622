"""Proof that no drive leads out of a world, however often the car would reverse."""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.planning.arc_search import flood
from zebrat_bullet.planning.footprint_check import index_walls, outline_of
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.world import World

# Edge of a cell in m and cells of the full turn, the coarsest first: what it proves, it proves at once.
_LEVELS = ((0.05, 90), (0.025, 180), (0.0125, 360))
# Cells looked at before giving up, about a microsecond each.
_MOST_CELLS = 1_500_000
_PADDING_M = 1.0
_ROUNDING_M = 1e-6


def proves_no_way(world: World, robot: RobotModel) -> bool:
    """Return whether it is shown that no drive from the middle of the start range brings the lidar past the open line.

    The poses (x, y, yaw) of the footprint's middle are divided into cells. Between a cell's middle pose and any other
    of its poses no point of the footprint moves further than delta = edge / sqrt(2) + reach * turn / 2. A footprint
    shrunk by delta therefore lies, at the middle pose, inside the true one at every pose of the cell: where the shrunk
    one meets a wall, no pose of the cell is free. A drive is a continuous motion through free poses, so it leads
    through cells that share faces and are not ruled out. Where these do not join the start with any cell from which the
    lidar may be outside, there is no drive. That the car cannot move sideways is not used: to and fro, it can follow
    every motion for which there is room to spare, so finer cells leave little to prove.

    A False proves nothing.
    """
    if world.open_line is None:
        return False
    walls = index_walls(world.walls, robot)
    middle = robot.footprint_base.mean(axis=0)
    footprint = shapely.Polygon(robot.footprint_base - middle)
    reach = float(np.hypot(*(robot.footprint_base - middle).T).max())
    lidar = robot.lidar_xyz_base[:2] - middle
    pose = world.start.pose
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    start = pose.x + c * middle[0] - s * middle[1], pose.y + s * middle[0] + c * middle[1], pose.yaw
    bounds = np.array(world.walls.union(shapely.Point(start[:2])).bounds).reshape(2, 2)
    low, high = bounds[0] - _PADDING_M, bounds[1] + _PADDING_M
    for cell, n_yaw in _LEVELS:
        delta = cell / math.sqrt(2.0) + max(reach, float(np.hypot(*lidar))) * math.pi / n_yaw + _ROUNDING_M
        shrunk = footprint.buffer(-delta, join_style="mitre")
        if shrunk.is_empty:
            continue
        corners = shapely.get_coordinates(shapely.orient_polygons(shrunk))[:-1]
        n_columns, n_rows = np.ceil((high - low) / cell).astype(int).tolist()
        corner = float(low[0]), float(low[1])
        # A lidar is looked up in the grid, half a diagonal away, for a pose up to delta away.
        out = _outside(world, corner, (n_rows, n_columns), cell, delta + cell)
        shape, seen_from = (n_rows, n_columns, n_yaw), (float(lidar[0]), float(lidar[1]))
        joined = flood(start, corner, shape, cell, walls, outline_of(corners), out, seen_from, _MOST_CELLS)
        if joined == 0:
            return True
        if joined < 0:
            return False
    return False


def _outside(
    world: World, corner: tuple[float, float], shape: tuple[int, int], cell: float, slack_m: float
) -> NDArray[np.bool_]:
    """Return the (H, W) bool cells whose middle is past the open-space line, or might be within `slack_m` of it."""
    assert world.open_line is not None
    x = corner[0] + (np.arange(shape[1]) + 0.5) * cell
    y = corner[1] + (np.arange(shape[0])[:, None] + 0.5) * cell
    (ax, ay), (bx, by) = world.open_line
    past = (bx - ax) * (y - ay) - (by - ay) * (x - ax) < slack_m * math.hypot(bx - ax, by - ay)
    inside = world.free_space.buffer(-slack_m)
    shapely.prepare(inside)
    return np.asarray(past & ~shapely.contains_xy(inside, *np.broadcast_arrays(x, y)))
