"""The commands about places and cars: worlds, robots."""

import argparse
import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zebrat_bullet.assets import list_assets
from zebrat_bullet.cli.common import AddCommand, PartialResultError, Result, note, picture, placed, robot_settings
from zebrat_bullet.cli.options import place_options
from zebrat_bullet.errors import ConfigError, PlanError, WorldError, ZebratError
from zebrat_bullet.processes import usable_cores

if TYPE_CHECKING:
    from zebrat_bullet.config import SafetyRegionConfig
    from zebrat_bullet.robot import Inspection, RobotModel
    from zebrat_bullet.world import World

# Fewer are certified sooner than a process starts.
_WORLDS_A_PROCESS = 20


def worlds(arguments: argparse.Namespace) -> Result:
    """List worlds with length, narrowest width and turns; generate, draw, certify them, write them as ROS maps."""
    from zebrat_bullet.planning.grid import OccupancyGrid, write_ros_map
    from zebrat_bullet.report.sketch import draw_sketches
    from zebrat_bullet.report.tables import worlds_table
    from zebrat_bullet.report.track_figure import draw_worlds
    from zebrat_bullet.robot import load_robot
    from zebrat_bullet.world import world_summary

    robot = load_robot(arguments.robot)
    names: Sequence[str | Path] = arguments.names or list_assets("worlds", ".yaml")
    path = arguments.out or Path("results") / "worlds.png"
    if arguments.generate is not None:
        folder = arguments.out or Path("results") / "worlds"
        names, path = _generate(arguments, robot, folder), folder / "worlds.png"
    elif arguments.family or arguments.difficulty is not None:
        raise ConfigError("--family and --difficulty say what to --generate; add --generate N")
    else:
        _require_drawn(arguments)
    path = picture(path) if arguments.draw else path
    references = placed(arguments, [str(name) for name in names])
    loaded, refusals = _load(arguments, references, robot)
    if arguments.draw and loaded:
        path.parent.mkdir(parents=True, exist_ok=True)
        draw_worlds(loaded, path, robot.footprint_base)
        note(arguments, f"drew {path}")
    if refusals:
        drawn = [sketch for sketch, _ in refusals if sketch is not None]
        if arguments.draw and drawn:
            path = path.with_stem(f"{path.stem}-refused") if loaded else path
            path.parent.mkdir(parents=True, exist_ok=True)
            draw_sketches(drawn, path, robot.footprint_base)
            note(arguments, f"drew what there is of the worlds that are refused: {path}")
        raise WorldError("\n".join(str(error) for _, error in refusals))
    result = {world.name: world_summary(world) for world in loaded}
    for world in loaded if arguments.map else ():
        ends = [(world.start.pose.x, world.start.pose.y), *world.waypoints]
        write_ros_map(OccupancyGrid.of_walls(world.walls, also_inside=ends), arguments.map / world.name)
    text = worlds_table(result)
    if arguments.certify:
        certified, missing = _certify(loaded, robot, arguments.certify, result)
        text = "\n\n".join([text, *(["\n".join(certified)] if certified else [])])
        if missing:
            raise PartialResultError("\n".join(missing), (result, text))
    return result, text


def _load(
    arguments: argparse.Namespace, references: Sequence[str], robot: "RobotModel"
) -> "tuple[list[World], list[tuple[World | None, WorldError]]]":
    """Return the worlds that can be driven, their names told apart, and why the others cannot, each sketched."""
    from zebrat_bullet.world import load_world, sketch_world, unique_names

    loaded: list[World] = []
    refusals: list[tuple[World | None, WorldError]] = []
    for reference in references:
        try:
            world = load_world(reference, robot=robot)
        except WorldError as error:
            sketch = None
            if arguments.draw:
                with contextlib.suppress(WorldError):
                    sketch = sketch_world(reference)
            refusals.append((sketch, error))
            continue
        loaded.append(world)
        if not world.can_be_won:
            note(arguments, f"{world.name}: has neither exit nor goal, so no episode in it can succeed")
    names = unique_names([world.name for world in loaded], [world.source for world in loaded])
    return [replace(world, name=name) for world, name in zip(loaded, names, strict=True)], refusals


def robots(arguments: argparse.Namespace) -> Result:
    """List cars: size, turning radius, lidar, bearings, and what is wrong with a URDF; draw what was understood."""
    from zebrat_bullet.config import LidarConfig, SafetyRegionConfig
    from zebrat_bullet.report.region_figure import draw_regions
    from zebrat_bullet.report.tables import refused_summary, robot_summary, robots_table
    from zebrat_bullet.robot import Inspection, named_robot, refusal

    _require_drawn(arguments)
    settings = robot_settings(arguments)
    config, n_bearings = SafetyRegionConfig(), LidarConfig().n_bearings
    seen: dict[str, Inspection] = {}
    unread: list[str] = []
    for name in arguments.names or list_assets("urdf", ".urdf"):
        try:
            inspected = _inspected(named_robot(name, settings), config)
        except ZebratError as error:  # the others are shown all the same
            unread.append(str(error))
            continue
        seen[_robot_title(inspected, seen)] = inspected
    result = {
        name: robot_summary(at.robot, config, n_bearings) if at.robot else refused_summary(at)
        for name, at in seen.items()
    }
    if arguments.draw and seen:
        path = picture(arguments.out or Path("results") / "robots.png")
        path.parent.mkdir(parents=True, exist_ok=True)
        draw_regions(seen, config, path)
        note(arguments, f"drew {path}")
    text = robots_table(result)
    refused = unread + [refusal(at) for at in seen.values() if at.robot is None]
    if refused:
        raise PartialResultError("\n".join(refused), (result, text))
    return result, text


