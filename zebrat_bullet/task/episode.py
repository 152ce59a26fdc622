"""Where an episode begins, and when and how it ends (success, false exit, collision, time-out, stall)."""

import math
from collections.abc import Sequence
from enum import StrEnum

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.arrays import Array, device_of, namespace
from zebrat_bullet.config import EpisodeConfig
from zebrat_bullet.errors import WorldError
from zebrat_bullet.geometry import rotation_2d, to_world_all
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World
from zebrat_bullet.world.goal import GATES, REACHED_M

ANYWHERE_MARGIN_M = 0.03
ANYWHERE_TRIES = 200
LINE_MARGIN_M = 0.1
"""A lidar that crosses the open-space line may pass its ends by so much: it moves up to 0.12 m in a control step."""
GOES_ON = 0
"""Code of an episode that is not over."""


class Outcome(StrEnum):
    """How an episode ended; `false_exit`, `timeout` and `stall` count as fails."""

    SUCCESS = "success"
    COLLISION = "collision"
    FALSE_EXIT = "false_exit"
    TIMEOUT = "timeout"
    STALL = "stall"

    @property
    def code(self) -> int:
        """The number, from 1 on, that stands for it in arrays of cars."""
        return OUTCOMES.index(self) + 1

    @staticmethod
    def of(code: int) -> "Outcome | None":
        """Return the outcome of a code, None while the episode goes on."""
        return OUTCOMES[code - 1] if code else None


OUTCOMES = tuple(Outcome)
_CODES = {outcome: outcome.code for outcome in OUTCOMES}


def draw_pose(world: World, robot: RobotModel, config: EpisodeConfig, rng: np.random.Generator) -> Pose2:
    """Draw where an episode begins, by the `start` of its rules.

    Raises:
        WorldError: as `anywhere_poses`.
    """
    ((x, y, yaw),) = draw_poses(world, robot, config, rng, 1).tolist()
    return Pose2(x, y, yaw)


def draw_poses(
    world: World, robot: RobotModel, config: EpisodeConfig, rng: np.random.Generator, n: int
) -> NDArray[np.float64]:
    """Draw (n, 3) such poses: x, y in m and yaw in rad."""
    if config.start == "anywhere":
        return anywhere_poses(world, robot, rng, n, config.anywhere_yaw_rad)
    poses = [start_pose(world, rng) for _ in range(n)]
    drawn = np.array([(pose.x, pose.y, pose.yaw) for pose in poses])
    if config.start == "either":
        there = rng.random(n) < 0.5
        drawn[there] = anywhere_poses(world, robot, rng, int(there.sum()), config.anywhere_yaw_rad)
    return drawn


def start_pose(world: World, rng: np.random.Generator) -> Pose2:
    """Draw a pose from the world's start range, uniform in the start pose's own frame."""
    start = world.start
    half_range = np.array([start.range_x_m, start.range_y_m, start.range_yaw_rad])
    dx, dy, dyaw = rng.uniform(-half_range, half_range)
    x, y = rotation_2d(start.pose.yaw) @ (dx, dy)
    return Pose2(start.pose.x + x, start.pose.y + y, start.pose.yaw + dyaw)


def anywhere_poses(
    world: World, robot: RobotModel, rng: np.random.Generator, n: int, yaw_rad: float = EpisodeConfig.anywhere_yaw_rad
) -> NDArray[np.float64]:
    """Draw (n, 3) free poses (x, y in m, yaw in rad) along the centre line before the exit, within a yaw of the path.

    Raises:
        WorldError: the world has no centre line, or no free pose was found on it.
    """
    line = world.centre_line
    if len(line) < 2:
        raise WorldError(f"world {world.name!r} has no centre line, so start='anywhere' cannot be used; use 'start'")
    inside = np.flatnonzero(shapely.intersects_xy(world.free_space, *line[1:].T))
    if not len(inside):
        raise WorldError(f"world {world.name!r}: its centre line never enters the free space; use start='start'")
    outline = shapely.Polygon(robot.footprint_base).buffer(ANYWHERE_MARGIN_M, join_style="mitre")
    corners = np.asarray(outline.exterior.coords)
    shapely.prepare(world.walls)
    found: list[NDArray[np.float64]] = []
    for _ in range(ANYWHERE_TRIES):
        i = inside[rng.integers(len(inside), size=n)]
        heading = np.arctan2(*(line[i + 1] - line[i]).T[::-1])
        side = rng.uniform(-0.3, 0.3, n) * np.maximum(world.widths_m[i] - 0.6, 0.0)
        x, y = line[i].T + side * np.stack([-np.sin(heading), np.cos(heading)])
        poses = np.stack([x, y, heading + rng.uniform(-yaw_rad, yaw_rad, n)], axis=1)
        free = ~shapely.intersects(shapely.polygons(to_world_all(corners, poses)), world.walls)
        found.append(poses[free])
        if sum(map(len, found)) >= n:
            return np.concatenate(found)[:n]
    raise WorldError(f"world {world.name!r}: no free poses along the centre line in {ANYWHERE_TRIES} tries")


