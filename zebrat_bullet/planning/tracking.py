"""Follows a path of arcs, forward and backward, with one command a control step."""

import math

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.geometry import wrap_angle
from zebrat_bullet.planning.arc_path import ArcPath, along_arc, axle_pose
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Command, RobotState

_SPACING_M = 0.01
# The knuckles follow a new angle like a first-order lag of about this time.
_LAG_S = 0.09
# Errors die away within about this distance, critically damped.
_SETTLE_M = 0.4
# How far ahead of the last place the car is looked for.
_WINDOW_M = 0.5
_REACHED_M = 0.02
# A car that stands turns its wheels first where they are off by more than this.
_TURN_STANDING_RAD = 0.15


class PathTracker:
    """Steers the rear axle along a path at full speed; stops where the path changes direction, and at its end.

    In distance driven, the lateral error e of a car whose curvature differs from the path's by dk obeys e'' = dk, for
    small errors. The feedback dk = -e / l^2 - 2 e' / l makes it die away over the length l. The path's own curvature is
    taken as the mean over what will be driven under the command, which begins to act a steering lag after it is given.

    Args:
        path: what to follow, of at least one arc.
        robot: the car.
        physics: limits and duration of a command.
    """

    def __init__(self, path: ArcPath, robot: RobotModel, physics: PhysicsConfig) -> None:
        self._robot, self._physics = robot, physics
        self._poses, arc = path.sample(_SPACING_M)
        self._curvatures, self._directions = path.curvatures[arc], path.directions[arc]
        steps = np.diff(self._poses[:, :2], axis=0)
        self._distances = np.concatenate([[0.0], np.hypot(*steps.T).cumsum()])
        # The last sample of each run in one direction.
        changes = np.flatnonzero(np.diff(self._directions)).tolist()
        self._ends = [*changes, len(self._poses) - 1]
        self._at = 0
        self.lateral_error_m = self.heading_error_rad = 0.0

    def act(self, state: RobotState) -> Command:
        """Return the command for a car in this state; it stands still at the end of the path."""
        pose = self._expected_pose(state)
        self._at = self._nearest(pose)
        while len(self._ends) > 1 and self._remaining_m() < _REACHED_M:
            self._at = self._ends.pop(0) + 1
            self._at = self._nearest(pose)
        speed = min(self._physics.max_speed_mps, self._remaining_m() / self._physics.control_step_s)
        if self._remaining_m() < _REACHED_M:
            return Command(0.0, 0.0)
        direction = int(self._directions[self._at])
        steering = self._steering(pose, direction, speed)
        standing = direction * state.speed_mps < 0.1
        if standing and abs(steering - state.steering_rad) > _TURN_STANDING_RAD:
            speed = 0.0
        return Command(direction * speed, steering)

    def _expected_pose(self, state: RobotState) -> NDArray[np.float64]:
        """Return the rear-axle pose at which a command given now takes hold."""
        distance = state.speed_mps * _LAG_S
        turn = distance * math.tan(state.steering_rad) / self._robot.wheelbase_m
        if distance == 0.0:
            return axle_pose(state.pose, self._robot)
        return along_arc(axle_pose(state.pose, self._robot), np.array([distance]), turn)[0]

    def _nearest(self, pose: NDArray[np.float64]) -> int:
        """Return the nearest sample of the path from the last one found up to the next change of direction."""
        last = min(self._ends[0], self._at + round(_WINDOW_M / _SPACING_M))
        gaps = self._poses[self._at : last + 1, :2] - pose[:2]
        return self._at + int(np.argmin(np.hypot(*gaps.T)))

    def _remaining_m(self) -> float:
        return float(self._distances[self._ends[0]] - self._distances[self._at])

    def _steering(self, pose: NDArray[np.float64], direction: int, speed: float) -> float:
        here = self._poses[self._at]
        dx, dy = pose[:2] - here[:2]
        self.lateral_error_m = -math.sin(here[2]) * dx + math.cos(here[2]) * dy
        self.heading_error_rad = wrap_angle(pose[2] - here[2])
        ahead = self._at + max(1, round(speed * self._physics.control_step_s / _SPACING_M))
        feedforward = float(self._curvatures[self._at + 1 : min(ahead, self._ends[0]) + 1].mean())
        # In reverse the error grows with the opposite heading: e' = -sin(heading error).
        slope = direction * math.sin(self.heading_error_rad)
        curvature = feedforward - self.lateral_error_m / _SETTLE_M**2 - 2.0 * slope / _SETTLE_M
        limit = self._physics.max_steering_rad
        return min(max(math.atan(curvature * self._robot.wheelbase_m), -limit), limit)
