"""From a checked world file to a meshed world."""

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import affinity

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.elements import LOWEST_WALL_M, Buttress, PolygonObstacle
from zebrat_bullet.world.goal import circuit_from, goal_off_ground, lap_gates, on_sides, point_gate
from zebrat_bullet.world.meshes import read_mesh
from zebrat_bullet.world.niches import open_niches
from zebrat_bullet.world.ros_map import read_ros_map
from zebrat_bullet.world.schema import StartSpec, WorldSpec
from zebrat_bullet.world.solid import ExtrudedMesh, Solid, join, polygons_of
from zebrat_bullet.world.survey import clear_widths, point_outward, survey
from zebrat_bullet.world.track import GOAL_M, Track, lay_track
from zebrat_bullet.world.walls import obstacle_solid, wall_solids
from zebrat_bullet.world.world import Mesh, Start, World

_WAYPOINT_SPACING_M = 1.5
# How far round the walls of a mesh or map the floor counts as its free space.
_FLOOR_MARGIN_M = 8.0
_HAIR_M = 1e-3
# An open-space line that must part the way out is drawn so much longer, as walls of cells have steps.
_INTO_WALLS_M = 0.2


def build_world(spec: WorldSpec, path: Path) -> World:
    """Build the world that a file describes; `path` names it, and is where its mesh or map is looked for.

    Neither is its mesh made nor is it checked here whether that is closed.

    Raises:
        WorldError: segments, polygons or files that do not make a place to drive in.
    """
    source = str(path)
    place = _place(spec, path)
    if place is not None:
        track, open_line, free_space = _on_surfaces(spec, place, source)
        solids = place.solids
    else:
        track, open_line = _corridor(spec, source)
        free_space = track.free_space if track is not None else _joined(spec, source)
        try:
            solids = wall_solids(free_space, open_line, spec.wall)
        except shapely.GEOSException as error:
            raise WorldError(f"{source}: walls cannot stand there ({error}); move a corner by a centimetre") from error
    _check_obstacles(spec, track, source)
    obstacles = [obstacle_solid(item, track) for item in spec.obstacles]
    # What hangs above the height band of the flat scan is meshed, but passes over the car.
    standing = [solid for solid in solids + obstacles if solid.bottom_m < LOWEST_WALL_M]
    walls = _multi(standing)
    begin_m = _start_distance(spec.start, track, source)
    line, widths = _from_start(track, begin_m) if track else (np.empty((0, 2)), np.empty(0))
    free_space = _largest(free_space.difference(walls), source) if obstacles else free_space
    waypoints = _waypoints(spec, track, begin_m, open_line)
    mesh = place.mesh if place is not None else None
    gates = np.empty((0, 2, 2)) if open_line is not None else _gates(spec, waypoints, track, free_space, source)
    return World(
        name=spec.name,
        description=spec.description,
        mesh=ExtrudedMesh(solids + obstacles) if mesh is None else join([mesh, ExtrudedMesh(obstacles)]),
        walls=walls,
        low_obstacles=_multi([solid for solid in standing if solid.low]),
        free_space=free_space,
        centre_line=line,
        widths_m=clear_widths(line, widths, walls) if obstacles and track else widths,
        start=_start(spec.start, track),
        waypoints=waypoints,
        open_line=open_line,
        max_steps=spec.max_steps,
        turns_deg=tuple(turn for at, turn in track.turns if at > begin_m) if track else (),
        family=spec.family,
        difficulty=spec.difficulty,
        gates=gates,
        unknown_ground=place.unknown if place is not None else shapely.MultiPolygon(),
        notes=(*place.notes, *goal_off_ground(gates, place.ground)) if place is not None else _said_twice(spec.start),
    )


@dataclass(frozen=True)
class _Place:
    """The walls of others: solids, their mesh (None: as the solids stand), the floor, unknown ground, notes."""

    solids: list[Solid]
    mesh: Mesh | None
    ground: shapely.Polygon
    unknown: shapely.MultiPolygon
    notes: tuple[str, ...]


def _place(spec: WorldSpec, path: Path) -> _Place | None:
    """Return the walls of the mesh or map that a world file names, None if it says itself where they are."""
    if spec.mesh is not None:
        read = read_mesh(path.parent / spec.mesh, spec)
        outlines = shapely.union_all([solid.outline for solid in read.solids])
        ground = outlines.envelope.buffer(_FLOOR_MARGIN_M, join_style="mitre")
        return _Place(read.solids, read.mesh, ground, shapely.MultiPolygon(), read.notes)
    if spec.map is not None:
        chart = read_ros_map(path.parent / spec.map, spec.wall.height_m, spec.unknown, spec.start)
        return _Place(chart.solids, None, chart.ground, chart.unknown, chart.notes)
    return None


