"""From a checked world file to a meshed world."""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.schema import LOWEST_WALL_M, StartSpec, WorldSpec
from zebrat_bullet.world.solid import Solid, extrude, join, polygons_of
from zebrat_bullet.world.track import GOAL_M, Track, lay_track, resample
from zebrat_bullet.world.walls import obstacle_solid, wall_solids
from zebrat_bullet.world.world import Start, World

_WAYPOINT_SPACING_M = 1.5


def build_world(spec: WorldSpec, source: str) -> World:
    """Build the world of a `segments` or `free_space` file.

    Raises:
        WorldError: segments or polygons that do not make a corridor.
    """
    track = _track(spec, source)
    open_line = _exit_line(track.exit, track.widths_m[-1]) if spec.segments else np.array(spec.open_line, dtype=float)
    if not spec.segments:
        open_line = _point_outward(open_line, track)
    _check_obstacles(spec, source)
    obstacles = [obstacle_solid(item, track) for item in spec.obstacles]
    walls = wall_solids(track.free_space, open_line, spec.wall)
    begin_m = spec.start.at_m if spec.start.pose is None else 0.0
    if begin_m >= track.length_m:
        raise WorldError(
            f"{source}: start.at_m: {begin_m} m is past the end of the track at {track.length_m:.2f} m; lower it"
        )
    line, widths = _from_start(track, begin_m)
    waypoints = _waypoints(track, begin_m) if spec.waypoints is None else np.array(spec.waypoints, dtype=float)
    return assemble(
        spec,
        walls + obstacles,
        free_space=track.free_space,
        centre_line=line,
        widths_m=widths,
        start=start_of(spec.start, track.pose_at(begin_m)),
        waypoints=waypoints,
        open_line=open_line,
    )


def assemble(
    spec: WorldSpec,
    solids: list[Solid],
    *,
    free_space: shapely.Polygon,
    centre_line: NDArray[np.float64],
    widths_m: NDArray[np.float64],
    start: Start,
    waypoints: NDArray[np.float64],
    open_line: NDArray[np.float64] | None,
) -> World:
    """Mesh the solids and take what stands in the free space out of it."""
    # What hangs above the height band of the flat scan is drawn and meshed, but passes over the car.
    standing = [solid for solid in solids if solid.bottom_m < LOWEST_WALL_M]
    walls = _multi([solid.outline for solid in standing])
    return World(
        name=spec.name,
        description=spec.description,
        mesh=join(extrude(solid.outline, solid.bottom_m, solid.top_m) for solid in solids),
        walls=walls,
        low_obstacles=_multi([solid.outline for solid in standing if solid.low]),
        free_space=_largest(free_space.difference(walls)) if spec.obstacles else free_space,
        centre_line=centre_line,
        widths_m=_clear_widths(centre_line, widths_m, walls) if spec.obstacles else widths_m,
        start=start,
        waypoints=waypoints,
        open_line=open_line,
        max_steps=spec.max_steps,
    )


def start_of(spec: StartSpec, otherwise: Pose2) -> Start:
    """Return the start that a file gives, or `otherwise` with the file's random range."""
    pose = otherwise if spec.pose is None else Pose2(spec.pose[0], spec.pose[1], math.radians(spec.pose[2]))
    return Start(pose, spec.range_x_m, spec.range_y_m, spec.range_yaw_rad)


def spread_along(line: NDArray[np.float64], keys_m: list[float]) -> NDArray[np.float64]:
    """Return (K, 2) points along a line: at each key distance but the first, and evenly between them."""
    distances = np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T).cumsum()])
    at = []
    for a, b in zip(keys_m[:-1], keys_m[1:], strict=True):
        n = max(1, round((b - a) / _WAYPOINT_SPACING_M))
        at += [a + (b - a) * (i + 1) / n for i in range(n)]
    return np.column_stack([np.interp(at, distances, line[:, 0]), np.interp(at, distances, line[:, 1])])


