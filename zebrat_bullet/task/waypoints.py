"""Waypoint guidance: which waypoint of a world is next, and how far the car has come towards it (paper, eq. 9)."""

import math

import shapely

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.types import Pose2, Waypoint
from zebrat_bullet.world import World
from zebrat_bullet.world.goal import REACHED_M


def check_waypoints(world: World) -> None:
    """Refuse a world that a guided task cannot be driven in.

    Raises:
        ConfigError: the world has no waypoints.
    """
    if not len(world.waypoints):
        raise ConfigError(
            f"waypoint guidance needs waypoints and world {world.name!r} has none; name them in its world file "
            "(waypoints: [[x, y], ...], for a mesh or map beside `mesh:` or `map:`), or drive unguided"
        )


class WaypointGuide:
    """Follows a world's waypoints from pose to pose of one episode.

    A waypoint is reached within `REACHED_M` of the car's middle (the paper's rule); then the next one counts. It also
    counts as done once the place on the centre line nearest to the car lies past the waypoint's own: a car that keeps
    to the far side of a wide passage would otherwise be paid for turning back. On a circuit the half of it that lies
    behind a waypoint is past it. In a world without a centre line (a
    mesh or map with waypoints of its own) there is nothing to tell that by, and only the paper's rule holds. The last
    waypoint is the goal and stays the next one; no waypoint comes back.

    Args:
        world: where.
        pose: where the car begins; what is already reached or passed there never counts.

    Raises:
        ConfigError: the world has no waypoints.
    """

    def __init__(self, world: World, pose: Pose2) -> None:
        check_waypoints(world)
        self._waypoints = world.waypoints.tolist()
        self._line = shapely.LineString(world.centre_line) if len(world.centre_line) else None
        self._along_m = [math.inf] * len(self._waypoints)
        if self._line is not None:
            self._along_m = shapely.line_locate_point(self._line, shapely.points(world.waypoints)).tolist()
        self._lap_m = self._line.length if self._line is not None and world.is_circuit else math.inf
        self._next = 0
        self._move_on(pose)

    def step(self, pose: Pose2) -> float:
        """Follow the car to its next pose and return by how many m it came nearer to the waypoint that was next."""
        nearer_m = self._distance_m - self._distance(pose)
        self._move_on(pose)
        return nearer_m

    def waypoint(self, pose: Pose2) -> Waypoint:
        """Return the next waypoint as seen from a pose."""
        x, y = self._waypoints[self._next]
        dx, dy = x - pose.x, y - pose.y
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        return Waypoint(math.hypot(dx, dy), math.atan2(c * dy - s * dx, c * dx + s * dy))

    def _distance(self, pose: Pose2) -> float:
        x, y = self._waypoints[self._next]
        return math.hypot(x - pose.x, y - pose.y)

    def _is_past(self, along_m: float, waypoint_m: float) -> bool:
        if self._lap_m == math.inf:
            return along_m > waypoint_m
        return 0.0 < (along_m - waypoint_m) % self._lap_m < self._lap_m / 2

    def _move_on(self, pose: Pose2) -> None:
        """Go on to the first waypoint that is neither reached nor passed, and note how far it is."""
        along_m = 0.0 if self._line is None else shapely.line_locate_point(self._line, shapely.Point(pose.x, pose.y))
        while self._next < len(self._waypoints) - 1 and (
            self._distance(pose) <= REACHED_M or self._is_past(along_m, self._along_m[self._next])
        ):
            self._next += 1
        self._distance_m = self._distance(pose)
