"""Refuses worlds that cannot be driven, or in which the car would believe itself outside too early."""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import EpisodeConfig, LidarConfig
from zebrat_bullet.errors import WorldError
from zebrat_bullet.geometry import to_world, wall_segments
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.clearance import check_clearance
from zebrat_bullet.world.free_start import free_start
from zebrat_bullet.world.goal import REACHED_M
from zebrat_bullet.world.solid import is_watertight
from zebrat_bullet.world.world import Start, World

OPEN_WIDTH_M = EpisodeConfig.open_width_m
SCAN_RANGE_M = LidarConfig.range_max_m
# The rule must hold while the car looks this far to either side of its path ...
_LOOK_ASIDE_RAD = np.radians(np.arange(-45.0, 45.1, 5.0))
# ... and must fire before the lidar is this far past the line.
_FIRE_WITHIN_M = 1.0
# A lidar this near the line counts as on it.
_ON_LINE_M = 0.01
# So many poses are checked in one go: enough to amortise the call, few enough to keep the arrays in the cache.
_CHUNK = 64
# A corner of a cell that the car overlaps may be a rounding error.
_LEAST_UNKNOWN_M2 = 1e-4
# So far round the walls the way to a goal may lead.
_ROUND_WALLS_M = 3.0


def validate_world(world: World, robot: RobotModel, source: str) -> None:
    """Check that the robot can start in a world, pass through it, and know when it is out: once for the same robot.

    Args:
        world: what was built.
        robot: its footprint must pass, at the height of its body; its lidar watches for open space.
        source: the file, for the message.

    Raises:
        WorldError: names the file, the field and the remedy.
    """
    outline, lidar = robot.footprint_base.tobytes(), robot.lidar_xyz_base.tobytes()
    measures = (outline, lidar, robot.body_bottom_m, robot.body_top_m)
    if world.valid_for == measures:
        return
    if len(world.centre_line):
        _check_width(world, robot, source)
    _check_start(world, robot, source)
    if len(world.centre_line):
        _check_way_out(world, robot, source)
    if len(world.gates):
        _check_gates(world, robot, source)
    if len(world.centre_line) and world.open_line is not None:
        _check_open_space(world, world.open_line, robot, source)
    check_clearance(world, robot, source)
    # A mark on what is frozen: it says nothing of the place, but that all this need not be done again.
    object.__setattr__(world, "valid_for", measures)


def check_closed(world: World, source: str) -> None:
    """Refuse a world whose mesh has holes.

    Raises:
        WorldError: names the file and the remedy.
    """
    if not is_watertight(world.mesh):
        raise WorldError(
            f"{source}: mesh: some wall or obstacle touches itself in a single point, so its mesh is not watertight; "
            "move a corner there by a centimetre"
        )


def start_area(start: Start, footprint_base: NDArray[np.float64]) -> shapely.Polygon:
    """Return the ground that a (K, 2) footprint can cover at any pose of a start's random range."""
    pose, rx, ry = start.pose, start.range_x_m, start.range_y_m
    shifts = np.array([[sx * rx, sy * ry] for sx in (-1, 1) for sy in (-1, 1)])
    hulls = []
    for turn in np.linspace(-start.range_yaw_rad, start.range_yaw_rad, 5):
        turned = to_world(footprint_base, Pose2(0.0, 0.0, float(turn)))
        moved = (turned[None] + shifts[:, None]).reshape(-1, 2)
        hulls.append(shapely.MultiPoint(to_world(moved, pose)).convex_hull)
    return shapely.union_all(hulls)


def stands_free(world: World, footprint_base: NDArray[np.float64]) -> bool:
    """Return whether a (K, 2) footprint stands on known free ground at every pose of the start's random range."""
    area = start_area(world.start, footprint_base)
    return _is_on_floor(world, area) and not _is_on_unknown(world, area)


def _is_on_floor(world: World, area: shapely.Polygon) -> bool:
    # Only where it is close: to widen the floor of a large map takes long.
    on_floor = world.free_space.contains(area) or world.free_space.buffer(1e-6).contains(area)
    return bool(on_floor and not area.intersects(world.walls))


def _is_on_unknown(world: World, area: shapely.Polygon) -> bool:
    return bool(area.intersection(world.unknown_ground).area > _LEAST_UNKNOWN_M2)


def _check_start(world: World, robot: RobotModel, source: str) -> None:
    area, pose = start_area(world.start, robot.footprint_base), world.start.pose
    if not _is_on_floor(world, area):
        raise WorldError(
            f"{source}: start: at ({pose.x:.2f}, {pose.y:.2f}) the car stands in a wall or outside the free space for "
            "some pose of its random range; move the start or make start.range_x_m, range_y_m, range_yaw_rad smaller"
            f"{_free_start(world, robot)}",
            at=(pose.x, pose.y),
        )
    if _is_on_unknown(world, area):
        raise WorldError(
            f"{source}: start: at ({pose.x:.2f}, {pose.y:.2f}) the car stands on unknown ground of the map; move the "
            f"start to where it is mapped, or say `unknown: free` in a world file{_free_start(world, robot)}"
        )


