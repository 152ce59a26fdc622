"""Proof that a car can drive out of a world: a path that anyone can check, and a bound that no drive can beat."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.assets import find_asset
from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.config_text import read_config
from zebrat_bullet.errors import PlanError, WorldError
from zebrat_bullet.geometry import rotation_2d
from zebrat_bullet.planning.arc_path import ArcPath, axle_pose, clearances, sweep_factor
from zebrat_bullet.planning.grid import inscribed_radius_m
from zebrat_bullet.planning.shortest_path import shortest_length_m
from zebrat_bullet.robot import RobotModel, within_limits
from zebrat_bullet.values import of_kind
from zebrat_bullet.world import World
from zebrat_bullet.world.fingerprint import digest, rounded, rounded_rings, rounded_start

CLOSELY_M = 1e-4
"""How closely the clearance of a path is known."""
# Its first samples.
_SAMPLE_M = 0.1
# Points of the straight from axle to lidar.
_PARTS = np.linspace(0.0, 1.0, 65).tolist()
# Poses are written to a micrometre; a path may be beside its arcs, and the bound be off, by what that rounds.
_DIGITS = 6
_TOLERANCE = 1e-5


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """A drive out of a world.

    Attributes:
        world: its name.
        sha256: of the walls, start and exit of the world and of the numbers of the robot; another geometry has another.
        path: (x, y, yaw) of the rear axle in m and rad, world frame, yaw continuous. Each pose is joined to the next by
            one circular arc or straight of less than half a turn.
        directions: 1 where the car drives forward to the next pose, -1 where it reverses; one fewer than poses.
        n_reversals: changes between forward and backward. As few as the search found: another drive may need fewer.
        length_m: length of the path.
        clearance_m: no point of the footprint comes nearer to a wall, anywhere on the path, between samples too. Not
            less than the margin asked for, unless `start_clearance_m` is; then at least four tenths of that, and
            the margin is kept from 2 m of driving on.
        start_clearance_m: distance from the footprint to the walls where the path begins.
        shortest_m: no drive from the middle of the start range brings the lidar over the open-space line with less
            driven by the rear axle, however often it reverses. It bounds the way of discs that the footprint holds,
            about the axle and ahead of it; a car that cannot turn on the spot needs more, in sharp corners and U-turns
            most.
        least_time_s: `shortest_m` at full speed, from the first metre on.
    """

    world: str
    sha256: str
    path: tuple[tuple[float, float, float], ...]
    directions: tuple[int, ...]
    n_reversals: int
    length_m: float
    clearance_m: float
    start_clearance_m: float
    shortest_m: float
    least_time_s: float


def certificate_of(found: ArcPath, world: World, robot: RobotModel, physics: PhysicsConfig) -> Certificate:
    """Return the certificate that a drive out of a world is.

    Raises:
        PlanError: it is none; the message says why.
        WorldError: the world declares no exit.
    """
    shortest = _shortest_m(world, robot, open_line_of(world), physics)
    path = ArcPath(found.poses_world.round(_DIGITS), found.directions)
    clearance = guaranteed_clearance_m(path, world.walls, robot)
    certificate = Certificate(
        world=world.name,
        sha256=_digest(world, robot, physics),
        path=tuple(tuple(pose) for pose in path.poses_world.tolist()),
        directions=tuple(path.directions.tolist()),
        n_reversals=path.n_reversals,
        length_m=round(float(path.lengths_m.sum()), 3),
        clearance_m=math.floor(clearance * 1e4) / 1e4,
        start_clearance_m=_start_clearance_m(path, world, robot),
        shortest_m=round(shortest, 3),
        least_time_s=round(shortest / physics.max_speed_mps, 2),
    )
    _check(world, robot, certificate, physics, shortest, clearance)
    return certificate


def check_certificate(
    world: World, robot: RobotModel, certificate: Certificate, physics: PhysicsConfig | None = None
) -> None:
    """Verify that a certificate proves what it says; needs no search.

    Raises:
        PlanError: it does not; the message says what is wrong.
        WorldError: the world declares no exit.
    """
    physics = within_limits(physics or PhysicsConfig(), robot)
    shortest = _shortest_m(world, robot, open_line_of(world), physics)
    _check(world, robot, certificate, physics, shortest)


def guaranteed_clearance_m(path: ArcPath, walls: shapely.MultiPolygon, robot: RobotModel) -> float:
    """Return a distance to the walls that the footprint keeps on the whole path, between samples too; 0 for a contact.

    Between two samples no point of the footprint comes nearer than half their distances less half of what it moves.
    Samples are added where that leaves the least distance open by more than 0.1 mm.
    """
    _, arcs = path.sample(_SAMPLE_M)
    begins, lengths = path.poses_world[:1], path.lengths_m
    if not len(lengths):
        return float(clearances(begins, robot, walls)[0])
    arcs = arcs[1:]
    first = np.concatenate([[True], np.diff(arcs) > 0])
    parts = np.bincount(arcs)[arcs]
    index = np.arange(len(arcs)) - np.maximum.accumulate(np.where(first, np.arange(len(arcs)), 0))
    low, high = lengths[arcs] * index / parts, lengths[arcs] * (index + 1) / parts
    sweep = np.array([sweep_factor(robot, curvature) for curvature in path.curvatures])
    gap_low, gap_high = (clearances(path.at(arcs, at), robot, walls) for at in (low, high))
    least, sure = min(gap_low.min(), gap_high.min()), np.inf
    while len(arcs):
        bound = (gap_low + gap_high - sweep[arcs] * (high - low)) / 2.0
        open_ = bound < least - CLOSELY_M
        sure = min(sure, bound[~open_].min(initial=np.inf))
        arcs, low, high, gap_low, gap_high = (x[open_] for x in (arcs, low, high, gap_low, gap_high))
        middle = (low + high) / 2.0
        gap = clearances(path.at(arcs, middle), robot, walls)
        least = min(least, gap.min(initial=np.inf))
        arcs, low, high = np.tile(arcs, 2), np.concatenate([low, middle]), np.concatenate([middle, high])
        gap_low, gap_high = np.concatenate([gap_low, gap]), np.concatenate([gap, gap_high])
    return max(0.0, float(min(sure, least)))


def load_certificate(name_or_path: str) -> Certificate:
    """Read the certificate of a shipped world by the world's name, or any by path.

    Raises:
        AssetError: there is none.
        ConfigError: the file is not a certificate.
    """
    return read_config(Certificate, find_asset("worlds/certificates", name_or_path, ".json"))


def save_certificate(certificate: Certificate, folder: Path) -> Path:
    """Write a certificate as `folder`/WORLD.json, a pose a line, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    fields = asdict(certificate)
    fields["path"] = [f"@{i}" for i in range(len(certificate.path))]
    text = json.dumps(fields, indent=1)
    for i, pose in enumerate(certificate.path):
        text = text.replace(f'"@{i}"', json.dumps(pose))
    path = folder / f"{certificate.world}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def open_line_of(world: World) -> NDArray[np.float64]:
    """Return the (2, 2) open-space line of a world that can be certified.

    Raises:
        ConfigError: it is no world.
        WorldError: it declares no exit.
    """
    of_kind(world, World, "a world", "give load_world(...)")
    if world.open_line is None or not len(world.waypoints):
        raise WorldError(f"{world.name} declares no exit to be certified; give it an open_line and waypoints")
    return world.open_line


