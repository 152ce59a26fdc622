"""TEB as an agent: a global plan over the inflated map, and a timed elastic band that follows it at every reading."""

import contextlib

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.agents.planning_agent import PlanningAgent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import PlanError
from zebrat_bullet.planning.arc_path import axle_pose
from zebrat_bullet.planning.global_plan import plan
from zebrat_bullet.planning.grid import OccupancyGrid, inscribed_radius_m
from zebrat_bullet.planning.local_costmap import LocalCostmap
from zebrat_bullet.planning.teb.config import TebConfig
from zebrat_bullet.planning.teb.global_path import GlobalPath
from zebrat_bullet.planning.teb.planner import TebPlanner
from zebrat_bullet.robot import load_robot
from zebrat_bullet.types import Command, Reading


class TebAgent(PlanningAgent):
    """teb_local_planner for car-like robots, given the map, the pose and the goal.

    Args:
        config: settings of the planner.
        task: the task it drives in: the car and the limits of its commands.
    """

    name = "teb"
    privileged = frozenset({"pose", "map", "goal"})

    def __init__(self, config: TebConfig, task: TaskConfig) -> None:
        self._config, self._task = config, task
        self._robot = load_robot(task.robot)
        self._radius_m = inscribed_radius_m(self._robot.footprint_base)
        self._walls: shapely.MultiPolygon | None = None
        self._costmap = LocalCostmap(self._robot) if config.costmap == "live" else None

    def reset(self, seed: int) -> None:
        """Forget band, global plan and what the lidar has seen; the planner draws no random numbers."""
        super().reset(seed)
        if self._costmap is not None:
            self._costmap.forget()
        self.planner: TebPlanner | None = None

    def _drive(self, reading: Reading) -> Command:
        """Return the command of the band; stop at the goal."""
        assert reading.state is not None and reading.walls is not None and reading.goal_world is not None
        here, goal = axle_pose(reading.state.pose, self._robot)[:2], reading.goal_world
        if np.hypot(*(goal - here)) <= self._config.xy_goal_tolerance_m:
            return Command(0.0, 0.0)
        if reading.walls is not self._walls:
            self._walls = reading.walls
            self._grid = OccupancyGrid.of_walls(reading.walls, also_inside=[here, goal])
        if self.planner is None:
            self.planner = TebPlanner(self._config, self._robot, self._task.physics, reading.walls)
            self.path = self._global_plan(here, goal)
        elif self.path.distance_to(here) > self._config.global_plan_prune_distance_m:
            with contextlib.suppress(PlanError):  # where no way is found from here, the old plan must do
                self.path = self._global_plan(here, goal)
        if self._costmap is not None:
            self.planner.see_cells(self._costmap.see(reading.scan, reading.state.pose))
        return self.planner.plan(reading.state, self.path, reading.time_s)

    def _global_plan(self, here: NDArray[np.float64], goal: NDArray[np.float64]) -> GlobalPath:
        return GlobalPath(
            plan(self._grid, here, goal, self._config.inflation_radius_m, inscribed_radius_m=self._radius_m)
        )
