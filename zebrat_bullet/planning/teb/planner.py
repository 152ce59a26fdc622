"""The local planner: from pose, velocity and global plan to a command, with ROS's checks and recoveries."""

import math
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.geometry import wall_segments, wrap_angle
from zebrat_bullet.planning.arc_path import axle_pose, footprint_about_axle, outlines
from zebrat_bullet.planning.grid import OccupancyGrid, inscribed_radius_m
from zebrat_bullet.planning.teb.band import Band, begin, prune
from zebrat_bullet.planning.teb.config import TebConfig, costs_for
from zebrat_bullet.planning.teb.global_path import GlobalPath
from zebrat_bullet.planning.teb.optimise import Surroundings, optimise
from zebrat_bullet.planning.teb.oscillation import Oscillation
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Command, RobotState

_STOP = Command(0.0, 0.0)
_LEAST_INSCRIBED_M = 0.02
_MERGE_M = 0.005  # wall outlines are simplified by this much for the optimiser; the final check is exact


class TebPlanner:
    """Keeps a band from one control step to the next.

    Args:
        config: settings.
        robot: the car; its rear axle is what the band moves.
        physics: limits of speed and steering, and the control step.
        walls: outlines of everything the car can hit, world frame; `see_cells` names others.

    Attributes:
        band: the last band; None before the first and after one that was infeasible or diverged.
    """

    def __init__(
        self, config: TebConfig, robot: RobotModel, physics: PhysicsConfig, walls: shapely.MultiPolygon
    ) -> None:
        self._config, self._robot, self._physics = config, robot, physics
        self._costs = costs_for(config, robot, physics)
        self._outline = footprint_about_axle(robot)
        # The rear axle of some cars is at the very edge of their outline.
        self._inscribed_m = max(inscribed_radius_m(self._outline), _LEAST_INSCRIBED_M)
        self._oscillation = Oscillation(config, physics.control_step_s)
        self._shrunk_until_s = -math.inf
        self.band: Band | None = None
        self._see(walls, wall_segments(shapely.simplify(walls, _MERGE_M)).reshape(-1, 4))

    def see_cells(self, grid: OccupancyGrid) -> None:
        """Keep off the occupied cells of a costmap from now on, and off nothing else.

        As in ROS without a costmap converter: the band is pushed away from the centre of every cell, each a point that
        costs by itself, and the final check looks at whole cells.
        """
        centres = grid.centres_of(np.argwhere(grid.occupied))
        half = 0.5 * grid.resolution_m
        squares = shapely.box(*(centres - half).T, *(centres + half).T)
        self._see(shapely.geometrycollections(squares), np.hstack([centres, centres]))

    def _see(self, walls: shapely.Geometry, segments: NDArray[np.float64]) -> None:
        self._walls, self._segments = walls, segments
        shapely.prepare(walls)

    def plan(self, state: RobotState, path: GlobalPath, time_s: float) -> Command:
        """Return the command for this control step; it stops the car where no feasible band was found."""
        start = axle_pose(state.pose, self._robot)
        shrunk = 0.5 if time_s < self._shrunk_until_s else 1.0
        local, goal_yaw = path.ahead(start[:2], self._config.max_global_plan_lookahead_dist_m, shrunk)
        goal = np.array([*local[-1], goal_yaw])
        around = Surroundings(
            outline=self._outline,
            segments=self._near(start[:2]),
            via_points=via_points(local, self._config.global_plan_viapoint_sep_m),
            velocity=np.array([state.speed_mps, state.yaw_rate_radps]),
            rotate=self._oscillation.preferred_turn(time_s),
        )
        self.band = optimise(self._warm_start(local, start, goal), around, self._config, self._costs)
        if self.band is None or not self.feasible(self.band):
            self.band = None
            self._shrunk_until_s = time_s + self._config.shrink_horizon_min_duration_s
            self._oscillation.update(0.0, 0.0, state.yaw_rate_radps, time_s)
            return _STOP
        v, omega = self._saturate(*first_velocity(self.band))
        costs = self._costs
        limit = costs.max_vel_x_mps if v >= 0.0 else costs.max_vel_x_backwards_mps
        self._oscillation.update(v / limit, omega / costs.max_vel_theta_radps, state.yaw_rate_radps, time_s)
        return Command(float(v), steering_angle(v, omega, self._robot.wheelbase_m, self._physics.max_steering_rad))

    def _warm_start(self, local: NDArray[np.float64], start: NDArray[np.float64], goal: NDArray[np.float64]) -> Band:
        """Return the last band moved to the new start and goal, or a new one along the global plan."""
        if self.band is not None:
            away = math.hypot(*(goal[:2] - self.band.poses[-1, :2]))
            turned = abs(wrap_angle(goal[2] - self.band.poses[-1, 2]))
            if (
                away < self._config.force_reinit_new_goal_dist_m
                and turned < self._config.force_reinit_new_goal_angular_rad
            ):
                return prune(self.band, start, goal, self._config.min_samples)
        return begin(local, start, goal[2], self._costs)

    def _near(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        reach = self._config.max_global_plan_lookahead_dist_m + 1.0
        a, b = self._segments[:, :2], self._segments[:, 2:]
        squared = np.maximum(((b - a) ** 2).sum(axis=1), 1e-18)  # the points of a costmap have no length
        along = ((xy - a) * (b - a)).sum(axis=1) / squared
        nearest = a + np.clip(along, 0.0, 1.0)[:, None] * (b - a)
        return self._segments[np.hypot(*(nearest - xy).T) < reach]

    def feasible(self, band: Band) -> bool:
        """Return whether the exact footprint is free of walls at the first poses, and between any far apart."""
        poses = band.poses[: self._config.feasibility_check_no_poses + 1]
        parts = [poses[:1]]
        for pose, following in pairwise(poses):
            step = following - pose
            step[2] = wrap_angle(step[2])
            n = max(1, math.ceil(math.hypot(step[0], step[1]) / self._inscribed_m))
            parts.append(pose + np.arange(1, n + 1)[:, None] / n * step)
        return not shapely.intersects(self._walls, outlines(np.vstack(parts), self._robot)).any()

    def _saturate(self, v: float, omega: float) -> tuple[float, float]:
        costs = self._costs
        limit = costs.max_vel_theta_radps
        return (
            min(max(v, -costs.max_vel_x_backwards_mps), costs.max_vel_x_mps),
            min(max(omega, -limit), limit),
        )


def via_points(local: NDArray[np.float64], separation_m: float) -> NDArray[np.float64]:
    """Return (V, 2) points of an (M, 2) path in m, about `separation_m` apart; none for a separation of 0."""
    if separation_m <= 0.0:
        return np.empty((0, 2))
    length = np.append(0.0, np.cumsum(np.hypot(*np.diff(local, axis=0).T)))
    return local[np.flatnonzero(np.diff(length // separation_m)) + 1]


def first_velocity(band: Band) -> tuple[float, float]:
    """Return speed in m/s, below 0 in reverse, and yaw rate in rad/s of the band's first step."""
    dx, dy, turn = band.poses[1] - band.poses[0]
    yaw, dt = band.poses[0, 2], band.dt_s[0]
    forward = dx * math.cos(yaw) + dy * math.sin(yaw)
    return math.copysign(math.hypot(dx, dy), forward) / dt, wrap_angle(turn) / dt


def steering_angle(v: float, omega: float, wheelbase_m: float, max_steering_rad: float) -> float:
    """Return the virtual steering angle in rad that turns at `omega` when driving at `v`, clipped to its limit."""
    if v == 0.0 or omega == 0.0:
        return 0.0
    angle = math.atan(wheelbase_m * omega / v)
    return min(max(angle, -max_steering_rad), max_steering_rad)
