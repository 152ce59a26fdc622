"""One door to every world: shipped by name, a user's world file, mesh or ROS map by path."""

from functools import lru_cache
from pathlib import Path

from zebrat_bullet.assets import find_asset
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.schema import parse_spec, read_yaml
from zebrat_bullet.world.validate import validate_world
from zebrat_bullet.world.world import World


def load_world(name_or_path: str | Path, *, robot: RobotModel | None = None) -> World:
    """Load and check a world.

    Args:
        name_or_path: a shipped world's name, or the path of a world file (.yaml).
        robot: the car that must fit; ZebraT if None.

    Raises:
        AssetError: no such world or file.
        WorldError: the world cannot be read, built or driven; names file, field and remedy.
    """
    path = find_asset("worlds", str(name_or_path), ".yaml")
    world = build_world(parse_spec(read_yaml(path), str(path)), str(path))
    validate_world(world, robot or _zebrat(), str(path))
    return world


@lru_cache(maxsize=1)
def _zebrat() -> RobotModel:
    return load_robot("zebrat")
