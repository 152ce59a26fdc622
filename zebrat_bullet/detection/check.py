"""What every representation says of a car that stands at a pose: the static check."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely

from zebrat_bullet.config import FlattenConfig, LidarConfig, NoiseConfig, PhysicsConfig, SafetyRegionConfig
from zebrat_bullet.detection.representations import RAY_REPRESENTATIONS
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.geometry import to_world, wrap_angle
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.sensing.cloud_check import band_points, side_distances
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.sensing.safety_region import SafetyRegion, make_region
from zebrat_bullet.sim.base import Touch
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import FlatScan, PointCloud, Pose2
from zebrat_bullet.world.world import World

REPRESENTATIONS = ("polygon", "physics", "cloud", *RAY_REPRESENTATIONS)


@dataclass(frozen=True, slots=True)
class Finding:
    """What one representation says of a pose.

    Attributes:
        collides: it reports a collision.
        gap_m: what is left until it reports one; at most 0 if it does, infinite where it sees nothing.
        bearing_rad: about the lidar, left-positive from straight ahead, of the ray or point that the gap belongs to;
            NaN where it sees nothing.
    """

    collides: bool
    gap_m: float
    bearing_rad: float


_NOTHING = Finding(False, math.inf, math.nan)


@dataclass(frozen=True, slots=True)
class PoseCheck:
    """What every representation says of one pose, by its name in `REPRESENTATIONS`."""

    pose: Pose2
    findings: dict[str, Finding]

    @property
    def collides(self) -> dict[str, bool]:
        """Which representations report a collision."""
        return {name: finding.collides for name, finding in self.findings.items()}

    @property
    def gaps_m(self) -> dict[str, float]:
        """What is left in m until each reports one (see `Finding`)."""
        return {name: finding.gap_m for name, finding in self.findings.items()}

    def table(self) -> str:
        """Return the findings as text, a line for each representation."""
        lines = [f"{'':8}  {'collision':9}  {'gap':>9}  {'bearing':>8}"]
        for name, finding in self.findings.items():
            seen = math.isfinite(finding.gap_m)
            gap = f"{finding.gap_m:+.4f} m" if seen else "-"
            bearing = f"{math.degrees(finding.bearing_rad):+.0f} deg" if seen else "-"
            lines.append(f"{name:8}  {'yes' if finding.collides else 'no':9}  {gap:>9}  {bearing:>8}")
        return "\n".join(lines)


class CollisionChecker:
    """Checks poses, thousands with one checker; a world is loaded where it differs from that of the check before.

    The representations:
        polygon: the exact outline against the outlines of the walls; its gap is their distance, 0 where they meet.
        physics: PyBullet's contact of the body with the walls; knows heights (the car passes below what hangs over its
            roof) and no margin. Its gap is that of the deepest contact, infinite without one.
        cloud: every point in the height band of the lidar against the outline.
        sr, firect, fifr: some bearings of the flat scan against a range each (see `sensing/safety_region.py`).

    Args:
        robot: a shipped robot's name, or the path of a car-like URDF.
        lidar: beams and ray caster.
        flatten: height band of cloud and scan.
        resolution_m: outline length between two bearings of the safety region.
        margin_m: how far the outline is enlarged on every side, with mitred corners.

    Raises:
        AssetError: there is no such robot.
        RobotError: its URDF is not a car's.
        ConfigError: a setting is out of its range.
    """

    def __init__(
        self,
        robot: str | Path = "zebrat",
        *,
        lidar: LidarConfig | None = None,
        flatten: FlattenConfig | None = None,
        resolution_m: float = SafetyRegionConfig.resolution_m,
        margin_m: float = SafetyRegionConfig.margin_m,
    ) -> None:
        model, lidar = load_robot(robot), lidar or LidarConfig()
        self._flatten = flatten or FlattenConfig()
        self.regions = {
            kind: make_region(
                model, SafetyRegionConfig(kind=kind, resolution_m=resolution_m, margin_m=margin_m), lidar.n_bearings
            )
            for kind in RAY_REPRESENTATIONS
        }
        self._mount_xy = model.lidar_xyz_base[:2]
        self._outline_lidar = self.regions["sr"].outline_lidar
        self._bearings = beam_bearings(lidar.n_bearings)
        self._rng = np.random.default_rng(0)  # the lidar is free of noise: nothing is drawn
        self._simulation = Simulation(model, PhysicsConfig())
        self._lidar = Lidar(model, lidar, NoiseConfig(), self._flatten, self._simulation.client_id)

    def check(self, world: World, pose: Pose2) -> PoseCheck:
        """Return what every representation says of the car standing level at `pose`.

        Raises:
            ConfigError: the pose is not finite.
        """
        if not all(map(math.isfinite, (pose.x, pose.y, pose.yaw))):
            raise ConfigError(f"a pose must be finite, got {pose}; give x and y in m, yaw in rad")
        self._simulation.set_world(world)
        self._lidar.set_world(world)
        state = self._simulation.reset(pose)
        sweep = self._lidar.sweep(state, self._rng)
        scan = self._lidar.flat(sweep)
        findings = {
            "polygon": self._polygon(world.walls, pose),
            "physics": self._physics(self._simulation.touches(), pose),
            "cloud": self._cloud(self._lidar.cloud(sweep)),
        }
        findings |= {name: self._rays(region, scan) for name, region in self.regions.items()}
        return PoseCheck(pose, findings)

    def close(self) -> None:
        """Free the physics server; the checker is of no use afterwards. May be called twice."""
        self._simulation.close()

    def _polygon(self, walls: shapely.MultiPolygon, pose: Pose2) -> Finding:
        if walls.is_empty:
            return _NOTHING
        shapely.prepare(walls)  # kept in the geometry: only its first call costs
        outline = shapely.polygons(to_world(self._outline_lidar + self._mount_xy, pose))
        hit = bool(shapely.intersects(walls, outline))
        to_wall = shapely.shortest_line(outline, walls)
        gap = 0.0 if hit else shapely.length(to_wall)
        return Finding(hit, gap, self._bearing(pose, shapely.get_coordinates(to_wall)[1]))

    def _physics(self, touches: Iterable[Touch], pose: Pose2) -> Finding:
        deepest = min(touches, key=lambda touch: touch[8], default=None)
        if deepest is None:
            return _NOTHING
        return Finding(True, deepest[8], self._bearing(pose, deepest[6][:2]))

    def _cloud(self, cloud: PointCloud) -> Finding:
        points = band_points(cloud, self._flatten)
        if not len(points):
            return _NOTHING
        distances = side_distances(points, self._outline_lidar)
        nearest = int(distances.argmin())
        x, y = points[nearest]
        gap = float(distances[nearest])
        return Finding(gap <= 0.0, gap, math.atan2(y, x))

    def _rays(self, region: SafetyRegion, scan: FlatScan) -> Finding:
        clearance = region.measure(scan)
        seen = clearance.obs_m < scan.range_max_m
        if not seen.any():
            return _NOTHING
        gaps = np.where(seen, clearance.obs_m - clearance.range_m, np.inf)
        nearest = int(gaps.argmin())
        return Finding(clearance.collision, float(gaps[nearest]), float(self._bearings[region.indices[nearest]]))

    def _bearing(self, pose: Pose2, point_world: Iterable[float]) -> float:
        """Return the bearing about the lidar of a point in the world."""
        (lidar_x, lidar_y), (x, y) = to_world(self._mount_xy, pose), point_world
        return wrap_angle(math.atan2(y - lidar_y, x - lidar_x) - pose.yaw)