def _corridor(spec: WorldSpec, source: str) -> tuple[Track | None, NDArray[np.float64] | None]:
    if spec.segments is not None:
        track = open_niches(lay_track(spec.segments, source), spec.niches, source)
        return track, _exit_line(track.exit, track.widths_m[-1])
    return _surveyed(spec, _joined(spec, source), source)


def _joined(spec: WorldSpec, source: str) -> shapely.Polygon:
    """Return the polygons of `free_space` as one."""
    for i, ring in enumerate(spec.free_space or []):
        if not shapely.Polygon(ring).is_valid:
            reason = shapely.is_valid_reason(shapely.Polygon(ring))
            raise WorldError(f"{source}: free_space[{i}]: its walls cross themselves ({reason}); reorder its corners")
    free_space = shapely.union_all([shapely.Polygon(ring) for ring in spec.free_space or []])
    if free_space.geom_type != "Polygon":
        raise WorldError(f"{source}: free_space: the polygons do not touch; let neighbours share an edge or overlap")
    return free_space


def _on_surfaces(
    spec: WorldSpec, place: _Place, source: str
) -> tuple[Track | None, NDArray[np.float64] | None, shapely.Polygon]:
    """Return track and open-space line, if the file gives them, and the floor that the start can reach.

    Where it begins in a wall, that is the largest floor: the start is checked later, with the car.
    """
    floor = place.ground.difference(shapely.union_all([solid.outline for solid in place.solids]))
    pose = _start(spec.start, None).pose
    reached = _reached(floor, pose, source) if spec.open_line is None else _before(spec, floor, pose, source)
    if spec.centre_line is None:
        if spec.open_line is None:
            return None, None, reached
        return None, _outward(np.array(spec.open_line, dtype=float), reached, source), reached
    track, open_line = _surveyed(spec, reached.buffer(2 * _HAIR_M), source)
    return track, open_line, reached


def _before(spec: WorldSpec, floor: shapely.Geometry, pose: Pose2, source: str) -> shapely.Polygon:
    """Return the floor before the open-space line: as it is drawn, or if that leaves a gap beside it, longer."""
    line = shapely.LineString(spec.open_line)
    if spec.centre_line is not None:
        drawn = _reached(floor.difference(line.buffer(_HAIR_M)), pose, source)
        if not all(on_sides(np.array(spec.open_line, dtype=float), drawn)):
            return drawn
    # Without a centre line nothing but the line itself parts the way out, so it must reach into the walls.
    longer = affinity.scale(line, *2 * [1.0 + 2 * _INTO_WALLS_M / line.length])
    return _reached(floor.difference(longer.buffer(_HAIR_M)), pose, source)


def _reached(floor: shapely.Geometry, pose: Pose2, source: str) -> shapely.Polygon:
    """Return the part of a floor that holds a pose, or the largest."""
    here = [part for part in polygons_of(floor) if part.intersects(shapely.Point(pose.x, pose.y))]
    return here[0] if here else _largest(floor, source)


def _outward(line: NDArray[np.float64], inside: shapely.Polygon, source: str) -> NDArray[np.float64]:
    """Order the ends of a (2, 2) open-space line so that the way out, away from a floor, is to their right."""
    on_right, on_left = on_sides(line, inside)
    if on_right == on_left:
        raise WorldError(
            f"{source}: open_line: it does not part the way out from where the car begins; let both its ends reach the "
            "walls beside the exit, or give a centre_line that leads out over it"
        )
    return line[::-1].copy() if on_right else line


def _surveyed(
    spec: WorldSpec, free_space: shapely.Polygon, source: str
) -> tuple[Track | None, NDArray[np.float64] | None]:
    """Return the track along the file's centre line, None without one, and the open-space line, if there is one."""
    if spec.centre_line is None:
        return None, None
    centre_line = np.array(spec.centre_line, dtype=float)
    if spec.is_circuit and spec.open_line is None:
        centre_line = circuit_from(centre_line, _start(spec.start, None).pose)
    if spec.open_line is None:
        return survey(free_space, centre_line, None, source), None
    line = np.array(spec.open_line, dtype=float)
    track = survey(free_space, centre_line, line, source)
    return track, point_outward(line, track.exit)


