"""Measures a passage along a centre line: its widths, and where the line leaves it."""

import math
from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.track import GOAL_M, Track, resample

_LEAST_TURN_DEG, _MOST_TURN_DEG = 10.0, 175.0
# Longer than any passage is wide.
_REACH_M = 20.0


def survey(
    free_space: shapely.Polygon, centre_line: NDArray[np.float64], open_line: NDArray[np.float64] | None, source: str
) -> Track:
    """Return the track that a (K, 2) centre line makes through a free space.

    It ends where the line crosses the open line, or where it ends itself if that is None.

    Raises:
        WorldError: the centre line does not lead through the free space and out over the line.
    """
    _check_line(centre_line, source)
    points, distances, _ = resample(centre_line, np.zeros(len(centre_line) - 1))
    length, inside = float(distances[-1]), np.ones(len(points), dtype=bool)
    if open_line is not None:
        course = shapely.LineString(points)
        crossing = course.intersection(shapely.LineString(open_line))
        if crossing.is_empty:
            raise WorldError(f"{source}: centre_line: never crosses the open_line; extend it {GOAL_M} m past the line")
        length = float(shapely.line_locate_point(course, shapely.Point(shapely.get_coordinates(crossing)[0])))
        inside = distances < length - 1e-6
        if not inside.any():
            raise WorldError(f"{source}: centre_line: begins at the open_line; begin it where the car does")
    if not shapely.intersects_xy(free_space.buffer(1e-6), *points[inside].T).all():
        raise WorldError(f"{source}: centre_line: leaves the free space before the open_line; move its points inside")
    widths = np.empty(len(points))
    widths[inside] = _chords(points, free_space)[inside]
    widths[~inside] = widths[inside][-1]
    turns = tuple((at, turn) for at, turn in _turns(centre_line) if at < length)
    track = Track(free_space, points, distances, widths, turns, Pose2(0.0, 0.0, 0.0), length)
    return replace(track, exit=track.pose_at(length))


def _check_line(line: NDArray[np.float64], source: str) -> None:
    """Refuse a line that stands still or turns straight back: nobody could say what lies beside it there."""
    steps = np.diff(line, axis=0)
    still = np.flatnonzero((steps == 0).all(axis=1))
    if len(still):
        raise WorldError(f"{source}: centre_line: its point {still[0] + 1} comes twice in a row; leave one out")
    yaws = np.arctan2(steps[:, 1], steps[:, 0])
    back = np.flatnonzero(np.cos(np.diff(yaws)) < math.cos(math.radians(_MOST_TURN_DEG)))
    if len(back):
        raise WorldError(f"{source}: centre_line: turns straight back at its point {back[0] + 2}; lead it round a bow")


def point_outward(line: NDArray[np.float64], exit_pose: Pose2) -> NDArray[np.float64]:
    """Order the ends of a (2, 2) open-space line so that the way out is to their right."""
    along = line[1] - line[0]
    out = math.cos(exit_pose.yaw) * along[1] - math.sin(exit_pose.yaw) * along[0]
    return line if out > 0 else line[::-1].copy()


def clear_widths(
    line: NDArray[np.float64], widths: NDArray[np.float64], walls: shapely.MultiPolygon
) -> NDArray[np.float64]:
    """Return the widest gap that walls and obstacles leave across the corridor at each point of its centre line."""
    hair = 1e-3
    across = _normals(line) * (widths / 2 - hair)[:, None]
    chords = shapely.linestrings(np.stack([line - across, line + across], axis=1))
    shapely.prepare(walls)
    clear = widths.copy()
    for i in np.flatnonzero(shapely.intersects(chords, walls)):
        parts = shapely.get_parts(shapely.difference(chords[i], walls))
        clear[i] = max((part.length + hair for part in parts), default=0.0)
    return clear


def _turns(line: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Return (distance, degrees to the left) of the corners of a line."""
    steps = np.diff(line, axis=0)
    at = np.hypot(*steps.T).cumsum()[:-1]
    turns = np.degrees(np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))))
    return [(float(a), float(turn)) for a, turn in zip(at, turns, strict=True) if abs(turn) > _LEAST_TURN_DEG]


def _normals(line: NDArray[np.float64]) -> NDArray[np.float64]:
    along = np.gradient(line, axis=0)
    along /= np.hypot(*along.T)[:, None]
    return np.column_stack([-along[:, 1], along[:, 0]])


def _chords(line: NDArray[np.float64], free_space: shapely.Polygon) -> NDArray[np.float64]:
    """Return the length of the side-to-side chord of the free space through each point of a line."""
    reach = _REACH_M * _normals(line)
    chords = shapely.intersection(shapely.linestrings(np.stack([line - reach, line + reach], axis=1)), free_space)
    widths = np.zeros(len(line))
    for i, (point, chord) in enumerate(zip(shapely.points(line), chords, strict=True)):
        through = (part.length for part in shapely.get_parts(chord) if part.distance(point) < 1e-6)
        widths[i] = max(through, default=0.0)
    return widths
