"""The yardstick: knows pose, map and goal, plans the whole drive once and follows it."""

import math
from dataclasses import replace

import numpy as np

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import PlanError
from zebrat_bullet.planning.arc_path import ArcPath
from zebrat_bullet.planning.hybrid_a_star import HybridAStarConfig, plan_path
from zebrat_bullet.planning.tracking import PathTracker
from zebrat_bullet.robot import load_robot
from zebrat_bullet.types import Command, Reading

# Left to the tracker, so that it can correct in the tightest bend too.
_STEERING_RESERVE_RAD = 0.04
_STRAYED_M = 0.15
_STRAYED_RAD = 0.4
# Between two plans: where there is no better way, looking for one at every step would only take time.
_PATIENCE_S = 1.0
# Straight on past the end of the plan: the judge, not the plan, says when open space is reached.
_RUN_OUT_M = 3.0


class OracleAgent:
    """Hybrid A* from the true start pose over the true walls, and a tracker; it plans again where it has strayed.

    Where there is no way it stands still, and the judge calls it stalled.

    Args:
        config: the planner; its steering is lessened by a reserve for the tracker as long as that leaves a way. Where
            only the last, least margin is left, it first looks more closely for a way with a wider one.
        task: the task it drives in: the car and the limits of its commands.
    """

    name = "oracle"
    privileged = frozenset({"pose", "map", "goal"})

    def __init__(self, config: HybridAStarConfig, task: TaskConfig) -> None:
        self._robot, self._physics = load_robot(task.robot), task.physics
        most = min(config.max_steering_rad, self._physics.max_steering_rad)
        # A tracker errs by a centimetre or two: a margin that forgives it goes before steering in reserve.
        roomy = replace(config, max_steering_rad=most, margins_m=config.margins_m[:-1] or config.margins_m)
        least = replace(config, max_steering_rad=most)
        in_reserve = replace(roomy, max_steering_rad=most - _STEERING_RESERVE_RAD)
        self._searches = [in_reserve, roomy, roomy.finer(), least, least.finer(), least.finest()]

    def reset(self, seed: int) -> None:
        """Forget the plan; the oracle leaves nothing to chance."""
        self._tracker: PathTracker | None = None
        self._planned_s = -math.inf

    def act(self, reading: Reading) -> Command:
        """Return the command for this reading; the first of an episode takes as long as a plan."""
        assert reading.state is not None
        if self._planned_s == -math.inf:
            self._plan(reading)
        if self._tracker is None:
            return Command(0.0, 0.0)
        command = self._tracker.act(reading.state)
        if self._has_strayed(self._tracker) and reading.time_s - self._planned_s >= _PATIENCE_S:
            self._plan(reading)
            command = self._tracker.act(reading.state)
        return command

    @property
    def lost(self) -> bool:
        """It knows no way from where it last was asked: it found none, or the car has strayed from it."""
        return self._tracker is None or self._has_strayed(self._tracker)

    def _has_strayed(self, tracker: PathTracker) -> bool:
        return abs(tracker.lateral_error_m) > _STRAYED_M or abs(tracker.heading_error_rad) > _STRAYED_RAD

    def _plan(self, reading: Reading) -> None:
        """Plan from where the car is; keep the plan there was where no other is found."""
        self._planned_s = reading.time_s
        assert reading.state is not None and reading.walls is not None and reading.goal_world is not None
        for search in self._searches:
            try:
                plan = plan_path(reading.walls, self._robot, reading.state.pose, reading.goal_world, search)
            except PlanError:
                continue
            self._tracker = PathTracker(_run_out(plan.path), self._robot, self._physics)
            return


def _run_out(path: ArcPath) -> ArcPath:
    """Return the path with a straight in its last direction added."""
    end = path.poses_world[-1]
    direction = path.directions[-1] if len(path.directions) else 1
    step = direction * _RUN_OUT_M * np.array([np.cos(end[2]), np.sin(end[2]), 0.0])
    return ArcPath(np.vstack([path.poses_world, end + step]), np.append(path.directions, direction))