def _check(
    world: World,
    robot: RobotModel,
    certificate: Certificate,
    physics: PhysicsConfig,
    shortest: float,
    clearance: float | None = None,
) -> None:
    """Check a certificate; its path's clearance is measured unless it is given."""
    if certificate.sha256 != _digest(world, robot, physics):
        raise PlanError(
            f"{certificate.world}: the world, the robot or its limits are not those certified; certify anew"
        )
    path = ArcPath(np.array(certificate.path, float).reshape(-1, 3), np.array(certificate.directions, dtype=np.int64))
    if len(path.poses_world) != len(path.directions) + 1 or not set(certificate.directions) <= {1, -1}:
        raise PlanError(f"{certificate.world}: the path needs a direction, 1 or -1, from each pose to the next")
    if clearance is None:
        clearance = guaranteed_clearance_m(path, world.walls, robot)
    start_clearance = _start_clearance_m(path, world, robot)
    most = math.tan(physics.max_steering_rad) / robot.wheelbase_m
    for holds, what in [
        (_in_start_range(world, robot, path.poses_world[0]), "does not begin in the start range"),
        (path.lateral_errors_m().max(initial=0.0) < _TOLERANCE, "has poses that no arc joins"),
        (np.abs(path.turns_rad).max(initial=0.0) < math.pi, "has an arc of half a turn or more"),
        (np.abs(path.curvatures).max(initial=0.0) <= most, "bends more than the car can steer"),
        (clearance > 0.0, "comes too near to a wall to be shown free"),
        (world.past_open_line(*_lidar_xy(path.poses_world[-1], robot)), "does not bring the lidar past the open line"),
        (certificate.n_reversals == path.n_reversals, "has another number of reversals"),
        (abs(certificate.length_m - path.lengths_m.sum()) < 1e-3, "has another length"),
        (0.0 <= clearance - certificate.clearance_m < 1e-3, f"has another clearance, {clearance:.4f} m"),
        (abs(certificate.start_clearance_m - start_clearance) < 1e-3, "has another clearance where it starts"),
        (abs(certificate.shortest_m - shortest) < 1e-3, f"has another lower bound, {shortest:.3f} m"),
        (abs(certificate.least_time_s - shortest / physics.max_speed_mps) < 0.01, "has another least time"),
    ]:
        if not holds:
            raise PlanError(f"{certificate.world}: the certified path {what}; certify the world anew")


