"""One door to every world: shipped by name, a user's world file, mesh or ROS map by path."""

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from zebrat_bullet.assets import asset_folder, find_asset
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.schema import StartSpec, WorldSpec, parse_spec, read_yaml
from zebrat_bullet.world.sources import MESH_SUFFIXES
from zebrat_bullet.world.validate import check_closed, validate_world
from zebrat_bullet.world.world import World


def load_world(
    name_or_path: str | Path, *, start: Pose2 | None = None, goal: Pose2 | None = None, robot: RobotModel | None = None
) -> World:
    """Load and check a world.

    Args:
        name_or_path: a shipped world's name, or a path: a world file (.yaml), a watertight mesh (.obj .stl .ply .glb,
            metres, z up, floor at z = 0), or a ROS map_server map (a .yaml with `image:`).
        start: where the car begins, exactly, instead of what the file says; mesh and map: the origin if None.
        goal: the only waypoint, instead of the file's.
        robot: the car that must fit; ZebraT if None.

    Raises:
        AssetError: no such world or file.
        WorldError: the world cannot be read, built or driven; names file, field and remedy.
    """
    path = find_asset("worlds", str(name_or_path), ".yaml")
    changes: dict[str, object] = {}
    if start is not None:
        pose = (start.x, start.y, math.degrees(start.yaw))
        changes["start"] = StartSpec(pose=pose, range_x_m=0.0, range_y_m=0.0, range_yaw_rad=0.0)
    if goal is not None:
        changes["waypoints"] = [(goal.x, goal.y)]
    spec = _spec(path).model_copy(update=changes)
    world = build_world(spec, path)
    check_closed(world, str(path))
    validate_world(world, robot or default_robot(), str(path))
    shipped = path.parent == asset_folder("worlds")
    return replace(world, source=path.stem if shipped else str(path.resolve()))


def _spec(path: Path) -> WorldSpec:
    origin = StartSpec(pose=(0.0, 0.0, 0.0), range_x_m=0.0, range_y_m=0.0, range_yaw_rad=0.0)
    if path.suffix.lower() in MESH_SUFFIXES:
        return WorldSpec(name=path.stem, description=f"mesh {path.name}", mesh=Path(path.name), start=origin)
    data = read_yaml(path)
    if "image" in data:
        return WorldSpec(name=path.stem, description=f"ROS map {path.name}", map=Path(path.name), start=origin)
    return parse_spec(data, str(path))


@lru_cache(maxsize=1)
def default_robot() -> RobotModel:
    """Return ZebraT, read once."""
    return load_robot("zebrat")
