"""Hybrid A* (Dolgov et al. 2010): forward and reverse arcs over the car's exact outline, guided by the map.

A node is a true pose of the rear axle; nodes that share a cell of (x, y, yaw, direction) compete, and the cheapest
stays. What remains to the goal is estimated by Dijkstra's distance over the cells in which the rear axle can be. An arc
that meets a wall is driven up to it: where a car must reverse, it uses all the room there is.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import none_negative
from zebrat_bullet.errors import ConfigError, PlanError
from zebrat_bullet.planning.arc_path import ArcPath, axle_pose, clearances, footprint_about_axle, sweep_factor
from zebrat_bullet.planning.arc_search import Cells, Field, Found, Goal, Moves, distances_to, search, separation
from zebrat_bullet.planning.footprint_check import Outline, WallIndex, index_walls, outline_of
from zebrat_bullet.planning.grid import inscribed_radius_m
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Pose2

# A start nearer to a wall than the margin is left within this much driving.
_LEAVE_START_M = 2.0
# Of the gap that such a start has, a path out keeps so much: to turn away from a wall the tail swings towards it.
_KEPT_OF_START = 0.4
_PADDING_M = 3.0
_FIELD_CELL_M = 0.1
# Cells further from the goal than the start by more than this are not looked at.
_DETOUR_M = 5.0


@dataclass(frozen=True, kw_only=True)
class HybridAStarConfig:
    """How finely the search looks, and what it dislikes; costs in metres of driving.

    Attributes:
        max_steering_rad, n_steering: arcs are driven with at most this steering, so many angles evenly spaced.
        arc_m: length of an arc.
        cell_m, n_yaw: size of a cell, and into how many the full turn is divided.
        tight_m: nearer than this to a wall cells are half as large, in searches for margins of less than half of it.
        reverse_cost: of each metre driven backward, on top of its length.
        reversal_cost: of each change between forward and backward.
        steering_cost: of each radian of change in steering.
        nearness_cost, wide_m: of each metre driven along a wall; it falls to 0 at `wide_m` from it.
        margins_m: clearances tried in turn, the widest first.
        save_reversals: where a margin leaves only ways with reversals, try the next ones for fewer.
        greed: factor on what is left to the goal; above 1 the search is faster, and its path up to so much dearer.
        goal_radius_m: how near to the goal the lidar must come.
        max_nodes: the search for one margin gives up after so many.
    """

    max_steering_rad: float = 0.6
    n_steering: int = 7
    arc_m: float = 0.2
    cell_m: float = 0.1
    n_yaw: int = 72
    tight_m: float = 0.05
    reverse_cost: float = 1.0
    reversal_cost: float = 3.0
    steering_cost: float = 0.2
    nearness_cost: float = 2.0
    wide_m: float = 0.1
    margins_m: tuple[float, ...] = (0.03, 0.01, 0.003)
    save_reversals: bool = False
    greed: float = 1.1
    goal_radius_m: float = 0.3
    max_nodes: int = 200_000

    def __post_init__(self) -> None:
        none_negative(self)
        if not (self.arc_m > 0 and self.cell_m > 0 and self.n_yaw >= 8 and self.n_steering >= 3):
            raise ConfigError(
                f"a search needs arc_m and cell_m above 0, n_yaw of at least 8 and n_steering of at least 3, got {self}"
            )
        if not self.margins_m or min(self.margins_m) <= 0.0:
            raise ConfigError(f"margins_m must name at least one clearance above 0, got {self.margins_m}")
        if self.max_nodes < 2 or self.wide_m <= 0.0 or self.greed < 1.0:
            raise ConfigError(f"max_nodes must be at least 2, wide_m above 0 and greed at least 1, got {self}")

    def finer(self) -> "HybridAStarConfig":
        """Return settings that look twice as closely, for the least margin."""
        return replace(
            self,
            arc_m=self.arc_m / 2.0,
            cell_m=self.cell_m / 2.0,
            n_yaw=2 * self.n_yaw,
            n_steering=5,
            margins_m=(min(self.margins_m),),
        )

    def finest(self) -> "HybridAStarConfig":
        """Return settings that look as closely as some seconds allow, for the least margin."""
        finer = self.finer()
        return replace(finer, cell_m=finer.cell_m / 2.0, n_yaw=2 * finer.n_yaw, max_nodes=500_000)


@dataclass(frozen=True)
class Plan:
    """A path that keeps a distance from every wall.

    Attributes:
        path: from the start to a pose whose lidar is at the goal. It has few reversals, not provably the fewest.
        margin_m: the distance that all of it keeps, but within 2 m of a start that stands nearer: the first of the
            margins tried for which a path was found, or a later one that saved a reversal.
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
        PlanError: the car touches a wall where it starts (proven), or no search found a drive with any of the margins
            (not proven).
    """
    config = config or HybridAStarConfig()
    axle = axle_pose(start, robot)
    if float(clearances(axle[None], robot, walls)[0]) == 0.0:
        raise PlanError(
            f"the car touches a wall where it starts, at ({start.x:.2f}, {start.y:.2f}); move it", proven=True
        )
    room = _Room(index_walls(walls, robot), robot, axle, goal_world, config)
    best: Plan | None = None
    for margin in config.margins_m:
        if best is not None and (best.path.n_reversals == 0 or not config.save_reversals):
            break
        found = room.search(margin)
        if found.last >= 0 and (best is None or _path(found).n_reversals < best.path.n_reversals):
            best = Plan(_path(found), margin)
    if best is None:
        raise PlanError(
            f"found no drive from ({start.x:.2f}, {start.y:.2f}) to ({goal_world[0]:.2f}, {goal_world[1]:.2f}) that "
            f"keeps {min(config.margins_m):g} m from the walls, which does not prove that there is none; widen the "
            "passage, allow a smaller margin or raise max_nodes"
        )
    return best


class _Room:
    """What all searches of one plan have in common; `axle` is where the rear axle starts."""

    def __init__(
        self,
        index: WallIndex,
        robot: RobotModel,
        axle: NDArray[np.float64],
        goal_world: NDArray[np.float64],
        config: HybridAStarConfig,
    ) -> None:
        self._index, self._robot, self._axle, self._config = index, robot, axle, config
        lidar = robot.lidar_xyz_base[:2] - (robot.rear_axle_x_m, 0.0)
        goal_xy = float(goal_world[0]), float(goal_world[1])
        self._goal = Goal(*goal_xy, config.goal_radius_m, float(lidar[0]), float(lidar[1]))
        self._outline: Outline = outline_of(footprint_about_axle(robot))
        self._field = self._field_to(goal_world)

    def search(self, margin_m: float) -> Found:
        config, robot = self._config, self._robot
        tight = config.tight_m if margin_m < config.tight_m / 2.0 else 0.0
        steering = np.linspace(-config.max_steering_rad, config.max_steering_rad, config.n_steering)
        curvatures = np.tan(steering) / robot.wheelbase_m
        sweeps = np.array([sweep_factor(robot, curvature) for curvature in curvatures])
        costs = config.reverse_cost, config.reversal_cost, config.steering_cost, config.nearness_cost, config.wide_m
        x, y, yaw = self._axle.tolist()
        gap = separation(self._index, self._outline, x, y, yaw, 0.0)
        return search(
            self._axle,
            self._goal,
            self._field,
            Cells(config.cell_m, config.n_yaw, tight),
            Moves(steering, curvatures, sweeps, config.arc_m, config.arc_m / 5.0, *costs),
            self._index,
            self._outline,
            margin_m,
            min(margin_m, _KEPT_OF_START * gap),
            _LEAVE_START_M,
            config.max_nodes,
        )

    def _field_to(self, goal_world: NDArray[np.float64]) -> Field:
        """Return every cell's distance to the goal for the rear axle."""
        segments, cell = self._index.segments, _FIELD_CELL_M
        points = np.vstack([segments.reshape(-1, 2), self._axle[:2], goal_world])
        low, high = points.min(axis=0) - _PADDING_M, points.max(axis=0) + _PADDING_M
        n_columns, n_rows = np.ceil((high - low) / cell).astype(int).tolist()
        goal, start = (tuple(((xy - low) / cell).astype(int)[::-1].tolist()) for xy in (goal_world, self._axle[:2]))
        # The axle may be half a diagonal nearer to a wall than the middle of its cell.
        radius = inscribed_radius_m(self._robot.footprint_base, (self._robot.rear_axle_x_m, 0.0)) - cell / math.sqrt(
            2.0
        )
        x, y = low.tolist()
        to_goal = distances_to(self._index, radius, (n_rows, n_columns), (x, y), cell, goal, start, _DETOUR_M)
        return Field(self._config.greed * to_goal, x, y, cell)


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