def _require_drawn(arguments: argparse.Namespace) -> None:
    """Refuse a name for a picture that is not asked for."""
    if arguments.out and not arguments.draw:
        raise ConfigError(f"--out {arguments.out} names the picture that --draw makes; add --draw, or leave it out")


def _inspected(name: str, config: "SafetyRegionConfig") -> "Inspection":
    """Return what was understood of a car, its lidar's sight and its safety region among it."""
    from zebrat_bullet.config import FlattenConfig, LidarConfig
    from zebrat_bullet.robot import inspect_robot
    from zebrat_bullet.sensing.safety_region import make_region
    from zebrat_bullet.sensing.sight import check_sight

    seen = inspect_robot(name)
    if seen.robot is not None:
        try:
            check_sight(seen.robot, LidarConfig(), FlattenConfig())
            make_region(seen.robot, config, LidarConfig().n_bearings)
        except ZebratError as error:
            seen.problems.append(str(error).removeprefix(f"{seen.robot.urdf_path}: "))
            seen.robot = None
    return seen


def _robot_title(seen: "Inspection", others: "Mapping[str, Inspection]") -> str:
    """Return the name of a car's file, with its folder's, or a number, where another is named so."""
    path = seen.setup.path
    stem = path.name.removesuffix(".xacro").removesuffix(".urdf")
    tries = [stem, f"{path.parent.name}/{stem}", *(f"{stem} {n}" for n in range(2, len(others) + 3))]
    return next(title for title in tries if title not in others)


def _generate(arguments: argparse.Namespace, robot: "RobotModel", folder: Path) -> list[Path]:
    """Write the tracks of N seeds of each family that was named as world files, and return their paths."""
    from zebrat_bullet.world.generate import check_family, generate_spec
    from zebrat_bullet.world.schema import write_spec

    if arguments.names or arguments.generate < 1:
        raise ConfigError(
            f"--generate makes at least 1 world and takes no names, got {arguments.generate} and names "
            f"{arguments.names}; leave the names out to generate"
        )
    chosen, difficulty = arguments.family or ["mixed"], arguments.difficulty
    for family in chosen:
        check_family(family, difficulty)
    seeds = range(arguments.seed, arguments.seed + arguments.generate)
    made = (
        generate_spec(seed, family=family, difficulty=difficulty, robot=robot) for family in chosen for seed in seeds
    )
    paths = [write_spec(spec, folder) for spec in made]
    note(arguments, f"wrote {len(paths)} world files to {folder}")
    return paths


def _certify(
    worlds: "Sequence[World]", robot: "RobotModel", folder: Path, result: dict[str, dict[str, Any]]
) -> tuple[list[str], list[str]]:
    """Write the worlds' certificates, note them in the result of each; return what they say, and what is missing."""
    from zebrat_bullet.planning.certificate import Certificate, save_certificate
    from zebrat_bullet.planning.certify import certify_all

    certified: list[str] = []
    missing: list[str] = []
    workers = min(usable_cores(), -(-len(worlds) // _WORLDS_A_PROCESS))
    for world, answer in zip(worlds, certify_all(worlds, robot, workers=workers), strict=True):
        if not isinstance(answer, Certificate):
            proven = isinstance(answer, PlanError) and answer.proven
            result[world.name].update(certificate=None, proven_impassable=proven)
            missing.append(f"{world.name}: not certified, {'proven' if proven else 'not proven impassable'}: {answer}")
            continue
        facts = {name: getattr(answer, name) for name in ("n_reversals", "clearance_m", "least_time_s")}
        result[world.name].update(certificate=str(save_certificate(answer, folder)), **facts)
        certified.append(
            f"{world.name}: {answer.length_m:.1f} m with {answer.n_reversals} reversals lead out, at least "
            f"{answer.clearance_m:.3f} m from every wall; none takes less than {answer.least_time_s:.1f} s"
        )
    return certified, missing


def add(command: AddCommand) -> None:
    """Add the commands of this file."""
    made = command(worlds, place_options())
    made.add_argument("names", nargs="*", metavar="WORLD", help="names or files (default: all that are shipped)")
    made.add_argument(
        "--generate", type=int, metavar="N", help="instead: write tracks of N seeds from --seed on into --out FOLDER"
    )
    made.add_argument("--family", nargs="+", metavar="NAME", help="of these families each (default: mixed)")
    made.add_argument("--difficulty", type=float, help="0 to 1 (default: drawn for each track; mixed: 0.6)")
    made.add_argument(
        "--draw",
        action="store_true",
        help="draw them to scale into --out FILE.png (FOLDER/worlds.png); those refused too, with axes",
    )
    made.add_argument("--certify", type=Path, metavar="FOLDER", help="find a drive out of each, write the proof there")
    made.add_argument("--map", type=Path, metavar="FOLDER", help="write each as a ROS map, NAME.yaml and NAME.pgm")

    made = command(robots)
    made.add_argument("names", nargs="*", metavar="ROBOT", help="names or URDF files (default: all that are shipped)")
    made.add_argument(
        "--draw", action="store_true", help="draw wheels, hinges, footprint, lidar and what is watched, into --out FILE"
    )
