"""Where a car could begin in a place, for who has named a pose where it cannot."""

import math

import numpy as np
import shapely
import shapely.ops
from numpy.typing import NDArray

from zebrat_bullet.geometry import to_world
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.world import World

_ROOM_M, _STEP_M, _NEAR_M = 0.05, 0.2, 10.0
_HEADINGS = np.radians(np.arange(0.0, 360.0, 15.0))
_MOST_PLACES = 200


def free_start(world: World, footprint_base: NDArray[np.float64]) -> Pose2 | None:
    """Return a pose at which a (K, 2) footprint and its start range stand free, near the world's start if can be.

    It looks as the world's start does where there is room to, else any way. None where the car fits nowhere.
    """
    known = world.free_space.difference(world.unknown_ground)
    # Rather among the walls than round them, and rather on the floor of the start than on another.
    among = known.intersection(world.walls.convex_hull)
    x, y = world.start.pose.x, world.start.pose.y
    # Near the start first: a large map takes long to search.
    near = shapely.clip_by_rect(among, x - _NEAR_M, y - _NEAR_M, x + _NEAR_M, y + _NEAR_M)
    for ground in (lambda: near, lambda: among, lambda: known, lambda: _every_floor(world)):
        found = _free_on(ground(), world, footprint_base)
        if found is not None:
            return found
    return None


def _every_floor(world: World) -> shapely.Geometry:
    shown = shapely.GeometryCollection([world.walls, world.free_space]).envelope
    return shown.difference(world.walls).difference(world.unknown_ground)


def _free_on(ground: shapely.Geometry, world: World, footprint_base: NDArray[np.float64]) -> Pose2 | None:
    pose, start = world.start.pose, world.start
    reach = float(np.hypot(*footprint_base.T).max()) + math.hypot(start.range_x_m, start.range_y_m) + _ROOM_M
    room = ground.buffer(-reach)
    if not room.is_empty:
        point = shapely.ops.nearest_points(room, shapely.Point(pose.x, pose.y))[0]
        return _rounded(point.x, point.y, pose.yaw)
    # No room to turn: look along narrow places, whatever way they lead.
    spine = ground.buffer(-float(np.ptp(footprint_base[:, 1])) / 2 - _ROOM_M)
    places = shapely.get_coordinates(spine.segmentize(_STEP_M))
    order = np.argsort(np.hypot(*(places - (pose.x, pose.y)).T), kind="stable")
    shapely.prepare(ground)
    for x, y in places[order[:: max(1, len(order) // _MOST_PLACES)]]:
        for turn in _HEADINGS:
            found = _rounded(x, y, turn)
            if ground.contains(shapely.Polygon(to_world(footprint_base, found))):
                return found
    return None


def _rounded(x: float, y: float, yaw: float) -> Pose2:
    degrees = round(math.degrees(yaw) % 360.0)
    return Pose2(round(float(x), 2), round(float(y), 2), math.radians(degrees if degrees <= 180 else degrees - 360))
