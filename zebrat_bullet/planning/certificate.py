"""Proof that a car can drive out of a world: a path that anyone can check, and a bound that no drive can beat."""

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.assets import find_asset
from zebrat_bullet.config import PhysicsConfig, from_json
from zebrat_bullet.errors import PlanError, WorldError
from zebrat_bullet.geometry import rotation_2d
from zebrat_bullet.planning.arc_path import ArcPath, axle_pose, clearances, sweep_factor
from zebrat_bullet.planning.grid import inscribed_radius_m
from zebrat_bullet.planning.hybrid_a_star import HybridAStarConfig, plan_path
from zebrat_bullet.planning.shortest_path import shortest_length_m
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.world import World

_CHECK_M = 0.005
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
        n_reversals: changes between forward and backward.
        length_m: length of the path.
        clearance_m: no point of the footprint comes nearer to a wall, anywhere on the path: the least distance over
            samples at most 5 mm apart, less what a point of the footprint can move between them.
        shortest_m: no drive from the middle of the start range brings the lidar over the open-space line with less
            driven by the rear axle. It bounds the way of a disc about the axle that the footprint holds; a car that
            cannot turn on the spot needs more.
        least_time_s: `shortest_m` at full speed.
    """

    world: str
    sha256: str
    path: tuple[tuple[float, float, float], ...]
    directions: tuple[int, ...]
    n_reversals: int
    length_m: float
    clearance_m: float
    shortest_m: float
    least_time_s: float


def certify(world: World, robot: RobotModel, physics: PhysicsConfig | None = None) -> Certificate:
    """Find a drive out of a world, from the middle of its start range.

    Raises:
        PlanError: the search found none, so the world may be impassable.
        WorldError: the world declares no exit.
    """
    physics = physics or PhysicsConfig()
    open_line = _open_line(world)
    # A hair less than full lock: rounding the poses must not ask for more.
    search = HybridAStarConfig(max_steering_rad=physics.max_steering_rad - 1e-3)
    found = plan_path(world.walls, robot, world.start.pose, world.waypoints[-1], search).path
    path = ArcPath(found.poses_world.round(_DIGITS), found.directions)
    shortest = _shortest_m(world, robot, open_line)
    certificate = Certificate(
        world=world.name,
        sha256=_digest(world, robot, physics),
        path=tuple(tuple(pose) for pose in path.poses_world.tolist()),
        directions=tuple(path.directions.tolist()),
        n_reversals=path.n_reversals,
        length_m=round(float(path.lengths_m.sum()), 3),
        clearance_m=math.floor(guaranteed_clearance_m(path, world.walls, robot) * 1e4) / 1e4,
        shortest_m=round(shortest, 3),
        least_time_s=round(shortest / physics.max_speed_mps, 2),
    )
    check_certificate(world, robot, certificate, physics)
    return certificate


def check_certificate(
    world: World, robot: RobotModel, certificate: Certificate, physics: PhysicsConfig | None = None
) -> None:
    """Verify that a certificate proves what it says; needs no search.

    Raises:
        PlanError: it does not; the message says what is wrong.
        WorldError: the world declares no exit.
    """
    physics = physics or PhysicsConfig()
    shortest = _shortest_m(world, robot, _open_line(world))
    if certificate.sha256 != _digest(world, robot, physics):
        raise PlanError(
            f"{certificate.world}: the world, the robot or its limits are not those certified; certify anew"
        )
    path = ArcPath(np.array(certificate.path, float).reshape(-1, 3), np.array(certificate.directions, dtype=np.int64))
    if len(path.poses_world) != len(path.directions) + 1 or not set(certificate.directions) <= {1, -1}:
        raise PlanError(f"{certificate.world}: the path needs a direction, 1 or -1, from each pose to the next")
    clearance = guaranteed_clearance_m(path, world.walls, robot)
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
        (abs(certificate.shortest_m - shortest) < 1e-3, f"has another lower bound, {shortest:.3f} m"),
        (abs(certificate.least_time_s - shortest / physics.max_speed_mps) < 0.01, "has another least time"),
    ]:
        if not holds:
            raise PlanError(f"{certificate.world}: the certified path {what}; certify the world anew")


def guaranteed_clearance_m(path: ArcPath, walls: shapely.MultiPolygon, robot: RobotModel) -> float:
    """Return a distance to the walls that the footprint keeps on the whole path, between samples too; else below 0."""
    poses, _ = path.sample(_CHECK_M)
    fastest = sweep_factor(robot, np.abs(path.curvatures).max(initial=0.0))
    return float(clearances(poses, robot, walls).min()) - fastest * _CHECK_M / 2.0


def load_certificate(name_or_path: str) -> Certificate:
    """Read the certificate of a shipped world by the world's name, or any by path.

    Raises:
        AssetError: there is none.
        ConfigError: the file is not a certificate.
    """
    return from_json(Certificate, find_asset("worlds/certificates", name_or_path, ".json").read_text())


def save_certificate(certificate: Certificate, folder: Path) -> Path:
    """Write a certificate as `folder`/WORLD.json, a pose a line, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    fields = asdict(certificate)
    fields["path"] = [f"@{i}" for i in range(len(certificate.path))]
    text = json.dumps(fields, indent=1)
    for i, pose in enumerate(certificate.path):
        text = text.replace(f'"@{i}"', json.dumps(pose))
    path = folder / f"{certificate.world}.json"
    path.write_text(text + "\n")
    return path


def _open_line(world: World) -> NDArray[np.float64]:
    if world.open_line is None or not len(world.waypoints):
        raise WorldError(f"{world.name} declares no exit to be certified; give it an open_line and waypoints")
    return world.open_line


def _shortest_m(world: World, robot: RobotModel, open_line: NDArray[np.float64]) -> float:
    """Return a lower bound for how far the rear axle must drive before the lidar is over the line."""
    lidar, axle = robot.lidar_xyz_base[:2], np.array([robot.rear_axle_x_m, 0.0])
    # The axle's way and then the straight to the lidar together lead to the line, and keep this far from the walls.
    radius = min(inscribed_radius_m(robot.footprint_base, point) for point in (lidar, axle))
    to_line = shortest_length_m(world.walls, axle_pose(world.start.pose, robot)[:2], open_line, radius)
    return max(0.0, to_line - math.dist(lidar, axle))


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

    def rounded(values: object) -> list:
        return (np.asarray(values, dtype=float).round(_DIGITS) + 0.0).tolist()

    walls = shapely.transform(world.walls, lambda points: points.round(_DIGITS) + 0.0).normalize()
    start = world.start
    facts = [
        [rounded(shapely.get_coordinates(ring)) for ring in shapely.get_rings(shapely.get_parts(walls))],
        rounded(world.open_line),
        rounded([start.pose.x, start.pose.y, start.pose.yaw, start.range_x_m, start.range_y_m, start.range_yaw_rad]),
        rounded(robot.footprint_base),
        rounded([robot.wheelbase_m, robot.rear_axle_x_m, *robot.lidar_xyz_base[:2]]),
        rounded([physics.max_steering_rad, physics.max_speed_mps]),
    ]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()