def _free_start(world: World, robot: RobotModel) -> str:
    free = free_start(world, robot.footprint_base)
    extents = "x {:.2f} to {:.2f}, y {:.2f} to {:.2f} m".format(*np.array(world.walls.bounds)[[0, 2, 1, 3]])
    if free is None:
        return f". Nowhere among its walls ({extents}) does a car of this size fit"
    degrees = round(math.degrees(free.yaw))
    return (
        f". It would stand free at ({free.x:.2f}, {free.y:.2f}), looking along {degrees} degrees: "
        f"--start {free.x:.2f} {free.y:.2f} {degrees}; the walls reach from {extents}"
    )


def _check_gates(world: World, robot: RobotModel, source: str) -> None:
    """Refuse a goal that cannot be reached, or that is reached before anyone drives."""
    goal, begin = shapely.LineString(world.gates[-1]), shapely.Point(world.start.pose.x, world.start.pose.y)
    strays = math.hypot(world.start.range_x_m, world.start.range_y_m)
    is_point = goal.length == 0
    if len(world.gates) == 1 and is_point and goal.distance(begin) <= REACHED_M + strays:
        raise WorldError(f"{source}: goal: the car already begins within {REACHED_M} m of it; move goal or start apart")
    if not is_point:
        length = goal.length
        if length < float(np.ptp(robot.footprint_base[:, 1])):
            raise WorldError(
                f"{source}: goal: its line is {length:.2f} m long, shorter than the car is wide; lengthen it"
            )
    half_width = float(np.ptp(robot.footprint_base[:, 1])) / 2
    whole = shapely.GeometryCollection([world.walls, goal, begin])
    floor = whole.envelope.buffer(_ROUND_WALLS_M, join_style="mitre").difference(world.walls)
    room = shapely.get_parts(floor.buffer(-0.99 * half_width, quad_segs=4))
    near_start = begin.buffer(half_width)
    shapely.prepare(near_start)
    here = [part for part in room if part.intersects(near_start)]
    for gate in world.gates:
        line = shapely.LineString(gate)
        if not any(part.distance(line) <= (REACHED_M if line.length == 0 else 0.0) for part in here):
            x, y = gate.mean(axis=0)
            raise WorldError(
                f"{source}: goal: ({x:.2f}, {y:.2f}) is in a wall, or no way as wide as the car "
                f"({2 * half_width:.2f} m) leads there from the start; move it or open the way"
            )


def _check_width(world: World, robot: RobotModel, source: str) -> None:
    car_width = float(np.ptp(robot.footprint_base[:, 1]))
    narrow = int(np.argmin(world.widths_m))
    width = float(world.widths_m[narrow])
    x, y = world.centre_line[narrow]
    if width <= car_width:
        raise WorldError(
            f"{source}: width: the passage at ({x:.2f}, {y:.2f}) is {width:.2f} m wide and the car {car_width:.2f} m; "
            "widen that segment or move the obstacle there",
            at=(float(x), float(y)),
        )


def _check_way_out(world: World, robot: RobotModel, source: str) -> None:
    car_width = float(np.ptp(robot.footprint_base[:, 1]))
    room = shapely.get_parts(world.free_space.buffer(-car_width / 2))
    begin = world.start.pose
    near_start = shapely.Point(begin.x, begin.y).buffer(car_width)
    way_out = shapely.LineString(world.open_line).buffer(car_width) if world.open_line is not None else near_start
    if not any(part.intersects(near_start) and part.intersects(way_out) for part in room):
        raise WorldError(
            f"{source}: width: somewhere between start and open_line the passage is narrower than the car "
            f"({car_width:.2f} m); widen it or move an obstacle"
        )