def _start_clearance_m(path: ArcPath, world: World, robot: RobotModel) -> float:
    return math.floor(float(clearances(path.poses_world[:1], robot, world.walls)[0]) * 1e4) / 1e4


def _shortest_m(world: World, robot: RobotModel, open_line: NDArray[np.float64], physics: PhysicsConfig) -> float:
    """Return a lower bound for how far the rear axle must drive before the lidar is over the line.

    The best of what holds for two points of the straight from axle to lidar: the axle itself, and the nearest point to
    it about which the footprint holds the largest disc.
    """
    radii = [_radius_m(robot, part) for part in _PARTS]
    widest = int(np.argmax(np.array(radii) >= max(radii) - 1e-9))
    return max(_least_drive_m(world, robot, open_line, physics, radii, first) for first in sorted({0, widest}))


def _least_drive_m(
    world: World,
    robot: RobotModel,
    open_line: NDArray[np.float64],
    physics: PhysicsConfig,
    radii: Sequence[float],
    first: int,
) -> float:
    """Return the lower bound that follows from the disc about the `first` of the parts of the straight axle to lidar.

    The footprint holds this disc about every point of the straight from the first towards the lidar as far as that
    lies deep enough inside. The first point's way and this straight together are a way of that disc, however often the
    car reverses; it ends short of the line by the rest of the straight, and so crosses the line drawn that much nearer.
    The first point moves faster than the axle, but by no more than in the tightest turn.
    """
    lidar = robot.lidar_xyz_base[:2] - (robot.rear_axle_x_m, 0.0)
    last = max(k for k in range(first, len(_PARTS)) if min(radii[first : k + 1]) >= radii[first] - 1e-9)
    swept, short = (_PARTS[last] - _PARTS[first]) * np.hypot(*lidar), (1.0 - _PARTS[last]) * np.hypot(*lidar)
    along = (open_line[1] - open_line[0]) / math.dist(*open_line)
    # The way out is to the right of the line. Its ends stand at walls; drawn nearer, it may have further to go to them.
    nearer = open_line + short * np.array([-along[1], along[0]])
    nearer = nearer + np.outer([-1.0, 1.0], radii[first] * along)
    axle, point = axle_pose(world.start.pose, robot), _PARTS[first] * lidar
    start = axle[:2] + rotation_2d(axle[2]) @ point
    curvature = math.tan(physics.max_steering_rad) / robot.wheelbase_m
    faster = math.hypot(1.0 + curvature * abs(point[1]), curvature * point[0])
    return max(0.0, (shortest_length_m(world.walls, start, nearer, radii[first]) - float(swept)) / faster)


def _radius_m(robot: RobotModel, part: float) -> float:
    """Return the radius of the largest disc in the footprint about a part of the straight from axle to lidar."""
    axle = np.array([robot.rear_axle_x_m, 0.0])
    return inscribed_radius_m(robot.footprint_base, axle + part * (robot.lidar_xyz_base[:2] - axle))


def _in_start_range(world: World, robot: RobotModel, axle: Sequence[float] | NDArray[np.float64]) -> bool:
    start = world.start
    base = np.array(axle[:2]) - robot.rear_axle_x_m * np.array([math.cos(axle[2]), math.sin(axle[2])])
    dx, dy = rotation_2d(-start.pose.yaw) @ (base - (start.pose.x, start.pose.y))
    off = np.abs([dx, dy, axle[2] - start.pose.yaw])
    return bool((off <= np.array([start.range_x_m, start.range_y_m, start.range_yaw_rad]) + _TOLERANCE).all())


def _lidar_xy(axle: NDArray[np.float64], robot: RobotModel) -> NDArray[np.float64]:
    return axle[:2] + rotation_2d(axle[2]) @ (robot.lidar_xyz_base[:2] - (robot.rear_axle_x_m, 0.0))


def _digest(world: World, robot: RobotModel, physics: PhysicsConfig) -> str:
    """Return the SHA-256 of all numbers that a certificate rests on, to a micrometre."""
    return digest(
        [
            rounded_rings(world.walls),
            rounded(world.open_line),
            rounded_start(world.start),
            rounded(robot.footprint_base),
            rounded([robot.wheelbase_m, robot.rear_axle_x_m, *robot.lidar_xyz_base[:2]]),
            rounded([physics.max_steering_rad, physics.max_speed_mps]),
        ]
    )
