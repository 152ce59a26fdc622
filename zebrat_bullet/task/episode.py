"""Where an episode begins, and when and how it ends (success, false exit, collision, time-out, stall)."""

import math
from enum import StrEnum

import numpy as np
import shapely

from zebrat_bullet.config import EpisodeConfig
from zebrat_bullet.errors import WorldError
from zebrat_bullet.geometry import rotation_2d, to_world
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Clearance, FlatScan, Pose2, RobotState
from zebrat_bullet.world import World

ANYWHERE_MARGIN_M = 0.03
ANYWHERE_TRIES = 200


class Outcome(StrEnum):
    """How an episode ended; `false_exit`, `timeout` and `stall` count as fails."""

    SUCCESS = "success"
    COLLISION = "collision"
    FALSE_EXIT = "false_exit"
    TIMEOUT = "timeout"
    STALL = "stall"

    @property
    def terminal(self) -> bool:
        """Whether the task itself ended, rather than being cut off (gymnasium's terminated against truncated)."""
        return self not in (Outcome.TIMEOUT, Outcome.STALL)


def start_pose(world: World, rng: np.random.Generator) -> Pose2:
    """Draw a pose from the world's start range, uniform in the start pose's own frame."""
    start = world.start
    half_range = np.array([start.range_x_m, start.range_y_m, start.range_yaw_rad])
    dx, dy, dyaw = rng.uniform(-half_range, half_range)
    x, y = rotation_2d(start.pose.yaw) @ (dx, dy)
    return Pose2(start.pose.x + x, start.pose.y + y, start.pose.yaw + dyaw)


def anywhere_pose(world: World, robot: RobotModel, rng: np.random.Generator) -> Pose2:
    """Draw a free pose along the centre line before the exit, heading along the path within 0.5 rad.

    Raises:
        WorldError: the world has no centre line, or no free pose was found on it.
    """
    line = world.centre_line
    if len(line) < 2:
        raise WorldError(f"world {world.name!r} has no centre line, so start='anywhere' cannot be used; use 'start'")
    before_exit = [i for i in range(len(line) - 1) if not world.past_open_line(*line[i + 1])]
    outline = shapely.Polygon(robot.footprint_base).buffer(ANYWHERE_MARGIN_M, join_style="mitre")
    corners = np.asarray(outline.exterior.coords)
    for _ in range(ANYWHERE_TRIES):
        i = before_exit[rng.integers(len(before_exit))]
        heading = math.atan2(*(line[i + 1] - line[i])[::-1])
        side = rng.uniform(-0.3, 0.3) * max(world.widths_m[i] - 0.6, 0.0)
        x, y = line[i] + side * np.array([-math.sin(heading), math.cos(heading)])
        pose = Pose2(float(x), float(y), heading + rng.uniform(-0.5, 0.5))
        if not shapely.intersects(world.walls, shapely.Polygon(to_world(corners, pose))):
            return pose
    raise WorldError(f"world {world.name!r}: no free pose along the centre line in {ANYWHERE_TRIES} tries")


class EpisodeRules:
    """Watches one episode and says when it is over."""

    def __init__(self, config: EpisodeConfig, robot: RobotModel) -> None:
        self._config = config
        self._lidar_xy = robot.lidar_xyz_base[:2]

    def begin(self, world: World, state: RobotState) -> None:
        """Start to watch an episode in `world` from `state`."""
        self._world = world
        self._max_steps = world.max_steps or self._config.max_steps
        self._step = 0
        self._checked = state.pose

    def judge(self, state: RobotState, scan: FlatScan, clearance: Clearance) -> Outcome | None:
        """Return the outcome after a control step, None while the episode goes on; collision before open space."""
        self._step += 1
        if clearance.collision or state.contact:
            return Outcome.COLLISION
        if self.sees_open_space(scan):
            x, y = to_world(self._lidar_xy, state.pose)
            return Outcome.SUCCESS if self._world.past_open_line(x, y) else Outcome.FALSE_EXIT
        if self._stalled(state.pose):
            return Outcome.STALL
        return Outcome.TIMEOUT if self._step >= self._max_steps else None

    def sees_open_space(self, scan: FlatScan) -> bool:
        """Return whether V_left + V_right exceeds the open width: all that the car itself can know of the exit."""
        n = len(scan.ranges_m)
        return bool(scan.ranges_m[n // 4] + scan.ranges_m[3 * n // 4] > self._config.open_width_m)

    def _stalled(self, pose: Pose2) -> bool:
        if self._step % self._config.stall_steps:
            return False
        moved = math.hypot(pose.x - self._checked.x, pose.y - self._checked.y)
        self._checked = pose
        return moved < self._config.stall_distance_m