def _check_open_space(world: World, open_line: NDArray[np.float64], robot: RobotModel, source: str) -> None:
    seen = world.walls if world.low_obstacles.is_empty else world.walls.difference(world.low_obstacles)
    segments = wall_segments(seen)
    early = open_space_too_early(world, open_line, robot)
    if early is not None:
        raise WorldError(
            f"{source}: open_line: open space (left + right > {OPEN_WIDTH_M} m) is already seen at "
            f"({early[0]:.2f}, {early[1]:.2f}), before the line; close gaps in the walls, narrow "
            "the passage there, or give it a goal, which then decides",
            at=(float(early[0]), float(early[1])),
        )
    exit_yaw = _headings(world.centre_line)[-1]
    past = shapely.LineString(world.centre_line).difference(world.free_space.buffer(_ON_LINE_M))
    if past.buffer(float(np.ptp(robot.footprint_base[:, 1])) / 2).intersects(world.walls):
        raise WorldError(
            f"{source}: open_line: a wall stands in the way out between the line and the end of the centre line; "
            "open the exit there or lead it elsewhere",
            at=(float(open_line[:, 0].mean()), float(open_line[:, 1].mean())),
        )
    out = np.array([math.cos(exit_yaw), math.sin(exit_yaw)])
    lidar = open_line.mean(axis=0) + np.linspace(0.05, _FIRE_WITHIN_M, 20)[:, None] * out
    if not (open_width(lidar, np.full(20, exit_yaw), segments) > OPEN_WIDTH_M).any():
        raise WorldError(
            f"{source}: open_line: within {_FIRE_WITHIN_M} m past the line left + right stays under {OPEN_WIDTH_M} m, "
            "so no car would know that it is out; move walls and obstacles away from the exit",
            at=(float(open_line[:, 0].mean()), float(open_line[:, 1].mean())),
        )


def open_space_too_early(world: World, open_line: NDArray[np.float64], robot: RobotModel) -> NDArray[np.float64] | None:
    """Return a (2,) position of the lidar before the open-space line where open space is seen, or None."""
    low = world.low_obstacles
    return _first_early(
        world, open_line, world.walls if low.is_empty else world.walls.difference(low), float(robot.lidar_xyz_base[0])
    )


def _first_early(
    world: World, open_line: NDArray[np.float64], seen: shapely.Geometry, ahead_m: float
) -> NDArray[np.float64] | None:
    """Return a lidar position before the open-space line where open space is seen, or None."""
    line = world.centre_line
    yaws = _headings(line)[:, None] + _LOOK_ASIDE_RAD
    lidar = line[:, None] + ahead_m * np.stack([np.cos(yaws), np.sin(yaws)], axis=-1)
    before = world.free_space.difference(_exit_gate(open_line, _ON_LINE_M))
    shapely.prepare(before)
    inside = shapely.contains_xy(before, lidar[..., 0], lidar[..., 1])
    at, yaw = lidar[inside], yaws[inside]
    # Both sides must be free for the sum to pass the threshold; so look near first, and far only if need be.
    aside = (OPEN_WIDTH_M - SCAN_RANGE_M) * np.column_stack([-np.sin(yaw), np.cos(yaw)])
    shapely.prepare(seen)
    free = ~shapely.intersects(seen, shapely.linestrings(np.stack([at - aside, at + aside], axis=1)))
    at, yaw = at[free], yaw[free]
    segments = wall_segments(seen)
    for begin in range(0, len(at), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        early = at[part][open_width(at[part], yaw[part], segments) > OPEN_WIDTH_M]
        if len(early):
            first: NDArray[np.float64] = early[0]
            return first
    return None


def _exit_gate(open_line: NDArray[np.float64], reach_m: float) -> shapely.Polygon:
    return shapely.LineString(open_line).buffer(reach_m, cap_style="flat")


def open_width(
    lidar: NDArray[np.float64], yaw: NDArray[np.float64], segments: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return V_left + V_right, each clipped at the lidar's reach, for (N, 2) positions and (N,) headings."""
    total: NDArray[np.float64] = side_ranges(lidar, yaw, segments, SCAN_RANGE_M).sum(axis=0)
    return total


def side_ranges(
    lidar: NDArray[np.float64], yaw: NDArray[np.float64], segments: NDArray[np.float64], range_max_m: float
) -> NDArray[np.float64]:
    """Return (2, N) ranges to the left and to the right."""
    left = np.column_stack([-np.sin(yaw), np.cos(yaw)])
    a, edge = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = a[None] - lidar[:, None]
    cross = left[:, None, 0] * edge[None, :, 1] - left[:, None, 1] * edge[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (offset[..., 0] * edge[None, :, 1] - offset[..., 1] * edge[None, :, 0]) / cross
        part = (offset[..., 0] * left[:, None, 1] - offset[..., 1] * left[:, None, 0]) / cross
    hit = (part >= 0.0) & (part <= 1.0)
    ranges: NDArray[np.float64] = np.stack(
        [
            np.where(hit & (sign * along >= 0.0), sign * along, range_max_m).min(axis=1, initial=range_max_m)
            for sign in (1.0, -1.0)
        ]
    )
    return ranges


def _headings(line: NDArray[np.float64]) -> NDArray[np.float64]:
    steps = np.diff(line, axis=0)
    yaws = np.arctan2(steps[:, 1], steps[:, 0])
    return np.append(yaws, yaws[-1])
