"""From a checked world file to a meshed world."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.niches import open_niches
from zebrat_bullet.world.schema import LOWEST_WALL_M, PolygonObstacle, StartSpec, WorldSpec
from zebrat_bullet.world.solid import ExtrudedMesh, Solid, join, polygons_of
from zebrat_bullet.world.sources import mesh_outlines, read_mesh, read_ros_map
from zebrat_bullet.world.survey import clear_widths, point_outward, survey
from zebrat_bullet.world.track import GOAL_M, Track, lay_track
from zebrat_bullet.world.walls import obstacle_solid, wall_solids
from zebrat_bullet.world.world import Start, World

_WAYPOINT_SPACING_M = 1.5
# How far round the walls of a mesh or map the floor counts as its free space.
_FLOOR_MARGIN_M = 8.0
_HAIR_M = 1e-3


def build_world(spec: WorldSpec, path: Path) -> World:
    """Build the world that a file describes; `path` names it, and is where its mesh or map is looked for.

    Neither is its mesh made nor is it checked here whether that is closed.

    Raises:
        WorldError: segments, polygons or files that do not make a place to drive in.
    """
    source = str(path)
    mesh = None if spec.mesh is None else read_mesh(path.parent / spec.mesh)
    if mesh is not None:
        solids = [Solid(part, 0.0, float(mesh.vertices[:, 2].max())) for part in mesh_outlines(mesh)]
        track, open_line, free_space = _on_surfaces(spec, solids, source)
    elif spec.map is not None:
        solids = read_ros_map(path.parent / spec.map, spec.wall.height_m)
        track, open_line, free_space = _on_surfaces(spec, solids, source)
    else:
        track, open_line = _corridor(spec, source)
        free_space = track.free_space
        try:
            solids = wall_solids(free_space, open_line, spec.wall)
        except shapely.GEOSException as error:
            raise WorldError(f"{source}: walls cannot stand there ({error}); move a corner by a centimetre") from error
    _check_obstacles(spec, source)
    obstacles = [obstacle_solid(item, track) for item in spec.obstacles]
    # What hangs above the height band of the flat scan is meshed, but passes over the car.
    standing = [solid for solid in solids + obstacles if solid.bottom_m < LOWEST_WALL_M]
    walls = _multi(standing)
    begin_m = _start_distance(spec.start, track, source)
    line, widths = _from_start(track, begin_m) if track else (np.empty((0, 2)), np.empty(0))
    return World(
        name=spec.name,
        description=spec.description,
        mesh=ExtrudedMesh(solids + obstacles) if mesh is None else join([mesh, ExtrudedMesh(obstacles)]),
        walls=walls,
        low_obstacles=_multi([solid for solid in standing if solid.low]),
        free_space=_largest(free_space.difference(walls)) if obstacles else free_space,
        centre_line=line,
        widths_m=clear_widths(line, widths, walls) if obstacles and track else widths,
        start=_start(spec.start, track),
        waypoints=_waypoints(spec, track, begin_m),
        open_line=open_line,
        max_steps=spec.max_steps,
        turns_deg=tuple(turn for at, turn in track.turns if at > begin_m) if track else (),
        family=spec.family,
        difficulty=spec.difficulty,
    )


def _corridor(spec: WorldSpec, source: str) -> tuple[Track, NDArray[np.float64]]:
    if spec.segments is not None:
        track = open_niches(lay_track(spec.segments, source), spec.niches, source)
        return track, _exit_line(track.exit, track.widths_m[-1])
    for i, ring in enumerate(spec.free_space or []):
        if not shapely.Polygon(ring).is_valid:
            reason = shapely.is_valid_reason(shapely.Polygon(ring))
            raise WorldError(f"{source}: free_space[{i}]: its walls cross themselves ({reason}); reorder its corners")
    free_space = shapely.union_all([shapely.Polygon(ring) for ring in spec.free_space or []])
    if free_space.geom_type != "Polygon":
        raise WorldError(f"{source}: free_space: the polygons do not touch; let neighbours share an edge or overlap")
    return _surveyed(spec, free_space, source)


def _on_surfaces(
    spec: WorldSpec, solids: list[Solid], source: str
) -> tuple[Track | None, NDArray[np.float64] | None, shapely.Polygon]:
    """Return track and open-space line, if the file gives them, and the floor that the start can reach."""
    outlines = shapely.union_all([solid.outline for solid in solids])
    floor = outlines.envelope.buffer(_FLOOR_MARGIN_M, join_style="mitre").difference(outlines)
    if spec.open_line is not None:
        floor = floor.difference(shapely.LineString(spec.open_line).buffer(_HAIR_M))
    pose = _start(spec.start, None).pose
    here = [part for part in polygons_of(floor) if part.intersects(shapely.Point(pose.x, pose.y))]
    if not here:
        raise WorldError(f"{source}: start: ({pose.x}, {pose.y}) is in a wall or far outside; move the start")
    if spec.open_line is None:
        return None, None, here[0]
    track, open_line = _surveyed(spec, here[0].buffer(2 * _HAIR_M), source)
    return track, open_line, here[0]


def _surveyed(spec: WorldSpec, free_space: shapely.Polygon, source: str) -> tuple[Track, NDArray[np.float64]]:
    line = np.array(spec.open_line, dtype=float)
    track = survey(free_space, np.array(spec.centre_line, dtype=float), line, source)
    return track, point_outward(line, track.exit)


def _exit_line(pose: Pose2, width: float) -> NDArray[np.float64]:
    left = np.array([-math.sin(pose.yaw), math.cos(pose.yaw)]) * width / 2
    return np.array([pose.x, pose.y]) + np.stack([-left, left])


def _start_distance(start: StartSpec, track: Track | None, source: str) -> float:
    """Return where on the centre line of its track the car begins."""
    if track is None:
        return 0.0
    if start.pose is not None:
        return float(shapely.line_locate_point(shapely.LineString(track.points), shapely.Point(start.pose[:2])))
    if start.at_m >= track.length_m:
        raise WorldError(f"{source}: start.at_m: {start.at_m} m is past the end at {track.length_m:.2f} m; lower it")
    return start.at_m


def _start(start: StartSpec, track: Track | None) -> Start:
    if start.pose is not None:
        pose = Pose2(start.pose[0], start.pose[1], math.radians(start.pose[2]))
    else:
        assert track is not None
        pose = track.pose_at(start.at_m)
    return Start(pose, start.range_x_m, start.range_y_m, start.range_yaw_rad)


def _from_start(track: Track, begin_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    pose = track.pose_at(begin_m)
    later = track.distances_m > begin_m + 1e-6
    width = np.interp(begin_m, track.distances_m, track.widths_m)
    return np.vstack([[pose.x, pose.y], track.points[later]]), np.concatenate([[width], track.widths_m[later]])


def _waypoints(spec: WorldSpec, track: Track | None, begin_m: float) -> NDArray[np.float64]:
    """Return the file's waypoints, or points at the corners, between them, and 1 m past the open-space line."""
    if spec.waypoints is not None or track is None:
        return np.array(spec.waypoints or np.empty((0, 2)), dtype=float)
    corners = [at for at, _ in track.turns if at > begin_m + 0.5]
    at: list[float] = []
    for a, b in pairwise([begin_m, *corners, track.length_m + GOAL_M]):
        n = max(1, round((b - a) / _WAYPOINT_SPACING_M))
        at += [a + (b - a) * (i + 1) / n for i in range(n)]
    return np.column_stack([np.interp(at, track.distances_m, axis) for axis in track.points.T])


def _check_obstacles(spec: WorldSpec, source: str) -> None:
    for i, item in enumerate(spec.obstacles):
        if isinstance(item, PolygonObstacle) and not shapely.Polygon(item.polygon).is_valid:
            raise WorldError(f"{source}: obstacles[{i}].polygon: its outline crosses itself; reorder its corners")


def _multi(solids: list[Solid]) -> shapely.MultiPolygon:
    return shapely.MultiPolygon(polygons_of(shapely.union_all([solid.outline for solid in solids])))


def _largest(shape: shapely.Geometry) -> shapely.Polygon:
    return max(polygons_of(shape), key=lambda part: part.area)