def _track(spec: WorldSpec, source: str) -> Track:
    if spec.segments is not None:
        return lay_track(spec.segments, source)
    for i, ring in enumerate(spec.free_space or []):
        if not shapely.Polygon(ring).is_valid:
            reason = shapely.is_valid_reason(shapely.Polygon(ring))
            raise WorldError(
                f"{source}: free_space[{i}]: its walls cross themselves ({reason}); put the corners in order round it"
            )
    free_space = shapely.union_all([shapely.Polygon(ring) for ring in spec.free_space or []])
    if free_space.geom_type != "Polygon":
        raise WorldError(f"{source}: free_space: the polygons do not touch; let neighbours share an edge or overlap")
    corners = np.array(spec.centre_line, dtype=float)
    points, distances, _ = resample(corners, np.zeros(len(corners) - 1))
    line = np.array(spec.open_line, dtype=float)
    crossing = shapely.LineString(points).intersection(shapely.LineString(line))
    if crossing.is_empty:
        raise WorldError(f"{source}: centre_line: it never crosses the open_line; extend it {GOAL_M} m past the line")
    met = shapely.Point(shapely.get_coordinates(crossing)[0])
    length = float(shapely.line_locate_point(shapely.LineString(points), met))
    widths = _chords(points, free_space)
    inside = distances < length
    widths[~inside] = widths[inside][-1]
    track = Track(free_space, points, distances, widths, (), Pose2(0.0, 0.0, 0.0), length)
    return Track(free_space, points, distances, widths, (), track.pose_at(length), length)


def _exit_line(pose: Pose2, width: float) -> NDArray[np.float64]:
    left = np.array([-math.sin(pose.yaw), math.cos(pose.yaw)]) * width / 2
    return np.array([[pose.x, pose.y] - left, [pose.x, pose.y] + left])


def _point_outward(line: NDArray[np.float64], track: Track) -> NDArray[np.float64]:
    """Order the two ends so that the way out, along the centre line, is to their right."""
    along = line[1] - line[0]
    out = math.cos(track.exit.yaw) * along[1] - math.sin(track.exit.yaw) * along[0]
    return line if out > 0 else line[::-1].copy()


def _from_start(track: Track, begin_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    pose = track.pose_at(begin_m)
    later = track.distances_m > begin_m + 1e-6
    width = np.interp(begin_m, track.distances_m, track.widths_m)
    return np.vstack([[pose.x, pose.y], track.points[later]]), np.concatenate([[width], track.widths_m[later]])


def _waypoints(track: Track, begin_m: float) -> NDArray[np.float64]:
    inner = [corner for corner in track.corners_m if corner > begin_m + 0.5]
    return spread_along(track.points, [begin_m, *inner, track.length_m + GOAL_M])


def _check_obstacles(spec: WorldSpec, source: str) -> None:
    for i, item in enumerate(spec.obstacles):
        ring = getattr(item, "polygon", None)
        if ring is not None and not shapely.Polygon(ring).is_valid:
            raise WorldError(f"{source}: obstacles[{i}].polygon: its outline crosses itself; put the corners in order")


def _normals(line: NDArray[np.float64]) -> NDArray[np.float64]:
    along = np.gradient(line, axis=0)
    along /= np.hypot(*along.T)[:, None]
    return np.column_stack([-along[:, 1], along[:, 0]])


def _chords(line: NDArray[np.float64], free_space: shapely.Polygon) -> NDArray[np.float64]:
    """Return how wide the free space is across each point of a line, on the side-to-side chord through it."""
    reach = 20.0 * _normals(line)
    chords = shapely.intersection(shapely.linestrings(np.stack([line - reach, line + reach], axis=1)), free_space)
    here = shapely.points(line)
    widths = np.zeros(len(line))
    for i, chord in enumerate(chords):
        parts = [part for part in shapely.get_parts(chord) if part.distance(here[i]) < 1e-6]
        widths[i] = max((part.length for part in parts), default=0.0)
    return widths


def _clear_widths(
    line: NDArray[np.float64], widths: NDArray[np.float64], walls: shapely.MultiPolygon
) -> NDArray[np.float64]:
    """Return the widest gap that obstacles leave across the corridor at each point of its centre line."""
    across = _normals(line) * (widths / 2 - 1e-3)[:, None]
    chords = shapely.linestrings(np.stack([line - across, line + across], axis=1))
    shapely.prepare(walls)
    clear = widths.copy()
    for i in np.flatnonzero(shapely.intersects(chords, walls)):
        parts = shapely.get_parts(shapely.difference(chords[i], walls))
        clear[i] = max((part.length + 1e-3 for part in parts), default=0.0)
    return clear


def _multi(outlines: list[shapely.Polygon]) -> shapely.MultiPolygon:
    return shapely.MultiPolygon(polygons_of(shapely.union_all(outlines)))


def _largest(shape: shapely.Geometry) -> shapely.Polygon:
    return max(polygons_of(shape), key=lambda part: part.area)
