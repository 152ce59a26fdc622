"""Hybrid A* (Dolgov et al. 2010): forward and reverse arcs over the car's exact outline, guided by the map.

A node is a true pose of the rear axle; nodes that share a cell of (x, y, yaw, direction) compete, and the cheapest
stays. What remains to the goal is estimated by Dijkstra's distance over the cells in which the rear axle can be.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import ConfigError, PlanError
from zebrat_bullet.planning.arc_path import ArcPath, axle_pose, clearances, sweep_factor
from zebrat_bullet.planning.arc_search import Field, Found, Goal, Moves, distances_to, search
from zebrat_bullet.planning.footprint_check import WallIndex, index_walls, outline_about_axle
from zebrat_bullet.planning.grid import OccupancyGrid, inscribed_radius_m
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Pose2

# A start nearer to a wall than the margin is left within this much driving.
_LEAVE_START_M = 2.0
# Margins below this are left to the finer search, and not taken only to save a reversal.
_TIGHT_M = 0.03
# A start that all but touches a wall is not worth an endless number of checks.
_LEAST_SPACING_M = 0.005
_PADDING_M = 3.0
# Cells further from the goal than the start by more than this are not looked at.
_DETOUR_M = 5.0


@dataclass(frozen=True, kw_only=True)
class HybridAStarConfig:
    """How finely the search looks, and what it dislikes; costs in metres of driving.

    Attributes:
        max_steering_rad: arcs are driven with at most this steering, `n_steering` angles evenly spaced.
        arc_m: length of an arc.
        cell_m, n_yaw: size of a cell, and into how many the full turn is divided.
        reverse_cost: of each metre driven backward, on top of its length.
        reversal_cost: of each change between forward and backward.
        steering_cost: of each radian of change in steering.
        margins_m: clearances tried in turn, the widest first.
        goal_radius_m: how near to the goal the lidar must come.
        max_nodes: the search for one margin gives up after so many.
    """

    max_steering_rad: float = 0.6
    n_steering: int = 7
    arc_m: float = 0.2
    cell_m: float = 0.1
    n_yaw: int = 72
    reverse_cost: float = 1.0
    reversal_cost: float = 1.0
    steering_cost: float = 0.1
    margins_m: tuple[float, ...] = (0.08, 0.05, 0.03, 0.01)
    goal_radius_m: float = 0.3
    max_nodes: int = 2_000_000

    def __post_init__(self) -> None:
        if not (self.arc_m > 0 and self.cell_m > 0 and self.n_yaw >= 8 and self.n_steering >= 3):
            raise ConfigError(
                f"a search needs arc_m and cell_m above 0, n_yaw of at least 8 and n_steering of at least 3, got {self}"
            )
        if not self.margins_m or min(self.margins_m) <= 0.0:
            raise ConfigError(f"margins_m must name at least one clearance above 0, got {self.margins_m}")

    def finer(self) -> "HybridAStarConfig":
        """Return settings that look twice as closely in every dimension."""
        return replace(
            self,
            arc_m=self.arc_m / 2.0,
            cell_m=self.cell_m / 2.0,
            n_yaw=2 * self.n_yaw,
            n_steering=2 * self.n_steering - 1,
        )


@dataclass(frozen=True)
class Plan:
    """A path that keeps a distance from every wall.

    Attributes:
        path: from the start to a pose whose lidar is at the goal.
        margin_m: that distance, but near a start that stands nearer. The widest of the margins tried for which there is
            a path; a narrower one of at least 3 cm is taken where it saves a reversal.
    """

    path: ArcPath
    margin_m: float


def plan_path(
    walls: shapely.MultiPolygon,
    robot: RobotModel,
    start: Pose2,
    goal_world: NDArray[np.float64],
    config: HybridAStarConfig | None = None,
) -> Plan:
    """Find a short drive with few reversals that brings the lidar to a goal.

    Args:
        walls: all that the body can hit, world frame.
        robot: the car.
        start: its base frame.
        goal_world: (2,) m.
        config: the search; its defaults if None.

    Raises:
        PlanError: the car touches a wall where it starts, or neither the search nor a finer one found any drive with
            the least margin.
    """
    config = config or HybridAStarConfig()
    axle = axle_pose(start, robot)
    start_clearance = float(clearances(axle[None], robot, walls)[0])
    if start_clearance == 0.0:
        raise PlanError(f"the car touches a wall where it starts, at ({start.x:.2f}, {start.y:.2f}); move it")
    room = _Room(walls, index_walls(walls, robot, max(config.margins_m)), robot, axle, start_clearance, goal_world)
    wide = [margin for margin in config.margins_m if margin >= _TIGHT_M]
    best = _widest(room, config, wide)
    if best is not None:
        return best
    # What the least margin does not find, wider ones hardly ever do, and a search in vain is the longest.
    least = min(config.margins_m)
    found = _search(room, config.finer(), least)
    if found.last < 0:
        raise PlanError(
            f"found no drive from ({start.x:.2f}, {start.y:.2f}) to ({goal_world[0]:.2f}, {goal_world[1]:.2f}) that "
            f"keeps {least} m from the walls; widen the passage or allow a smaller margin"
        )
    return _widest(room, config.finer(), config.margins_m) or Plan(_path(found), least)


@dataclass(frozen=True)
class _Room:
    """What all searches of one plan have in common; `axle` is where the rear axle starts."""

    walls: shapely.MultiPolygon
    index: WallIndex
    robot: RobotModel
    axle: NDArray[np.float64]
    start_clearance_m: float
    goal_world: NDArray[np.float64]


def _widest(room: _Room, config: HybridAStarConfig, margins_m: Sequence[float]) -> Plan | None:
    """Return the plan that `Plan.margin_m` describes, None where no margin has one."""
    best: Plan | None = None
    for margin in margins_m:
        if best is not None and (best.path.n_reversals == 0 or margin < _TIGHT_M):
            break
        found = _search(room, config, margin)
        if found.last >= 0 and (best is None or _path(found).n_reversals < best.path.n_reversals):
            best = Plan(_path(found), margin)
    return best


def _search(room: _Room, config: HybridAStarConfig, margin_m: float) -> Found:
    robot, goal_world = room.robot, room.goal_world
    lidar = robot.lidar_xyz_base[:2] - (robot.rear_axle_x_m, 0.0)
    goal = Goal(float(goal_world[0]), float(goal_world[1]), config.goal_radius_m, float(lidar[0]), float(lidar[1]))
    # The corner of an enlarged outline stands out by more than the margin: 0.7 keeps it off the walls.
    leaving_m = min(margin_m, 0.7 * room.start_clearance_m)
    steering = np.linspace(-config.max_steering_rad, config.max_steering_rad, config.n_steering)
    curvatures = np.tan(steering) / robot.wheelbase_m
    # Between two checks no point of the footprint moves further than the margin from both.
    spacing = 2.0 * max(leaving_m, _LEAST_SPACING_M) / sweep_factor(robot, curvatures[-1])
    n_checks = math.ceil(config.arc_m / spacing)
    costs = config.reverse_cost, config.reversal_cost, config.steering_cost
    return search(
        room.axle,
        goal,
        _field(room, config),
        config.n_yaw,
        Moves(steering, curvatures, config.arc_m, n_checks, *costs),
        room.index,
        outline_about_axle(robot, margin_m),
        outline_about_axle(robot, leaving_m),
        _LEAVE_START_M,
        config.max_nodes,
    )


def _field(room: _Room, config: HybridAStarConfig) -> Field:
    """Return every cell's distance to the goal, and which cells are worth a visit."""
    grid = OccupancyGrid.of_walls(room.walls, config.cell_m, _PADDING_M, [room.axle[:2], room.goal_world])
    # From centre to centre of two cells, while axle and wall may each be half a diagonal nearer.
    held = inscribed_radius_m(room.robot.footprint_base, (room.robot.rear_axle_x_m, 0.0))
    nearest = held - math.sqrt(2.0) * config.cell_m
    free = ~grid.occupied & (grid.distance_m > nearest)
    row, column = grid.cells_of(room.goal_world)
    to_goal = distances_to(free, row, column, config.cell_m)
    here = to_goal[tuple(grid.cells_of(room.axle[:2]))]
    worth = to_goal <= here + _DETOUR_M if math.isfinite(here) else np.isfinite(to_goal)
    ids = np.where(worth, np.cumsum(worth).reshape(worth.shape) - 1, -1)
    x, y = grid.origin_world.tolist()
    return Field(to_goal, ids, x, y, config.cell_m)


def _path(found: Found) -> ArcPath:
    """Trace the path back from the goal; arcs of one steering and direction become one, up to a quarter turn."""
    nodes = [found.last]
    while found.parents[nodes[-1]] >= 0:
        nodes.append(int(found.parents[nodes[-1]]))
    nodes.reverse()
    kept = nodes[:1]
    for node, after in pairwise(nodes[1:]):
        same = found.moves[node] == found.moves[after] and found.directions[node] == found.directions[after]
        if not same or abs(found.poses[after, 2] - found.poses[kept[-1], 2]) > math.pi / 2.0:
            kept.append(node)
    kept += nodes[1:][-1:]
    return ArcPath(found.poses[kept], found.directions[kept[1:]])
