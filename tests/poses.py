"""Poses near walls, and what the geometry alone says of them: no caster, no scan, no product code but the regions."""

from dataclasses import dataclass, replace

import numpy as np
import pybullet
import shapely
from boxes import box_world
from numpy.typing import NDArray

from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.safety_region import SafetyRegion
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.solid import extrude, join
from zebrat_bullet.world.world import Mesh, World

SLACK_M = 1e-5
"""Rays are cast in float32, which 40 m from the origin is good to 4e-6 m: nearer cases may be decided either way."""


def upright_world(*outlines: shapely.Polygon, bottom_m: float = 0.0, top_m: float = 1.0) -> World:
    """Return a world whose only walls are upright prisms over these outlines."""
    mesh = join([extrude(outline, bottom_m, top_m) for outline in outlines])
    return replace(box_world(), mesh=mesh, walls=shapely.MultiPolygon(outlines))


def near_wall_poses(world: World, robot: RobotModel, n: int, rng: np.random.Generator) -> list[Pose2]:
    """Draw poses whose corner or side nearest to some piece of wall stands 5 cm or less, seldom more, in or off it."""
    a, b = wall_sides(world.walls)
    length = np.hypot(*(b - a).T)
    which = rng.choice(len(a), n, p=length / length.sum())
    along = (b[which] - a[which]) / length[which, None]
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1)
    gap = np.select(
        [rng.random(n) < 0.65, rng.random(n) < 0.6],
        [rng.uniform(0.0, 0.05, n), rng.uniform(-0.05, 0.0, n)],
        rng.uniform(-0.6, 0.3, n),
    )
    flush = np.arctan2(along[:, 1], along[:, 0]) + rng.choice(4, n) * np.pi / 2 + rng.normal(0.0, 0.05, n)
    yaw = np.where(rng.random(n) < 0.5, flush, rng.uniform(-np.pi, np.pi, n))
    corners = turned(robot.footprint_base, yaw)
    nearest = np.einsum("nkd,nd->nk", corners, outward).argmin(axis=1)
    touch = a[which] + rng.random((n, 1)) * (b[which] - a[which])
    at = touch + gap[:, None] * outward - corners[np.arange(n), nearest]
    return [Pose2(float(x), float(y), float(t)) for (x, y), t in zip(at, yaw, strict=True)]


def wall_sides(walls: shapely.MultiPolygon) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (S, 2) beginnings and ends of the sides of all walls, free space on their right."""
    rings = [
        np.array(ring.coords)
        for wall in shapely.orient_polygons(shapely.get_parts(walls))
        for ring in (wall.exterior, *wall.interiors)
    ]
    return np.vstack([ring[:-1] for ring in rings]), np.vstack([ring[1:] for ring in rings])


def turned(points: NDArray[np.float64], yaw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (K, 2) points turned left by each of (N,) angles: (N, K, 2)."""
    x, y = np.asarray(points).T
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def placed(points: NDArray[np.float64], poses: list[Pose2]) -> NDArray[np.float64]:
    """Return (K, 2) points of the base frame in the world, for each of N poses: (N, K, 2)."""
    numbers = np.array([(pose.x, pose.y, pose.yaw) for pose in poses]).reshape(-1, 3)
    return turned(points, numbers[:, 2]) + numbers[:, None, :2]


def physics_gaps(simulation: Simulation, poses: list[Pose2]) -> NDArray[np.float64]:
    """Return the (N,) smallest distance in m that Bullet finds between body and walls, at most 2 mm."""
    car, walls, client = simulation.car_id, simulation.walls_id, simulation.client_id
    x, y, z = pybullet.getDynamicsInfo(car, -1, physicsClientId=client)[3]
    masses = placed(np.array([[x, y]]), poses)[:, 0]
    gaps = np.full(len(poses), 0.002)
    for i, (pose, (com_x, com_y)) in enumerate(zip(poses, masses, strict=True)):
        turn = pybullet.getQuaternionFromEuler((0.0, 0.0, pose.yaw))
        pybullet.resetBasePositionAndOrientation(car, (com_x, com_y, z), turn, physicsClientId=client)
        near = pybullet.getClosestPoints(car, walls, 0.002, -1, -1, physicsClientId=client)
        gaps[i] = min((point[8] for point in near), default=0.002)
    return gaps


@dataclass(frozen=True)
class RayTruth:
    """(N,) bool each: the region must report a collision; it may report one (its rays are within `SLACK_M` of it)."""

    must: NDArray[np.bool_]
    may: NDArray[np.bool_]


def ray_truth(region: SafetyRegion, robot: RobotModel, world: World, poses: list[Pose2]) -> RayTruth:
    """Return whether any of the region's rays, cut off at its range, meets a wall.

    A lidar outside of all walls sees their outlines. One inside of a wall sees every upright surface from within, also
    those that two touching walls have in common, and which the outline of both does not show.
    """
    mount = robot.lidar_xyz_base[:2]
    lidar = shapely.points(placed(mount[None], poses)[:, 0])
    inside = np.flatnonzero(shapely.distance(world.walls, lidar) <= SLACK_M)
    shrunk, grown = (world.walls.buffer(by, join_style="mitre") for by in (-SLACK_M, SLACK_M))
    surfaces = upright_surfaces(world.mesh)
    for geometry in (shrunk, grown, surfaces):
        shapely.prepare(geometry)
    rays = _rays(region, mount, poses, 0.0)
    must, may = shapely.intersects(shrunk, rays), shapely.intersects(grown, rays)
    shorter = _rays(region, mount, [poses[i] for i in inside], -SLACK_M)
    must[inside] = shapely.intersects(surfaces, shorter)
    may[inside] = shapely.dwithin(surfaces, rays[inside], SLACK_M)
    return RayTruth(must, may)


def _rays(region: SafetyRegion, mount: NDArray[np.float64], poses: list[Pose2], longer_m: float) -> NDArray:
    """Return (N,) lines in the world that run along all R rays of the region, each time back to the lidar."""
    bearing = -np.pi + region.indices * (2 * np.pi / 360)
    reach = region.range_m.astype(float) + longer_m
    ends = mount + reach[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    there_and_back = np.stack([ends, np.broadcast_to(mount, ends.shape)], axis=1).reshape(-1, 2)
    return shapely.linestrings(placed(there_and_back, poses))


def upright_surfaces(mesh: Mesh) -> shapely.MultiLineString:
    """Return the upright triangles of a mesh, seen from above."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return shapely.multilinestrings(shapely.linestrings(corners[np.abs(normal[:, 2]) < 1e-9][:, :, :2]))
