"""Every control step: sample the speeds in reach, roll each out, price the rollouts, choose the cheapest."""

import math

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.planning.dwa import critics, rollouts
from zebrat_bullet.planning.dwa.config import PRUNE_M, DwaConfig
from zebrat_bullet.planning.grid import OccupancyGrid, inflate, inscribed_radius_m
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Command, Pose2, RobotState


class DwaPlanner:
    """Follows a path over a map.

    v and w are those of the rear axle's centre, where a car moves as a unicycle, so the steering angle is
    atan(wheelbase w / v). Poses are those of the body's centre, ROS's base frame. Samples that the car cannot steer are
    not taken, so a rollout is what the car will do.

    Args:
        config: settings.
        robot: the car.
        limits: largest speed and steering angle, control step.
        grid: the obstacles; `see` names others.
    """

    def __init__(self, config: DwaConfig, robot: RobotModel, limits: PhysicsConfig, grid: OccupancyGrid) -> None:
        self.config = config
        self._robot, self._limits = robot, limits
        self._min_radius_m = robot.wheelbase_m / math.tan(limits.max_steering_rad)
        self._radius_m = inscribed_radius_m(robot.footprint_base)
        self._half = round(config.window_m / 2.0 / config.resolution_m)
        self._outline = critics.outline_points(
            robot.footprint_base, config.footprint_padding_m, config.resolution_m / 2.0
        )
        self._oscillation = critics.Oscillation(config)
        self.path = np.zeros((0, 2))
        self.see(grid)

    def see(self, grid: OccupancyGrid) -> None:
        """Have these obstacles from now on; the cells are of the size that the settings say."""
        config = self.config
        costs = inflate(grid, config.inflation_radius_m, self._radius_m, config.cost_scaling_factor)
        self._grid, self._costs = grid, np.pad(costs, self._half)

    def follow(self, path: NDArray[np.float64]) -> None:
        """Follow a new (N, 2) path in m, world frame, from now on."""
        self.path = path
        self._oscillation.forget()

    def command(self, state: RobotState) -> Command | None:
        """Return the command of the cheapest rollout, or None where all are refused or path or map are left."""
        at = np.array([state.pose.x, state.pose.y])
        self.path = pruned(self.path, at)
        samples = rollouts.velocity_window(
            state.speed_mps, state.yaw_rate_radps, self.config, self._limits, self._min_radius_m
        )
        if not len(self.path) or not len(samples) or not self._grid.contains(self._grid.cells_of(at)):
            return None
        total = np.sum(list(self.prices(state.pose, samples).values()), axis=0)
        best = int(np.argmin(total))
        if not np.isfinite(total[best]):
            return None
        v, w = map(float, samples[best])
        self._oscillation.note(state.pose, v, w)
        return Command(v, math.atan(self._robot.wheelbase_m * w / v) if v else 0.0)

    def prices(self, pose: Pose2, samples: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Return the (K,) price of each critic for the rollouts of (K, 2) samples v, w; inf refuses a rollout."""
        config = self.config
        at = np.array([pose.x, pose.y])
        ways = rollouts.roll_out(pose, samples, config, self._robot.rear_axle_x_m)
        centre = self._grid.cells_of(at)
        local = np.ascontiguousarray(self._costs[tuple(slice(c, c + 2 * self._half + 1) for c in centre)])

        def cells(points: NDArray[np.float64]) -> NDArray[np.intp]:
            return self._grid.cells_of(points) - centre + self._half

        part = in_window(self.path, at, config.window_m)
        nose_m = config.forward_point_distance_m
        to_goal = part[-1] - at
        nose_goal = part[-1] + nose_m * to_goal / max(float(np.linalg.norm(to_goal)), 1e-9)
        to_path = critics.grid_distances(local, cells(part))
        scale = critics.footprint_scale(samples[:, 0], config, self._limits.max_speed_mps)
        origin = self._grid.centres_of(centre - self._half) - config.resolution_m / 2.0
        walls = critics.obstacle_costs(local, origin, config.resolution_m, ways, self._outline, scale)
        noses = cells(critics.shifted(ways, nose_m))
        middles = cells(ways[..., :2])
        to_local_goal = critics.grid_distances(local, cells(part[-1:]))
        # Where the nose's goal lies beyond the window, the nearest cell in it stands for it.
        to_nose_goal = critics.grid_distances(local, np.clip(cells(nose_goal[None]), 0, 2 * self._half))
        # Near the goal the nose has passed the path's end: pulling it back would swing the car.
        near_goal = float(np.linalg.norm(self.path[-1] - at)) <= nose_m
        alignment = (
            np.zeros(len(samples)) if near_goal else critics.end_distances(to_path, noses, stop_on_failure=False)
        )
        path_price = config.path_distance_bias * config.resolution_m
        goal_price = config.goal_distance_bias * config.resolution_m
        return {
            "oscillation": np.where(self._oscillation.allows(samples), 0.0, np.inf),
            "obstacle": config.occdist_scale * walls,
            "goal_front": goal_price * critics.end_distances(to_nose_goal, noses, stop_on_failure=False),
            "alignment": path_price * alignment,
            "path": path_price * critics.end_distances(to_path, middles),
            "goal": goal_price * critics.end_distances(to_local_goal, middles),
        }


def pruned(path: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rest of an (N, 2) path from its first point within 1 m of (2,) `at`; nothing where none is so near."""
    near = np.flatnonzero(np.linalg.norm(path - at, axis=1) < PRUNE_M)
    return path[near[0] :] if len(near) else path[:0]


def in_window(path: NDArray[np.float64], at: NDArray[np.float64], window_m: float) -> NDArray[np.float64]:
    """Return the head of an (N, 2) path until it first leaves the circle in the window about (2,) `at`."""
    left = np.linalg.norm(path - at, axis=1) > window_m / 2.0
    return path[: int(np.argmax(left))] if left.any() else path
