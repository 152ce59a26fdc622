"""What is to be reached in a world without an open-space line: a goal, a line, or the quarters of a lap."""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.track import Track, resample
from zebrat_bullet.world.world import World

REACHED_M = 0.5
"""A waypoint, or a goal that is a point, is reached within this distance of the car's middle (paper, eq. 9)."""
GATES = 4
"""Most gates that a world has; the quarters of a lap tell in which sense it is driven."""
# So far beside the open-space line it is told which side is inside.
_BESIDE_M = 0.02
# Longer than any passage is wide.
_REACH_M = 20.0


def require_winnable(world: World, source: str = "") -> None:
    """Refuse a world in which no episode can succeed.

    Raises:
        WorldError: it is one; names the file and what to give.
    """
    if not world.can_be_won:
        named = source or world.source or world.name
        raise WorldError(
            f"{named}: goal: nothing can be reached in this world, so every episode would fail; give it a goal "
            "(`goal: [x, y]` in its world file, --goal X Y, goal=(x, y)), an exit (open_line), or a "
            "centre_line that ends at its first point (a circuit)"
        )


def on_sides(line: NDArray[np.float64], inside: shapely.Geometry) -> tuple[bool, bool]:
    """Return whether a floor lies to the right, and to the left of the middle of a (2, 2) line in m."""
    along = (line[1] - line[0]) / math.dist(*line)
    right = _BESIDE_M * np.array([along[1], -along[0]])
    on_right, on_left = (bool(shapely.intersects_xy(inside, *(line.mean(axis=0) + side))) for side in (right, -right))
    return on_right, on_left


def point_gate(point: tuple[float, float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (1, 2, 2) gates of a goal that is a point."""
    return np.array([[point, point]], dtype=float)


def goal_off_ground(gates: NDArray[np.float64], ground: shapely.Polygon) -> tuple[str, ...]:
    """Return what is to be said where the last of (G, 2, 2) gates lies off the ground that a map or mesh shows."""
    off = ground.distance(shapely.LineString(gates[-1])) if len(gates) else 0.0
    if off == 0.0:
        return ()
    x, y = gates[-1].mean(axis=0)
    extents = "x {:.2f} to {:.2f}, y {:.2f} to {:.2f} m".format(*np.array(ground.bounds)[[0, 2, 1, 3]])
    return (f"goal: ({x:.2f}, {y:.2f}) lies {off:.1f} m off what is shown ({extents}); no wall is known there",)


def lap_gates(track: Track, free_space: shapely.Polygon, source: str) -> NDArray[np.float64]:
    """Return the (4, 2, 2) lines across a circuit at each quarter of it, the last where it begins.

    Raises:
        WorldError: a wall stands on its centre line there.
    """
    places = (i % GATES / GATES * track.length_m for i in range(1, GATES + 1))
    return np.stack([_across(track.pose_at(place), free_space, source) for place in places])


def circuit_from(line: NDArray[np.float64], start: Pose2) -> NDArray[np.float64]:
    """Return a closed (K, 2) line anew, from its point nearest to the start on, the way the car looks there."""
    points, _, _ = resample(line, np.zeros(len(line) - 1))
    ring = points[:-1]
    first = int(np.argmin(np.hypot(*(ring - (start.x, start.y)).T)))
    ring = np.roll(ring, -first, axis=0)
    along = ring[1] - ring[-1]
    if along @ (np.cos(start.yaw), np.sin(start.yaw)) < 0:
        ring = np.roll(ring[::-1], 1, axis=0)
    return np.vstack([ring, ring[:1]])


def _across(pose: Pose2, free_space: shapely.Polygon, source: str) -> NDArray[np.float64]:
    here = np.array([pose.x, pose.y])
    left = _REACH_M * np.array([-np.sin(pose.yaw), np.cos(pose.yaw)])
    chord = shapely.LineString([here - left, here + left]).intersection(free_space)
    if chord.is_empty:
        raise WorldError(
            f"{source}: centre_line: a wall stands on it at ({pose.x:.2f}, {pose.y:.2f}); lead it elsewhere"
        )
    nearest = min(shapely.get_parts(chord), key=lambda part: part.distance(shapely.Point(here)))
    ends: NDArray[np.float64] = shapely.get_coordinates(nearest)[[0, -1]]
    return ends
