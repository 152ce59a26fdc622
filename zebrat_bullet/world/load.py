"""One door to every world: shipped by name, a user's world file, mesh or ROS map by path."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import shapely.errors

from zebrat_bullet.assets import asset_folder, find_asset
from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.files import shown
from zebrat_bullet.notes import Note, say
from zebrat_bullet.robot import RobotModel, load_robot, robot_of
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.build import build_world, goal_gate
from zebrat_bullet.world.in_memory import check_in_memory
from zebrat_bullet.world.meshes import MESH_SUFFIXES, refuse_other
from zebrat_bullet.world.reference import WorldReference, parse_reference
from zebrat_bullet.world.ros_map import IMAGE_SUFFIXES, refuse_image
from zebrat_bullet.world.schema import AT_ORIGIN, StartSpec, WorldSpec, parse_spec, read_yaml
from zebrat_bullet.world.validate import check_closed, open_space_too_early, validate_world
from zebrat_bullet.world.world import World


class WorldNote(Note):
    """Says what was taken to be meant where a file of others leaves it open."""


def load_world(
    name_or_path: str | Path,
    *,
    start: Pose2 | Sequence[float] | None = None,
    goal: Pose2 | Sequence[float] | None = None,
    exit: Sequence[Sequence[float]] | None = None,
    robot: RobotModel | str | Path | None = None,
) -> World:
    """Load and check a world.

    Args:
        name_or_path: a shipped world's name, or a path: a world file (.yaml), a mesh (.obj .stl .ply .glb, metres, z
            up, floor at z = 0), or a ROS map_server map (a .yaml with `image:`). Start, goal and exit may follow it
            (`reference.WorldReference`).
        start: where the car begins, exactly, instead of what the file says: a pose, or x, y in m and yaw in rad. Mesh
            and map: the origin if None.
        goal: the only waypoint, instead of the file's: x, y in m. To reach it is success where no open-space line is.
        exit: both ends of the open-space line, instead of the file's, of a mesh or map.
        robot: the car that must fit, by name, file or as `load_robot` gives it; ZebraT if None.

    Raises:
        AssetError: no such world or file.
        WorldError: the world cannot be read, built or driven; names file, field and remedy.
    """
    reference = parse_reference(str(name_or_path)).with_places(start, goal, exit)
    path = find_asset("worlds", reference.name, ".yaml")
    spec = _varied(_spec(path), reference, str(path))
    world = _built(spec, path)
    robot = default_robot() if robot is None else robot_of(robot)
    if spec.goal is not None or spec.waypoints is not None:
        world = _without_blind_line(world, spec, robot)
    if reference.goal is not None and world.open_line is not None:
        said = (
            f"its exit decides, so reaching the goal ({reference.goal[0]:g}, {reference.goal[1]:g}) ends nothing: "
            "planners drive to it, and success is to leave by the open-space line"
        )
        world = replace(world, notes=(*world.notes, said))
    for said in world.notes:  # also where it is refused next: it may be why
        say(f"{path}: {said}", WorldNote)
    check_closed(world, str(path))
    world = replace(world, source=str(replace(reference, name=_source(path))))
    validate_world(world, robot, str(path))
    return world


def load_worlds(
    worlds: str | Path | World | Sequence[str | Path | World],
    *,
    start: Pose2 | Sequence[float] | None = None,
    goal: Pose2 | Sequence[float] | None = None,
    exit: Sequence[Sequence[float]] | None = None,
    robot: RobotModel | str | Path | None = None,
) -> list[World]:
    """Return one world or several, those that are named loaded, all checked with the car that must fit.

    Start, goal and exit go with one named world; of a world that nobody can win a warning says so.

    Raises:
        ConfigError: there is no world, or not one for the start, goal or exit.
        AssetError, WorldError: as `load_world`.
    """
    single = str | Path | World
    several = isinstance(worlds, Iterable) and not isinstance(worlds, single)
    named: list[Any] = list(worlds) if several else [worlds]  # type: ignore[arg-type]
    if not named or not all(isinstance(each, single) for each in named):
        raise ConfigError(f"a world is a name, a path, a World, or a list with at least one, got {shown(repr(worlds))}")
    placed = start is not None or goal is not None or exit is not None
    if placed and (len(named) > 1 or isinstance(named[0], World)):
        raise ConfigError("start, goal and exit go with one world by name or path; name them in each world's file")
    robot = default_robot() if robot is None else robot_of(robot)
    loaded = [
        each if isinstance(each, World) else load_world(each, start=start, goal=goal, exit=exit, robot=robot)
        for each in named
    ]
    for world in loaded:
        if world.valid_for is None:
            check_in_memory(world, world.name)
        validate_world(world, robot, world.name)
        if not world.can_be_won:
            say(
                f"world {world.name!r} has neither exit nor goal, so no episode in it can succeed; name a goal",
                WorldNote,
            )
    return loaded


def sketch_world(
    name_or_path: str | Path,
    *,
    start: Pose2 | Sequence[float] | None = None,
    goal: Pose2 | Sequence[float] | None = None,
    exit: Sequence[Sequence[float]] | None = None,
) -> World:
    """Build what can be drawn of a world that `load_world` refuses: its walls at least; nothing is checked.

    Raises:
        AssetError, WorldError: not even its walls can be found.
    """
    reference = parse_reference(str(name_or_path)).with_places(start, goal, exit)
    path = find_asset("worlds", reference.name, ".yaml")
    spec = _spec(path)
    try:
        return _built(_varied(spec, reference, str(path)), path)
    except WorldError:
        if spec.mesh is None and spec.map is None:
            raise
    bare = spec.model_copy(update={"centre_line": None, "open_line": None, "low": spec.mesh is not None})
    return _built(_varied(bare, replace(reference, exit=None), str(path)), path)


def _built(spec: WorldSpec, path: Path) -> World:
    try:
        return build_world(spec, path)
    except shapely.errors.ShapelyError as error:
        raise WorldError(
            f"{shown(path)}: its outlines cannot be worked out ({error}); move the corners that lie on each other apart"
        ) from error


def _source(path: Path) -> str:
    return path.stem if path.parent == asset_folder("worlds") else str(path.resolve())


def _varied(spec: WorldSpec, reference: WorldReference, source: str) -> WorldSpec:
    """Return the world file with the start, goal and exit that were named beside it."""
    changes: dict[str, object] = {}
    if reference.start is not None:
        changes["start"] = StartSpec(pose=_pose(reference.start), range_x_m=0.0, range_y_m=0.0, range_yaw_rad=0.0)
    if reference.goal is not None:
        changes["waypoints"], changes["goal"] = [tuple(reference.goal)], None
    if reference.exit is not None:
        if spec.mesh is None and spec.map is None:
            raise WorldError(
                f"{source}: exit: only a mesh or map takes one; its segments or free_space say where it is"
            )
        x1, y1, x2, y2 = reference.exit
        changes["open_line"] = ((x1, y1), (x2, y2))
        if (x1, y1) == (x2, y2):
            raise WorldError(f"{source}: exit: both ends are ({x1}, {y1}); name two points")
    return spec.model_copy(update=changes)


def _pose(start: tuple[float, ...]) -> tuple[float, float, float]:
    x, y, yaw_deg = start
    return x, y, yaw_deg


def _without_blind_line(world: World, spec: WorldSpec, robot: RobotModel) -> World:
    """Let the goal decide where the car would take the inside for open space: the passage is too wide for that rule."""
    if world.open_line is None or not len(world.centre_line):
        return world
    seen = open_space_too_early(world, world.open_line, robot)
    if seen is None:
        return world
    said = (
        f"open space is already seen at ({seen[0]:.2f}, {seen[1]:.2f}), before the exit, so reaching the goal is "
        "success and seeing open space ends nothing"
    )
    return replace(world, open_line=None, gates=goal_gate(spec, world.waypoints), notes=(*world.notes, said))


def _spec(path: Path) -> WorldSpec:
    suffix, name = path.suffix.lower(), re.sub(r"[\x00-\x1f\\]", "_", path.stem[:100])
    if suffix in MESH_SUFFIXES:
        return WorldSpec(name=name, description=f"mesh {path.name}"[:2000], mesh=Path(path.name), start=AT_ORIGIN)
    refuse_other(path)
    if suffix in IMAGE_SUFFIXES:
        refuse_image(path)
    data = read_yaml(path)
    if "image" in data:
        return WorldSpec(name=name, description=f"ROS map {path.name}"[:2000], map=Path(path.name), start=AT_ORIGIN)
    return parse_spec(data, str(path))


@lru_cache(maxsize=1)
def default_robot() -> RobotModel:
    """Return ZebraT, read once."""
    return load_robot("zebrat")
