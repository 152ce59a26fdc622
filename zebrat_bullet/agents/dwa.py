"""DWA as an agent: a global plan over the map, and the dynamic window that follows it."""

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.agents.planning_agent import PlanningAgent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import PlanError
from zebrat_bullet.planning.dwa import DwaConfig, DwaPlanner
from zebrat_bullet.planning.global_plan import plan
from zebrat_bullet.planning.grid import OccupancyGrid, inscribed_radius_m
from zebrat_bullet.planning.local_costmap import LocalCostmap
from zebrat_bullet.robot import load_robot
from zebrat_bullet.types import Command, Reading

_STOP = Command(0.0, 0.0)


class DwaAgent(PlanningAgent):
    """move_base with dwa_local_planner: planned once an episode (planner_frequency 0), and again when DWA finds no way.

    Where it finds none, the car stands: move_base's recoveries are clearing what the costmap has far from the car, and
    turning on the spot, which no car can.

    Args:
        config: settings.
        task: robot and limits.
    """

    name = "dwa"
    privileged = frozenset({"pose", "map", "goal"})

    def __init__(self, config: DwaConfig, task: TaskConfig) -> None:
        self.config, self._limits = config, task.physics
        self._robot = load_robot(task.robot)
        self._radius_m = inscribed_radius_m(self._robot.footprint_base)
        self._walls: shapely.MultiPolygon | None = None
        live = config.costmap == "live"
        self._costmap = LocalCostmap(self._robot, config.resolution_m, config.window_m) if live else None

    def reset(self, seed: int) -> None:
        """Forget the plan, and what the lidar has seen."""
        super().reset(seed)
        if self._costmap is not None:
            self._costmap.forget()
        self._planned_from: NDArray[np.float64] | None = None

    def _drive(self, reading: Reading) -> Command:
        """Return the command of the cheapest rollout; stop at the goal and where there is none."""
        assert reading.state is not None and reading.walls is not None and reading.goal_world is not None
        at = np.array([reading.state.pose.x, reading.state.pose.y])
        if np.linalg.norm(reading.goal_world - at) <= self.config.xy_goal_tolerance_m:
            return _STOP
        if reading.walls is not self._walls:
            self._walls = reading.walls
            self._grid = OccupancyGrid.of_walls(
                reading.walls, self.config.resolution_m, also_inside=[at, reading.goal_world]
            )
            self._dwa = DwaPlanner(self.config, self._robot, self._limits, self._grid)
        if self._costmap is not None:
            self._dwa.see(self._costmap.see(reading.scan, reading.state.pose))
        if self._planned_from is None:
            self._plan(at, reading.goal_world)
        command = self._dwa.command(reading.state)
        if command is None and np.linalg.norm(at - self._planned_from) > self.config.resolution_m:
            self._replan(at, reading.goal_world)
        return command or _STOP

    def _plan(self, at: NDArray[np.float64], goal: NDArray[np.float64]) -> None:
        path = plan(
            self._grid,
            at,
            goal,
            self.config.inflation_radius_m,
            inscribed_radius_m=self._radius_m,
            cost_scaling_factor=self.config.cost_scaling_factor,
            method=self.config.global_planner,
        )
        self._dwa.follow(path)
        self._planned_from = at

    def _replan(self, at: NDArray[np.float64], goal: NDArray[np.float64]) -> None:
        try:
            self._plan(at, goal)
        except PlanError:  # the car has squeezed itself to where its centre may not be: it keeps the old plan
            self._planned_from = at