class EpisodeRules:
    """Watches the episodes of N cars and says when each is over.

    A car is out once its lidar has crossed the open-space line, between its ends, from within; until it comes back.
    In a world with gates instead of such a line its middle must reach them one after the other, and open space is
    nothing that it could mistake for the exit. Who drives a lap the wrong way loses gates again.

    Args:
        config: the rules.
        robot: where its lidar is.
        poses: (N, 3) x, y in m and yaw in rad, whose library and device do the arithmetic; the cars begin there.
    """

    def __init__(self, config: EpisodeConfig, robot: RobotModel, poses: Array) -> None:
        self._config = config
        self._lidar_xy = tuple(map(float, robot.lidar_xyz_base[:2]))
        xp = self._xp = namespace(poses)
        n, alike = len(poses), {"dtype": poses.dtype, "device": device_of(poses)}
        self._line = xp.full((n, 2, 2), math.nan, **alike)
        self._max_steps = xp.full((n,), config.max_steps, dtype=xp.int32, device=device_of(poses))
        self._step = xp.zeros((n,), dtype=xp.int32, device=device_of(poses))
        self._out = xp.zeros((n,), dtype=xp.bool, device=device_of(poses))
        self._checked = xp.zeros((n, 2), **alike)
        self._past = xp.zeros((n,), **alike)
        self._gates: dict[str, Array] = {}

    def begin(self, cars: Array, poses: Array, open_lines: Array, max_steps: Array, gates: Array | None = None) -> None:
        """Begin an episode of some cars.

        Args:
            cars: (K,) which of the N cars.
            poses: (K, 3), where they begin.
            open_lines: (K, 2, 2) m, the open-space lines of their worlds in the frame of the poses, the way out to the
                right from first end to second; nan where a world has none.
            max_steps: (K,) their time-outs in control steps.
            gates: (K, GATES, 2, 2) m, the gates of their worlds in the frame of the poses, nan where there is none;
                None where no world has any.
        """
        self._line[cars], self._max_steps[cars] = open_lines, max_steps
        self._step[cars], self._checked[cars] = 0, poses[:, :2]
        # The middle of the car begins within; its lidar, ahead of it, may already have crossed the line.
        within = self._beyond(poses[:, :2], open_lines)[0] <= 0
        past, between = self._beyond(self._lidar(poses), open_lines)
        self._past[cars], self._out[cars] = past, within & (past > 0) & between
        if gates is not None:
            self._begin_gates(cars, poses, gates)
        elif self._gates:
            self._gates["gates"][cars] = math.nan

    def judge(self, poses: Array, contact: Array, collision: Array, open_width_m: Array) -> Array:
        """Return the (N,) int8 codes of the outcomes after a control step; collision comes before open space.

        Args:
            poses: (N, 3).
            contact: (N,) whether the body touched a wall.
            collision: (N,) whether the safety region reports one.
            open_width_m: (N,) V_left + V_right: all that the car itself can know of the exit.
        """
        xp, config = self._xp, self._config
        self._step += 1
        past = self._follow(poses)
        checks = self._step % config.stall_steps == 0
        moved = xp.hypot(poses[:, 0] - self._checked[:, 0], poses[:, 1] - self._checked[:, 1])
        self._checked[...] = xp.where(checks[:, None], poses[:, :2], self._checked)
        code = xp.zeros(contact.shape, dtype=xp.int8, device=device_of(contact))
        code = xp.where(self._step >= self._max_steps, _CODES[Outcome.TIMEOUT], code)
        code = xp.where(checks & (moved < config.stall_distance_m), _CODES[Outcome.STALL], code)
        sees_open = open_width_m > config.open_width_m
        heads_for_gate, there = self._follow_gates(poses)
        code = xp.where(sees_open & ~heads_for_gate, _CODES[Outcome.FALSE_EXIT], code)
        is_out = self._out & (sees_open | (past >= config.out_m))
        code = xp.where(is_out | there, _CODES[Outcome.SUCCESS], code)
        return xp.where(contact | collision, _CODES[Outcome.COLLISION], code)

    def state(self) -> dict[str, Array]:
        """Return the arrays that say where every episode stands, by name; not copies."""
        return {
            **{"line": self._line, "max_steps": self._max_steps, "step": self._step},
            **{"out": self._out, "checked": self._checked, "past": self._past},
            **self._gates,
        }

    def _begin_gates(self, cars: Array, poses: Array, gates: Array) -> None:
        if not self._gates:
            xp, n = self._xp, len(self._line)
            alike = {"dtype": poses.dtype, "device": device_of(poses)}
            self._gates = {
                "gates": xp.full((n, GATES, 2, 2), math.nan, **alike),
                "last_xy": xp.zeros((n, 2), **alike),
                "n_reached": xp.zeros((n,), dtype=xp.int32, device=device_of(poses)),
            }
        self._gates["gates"][cars], self._gates["last_xy"][cars] = gates, poses[:, :2]
        self._gates["n_reached"][cars] = 0

    def _follow_gates(self, poses: Array) -> tuple[Array, Array]:
        """Return (N,) which cars drive to gates, and which have reached their last one."""
        xp = self._xp
        if not self._gates:
            nowhere = xp.zeros(self._out.shape, dtype=xp.bool, device=device_of(self._out))
            return nowhere, nowhere
        gates, last, n_reached = (self._gates[name] for name in ("gates", "last_xy", "n_reached"))
        each = xp.arange(len(gates), device=device_of(n_reached))
        now = poses[:, :2]
        ahead = self._meets(gates[each, n_reached % GATES], last, now)
        behind = self._meets(gates[each, (n_reached - 2) % GATES], last, now)
        n_reached[...] = n_reached + xp.where(ahead, 1, xp.where(behind, -1, 0))
        last[...] = now
        n_gates = (gates[:, :, 0, 0] == gates[:, :, 0, 0]).sum(-1)  # nan differs from itself
        return n_gates > 0, (n_gates > 0) & (n_reached >= n_gates)

    def _meets(self, gate: Array, last: Array, now: Array) -> Array:
        """Return which of N moves from (N, 2) to (N, 2) cross their (N, 2, 2) line, or end near where it is a point."""
        a, b = gate[:, 0], gate[:, 1]
        crosses = ((_side(a, b, last) > 0) != (_side(a, b, now) > 0)) & (_side(last, now, a) * _side(last, now, b) <= 0)
        is_point = (a == b).all(-1)
        away = now - a
        return crosses | (is_point & (self._xp.hypot(away[:, 0], away[:, 1]) <= REACHED_M))

    def _follow(self, poses: Array) -> Array:
        """Note which cars have crossed their line, and return how far past it, in m, each lidar is."""
        past, between = self._beyond(self._lidar(poses), self._line)
        crossed = (past > 0) != (self._past > 0)
        self._out[...] = self._xp.where(crossed & between, past > 0, self._out)
        self._past[...] = past
        return past

    def _lidar(self, poses: Array) -> Array:
        """Return the (K, 2) positions in m of the lidars of cars at (K, 3) poses."""
        xp = self._xp
        c, s, (x, y) = xp.cos(poses[:, 2]), xp.sin(poses[:, 2]), self._lidar_xy
        return xp.stack([poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y], axis=-1)

    def _beyond(self, points: Array, lines: Array) -> tuple[Array, Array]:
        """Return how far in m (K, 2) points are past their (K, 2, 2) lines, and whether between the ends of these."""
        from_end, along = points - lines[:, 0], lines[:, 1] - lines[:, 0]
        length = self._xp.hypot(along[:, 0], along[:, 1])
        past = (along[:, 1] * from_end[:, 0] - along[:, 0] * from_end[:, 1]) / length
        at = (along[:, 0] * from_end[:, 0] + along[:, 1] * from_end[:, 1]) / length
        return past, (at > -LINE_MARGIN_M) & (at < length + LINE_MARGIN_M)


def _side(a: Array, b: Array, point: Array) -> Array:
    """Return (N,) twice the areas of triangles: above 0 where the point is to the left of the way from a to b."""
    along, to = b - a, point - a
    return along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0]


def gates_of(worlds: Sequence[World]) -> NDArray[np.float64] | None:
    """Return the (W, GATES, 2, 2) gates of worlds, world frame, nan where there is none; None if no world has any."""
    if not any(len(world.gates) for world in worlds):
        return None
    made = np.full((len(worlds), GATES, 2, 2), np.nan)
    for row, world in zip(made, worlds, strict=True):
        row[: len(world.gates)] = world.gates
    return made


def open_lines(worlds: Sequence[World]) -> NDArray[np.float64]:
    """Return the (W, 2, 2) open-space lines of worlds, world frame, nan where there is none."""
    none = np.full((2, 2), np.nan)
    return np.stack([none if world.open_line is None else world.open_line for world in worlds])