def _gates(
    spec: WorldSpec, waypoints: NDArray[np.float64], track: Track | None, free_space: shapely.Polygon, source: str
) -> NDArray[np.float64]:
    """Return what is to be reached where no open-space line is: the goal, a lap, or nothing."""
    if spec.goal is not None or spec.waypoints is not None:
        return goal_gate(spec, waypoints)
    return lap_gates(track, free_space, source) if spec.is_circuit and track is not None else np.empty((0, 2, 2))


def goal_gate(spec: WorldSpec, waypoints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (1, 2, 2) gate of a world file's goal: its line, or the last of its (K, 2) waypoints."""
    if spec.goal is not None and isinstance(spec.goal[0], tuple):
        return np.array([spec.goal], dtype=float)
    return point_gate(waypoints[-1])


def _exit_line(pose: Pose2, width: float) -> NDArray[np.float64]:
    left = np.array([-math.sin(pose.yaw), math.cos(pose.yaw)]) * width / 2
    return np.array([pose.x, pose.y]) + np.stack([-left, left])


def _start_distance(start: StartSpec, track: Track | None, source: str) -> float:
    """Return where on the centre line of its track the car begins."""
    if track is None or _is_ring(track):
        return 0.0
    if start.pose is not None:
        return float(shapely.line_locate_point(shapely.LineString(track.points), shapely.Point(start.pose[:2])))
    if start.at_m >= track.length_m:
        raise WorldError(f"{source}: start.at_m: {start.at_m} m is past the end at {track.length_m:.2f} m; lower it")
    return start.at_m


def _said_twice(start: StartSpec) -> tuple[str, ...]:
    twice = start.pose is not None and "at_m" in start.model_fields_set
    return ("start: pose says where the car begins, so at_m says nothing; remove one",) if twice else ()


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


def _waypoints(
    spec: WorldSpec, track: Track | None, begin_m: float, open_line: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Return the file's waypoints, or points at the corners, between them, and 1 m past the open-space line."""
    if spec.waypoints is not None or spec.goal is not None:
        last = [] if spec.goal is None else [np.reshape(spec.goal, (-1, 2)).mean(axis=0)]
        return np.array([*(spec.waypoints or []), *last], dtype=float)
    if track is None:
        return np.empty((0, 2)) if open_line is None else _past(open_line)
    end_m = track.length_m + (GOAL_M if open_line is not None else 0.0)
    corners = [at for at, _ in track.turns if at > begin_m + 0.5]
    at: list[float] = []
    for a, b in pairwise([begin_m, *corners, end_m]):
        n = max(1, round((b - a) / _WAYPOINT_SPACING_M))
        at += [a + (b - a) * (i + 1) / n for i in range(n)]
    return np.column_stack([np.interp(at, track.distances_m, axis) for axis in track.points.T])


def _past(open_line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (1, 2) point past the middle of an open-space line."""
    along = (open_line[1] - open_line[0]) / math.dist(*open_line)
    return (open_line.mean(axis=0) + GOAL_M * np.array([along[1], -along[0]]))[None]


def _is_ring(track: Track) -> bool:
    return bool(np.allclose(track.points[0], track.points[-1]))


def _check_obstacles(spec: WorldSpec, track: Track | None, source: str) -> None:
    for i, item in enumerate(spec.obstacles):
        if isinstance(item, Buttress) and track is not None and item.at_m > track.length_m:
            raise WorldError(
                f"{source}: obstacles[{i}].at_m: {item.at_m} m is past the end at {track.length_m:.2f} m; lower it"
            )
        if isinstance(item, PolygonObstacle) and not shapely.Polygon(item.polygon).is_valid:
            raise WorldError(f"{source}: obstacles[{i}].polygon: its outline crosses itself; reorder its corners")


def _multi(solids: list[Solid]) -> shapely.MultiPolygon:
    return shapely.MultiPolygon(polygons_of(shapely.union_all([solid.outline for solid in solids])))


def _largest(shape: shapely.Geometry, source: str) -> shapely.Polygon:
    parts = polygons_of(shape)
    if not parts:
        raise WorldError(f"{source}: its walls and obstacles leave no floor to drive on; take some away")
    return max(parts, key=lambda part: part.area)
