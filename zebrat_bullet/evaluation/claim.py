"""A folder that grows over several runs holds rows of one study only: what they have in common stands beside them."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_plain, to_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import read_json
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.world import World
from zebrat_bullet.world.fingerprint import digest, fingerprint, rounded


def geometry(robot: RobotModel, worlds: Mapping[str, World] | None = None) -> dict[str, str]:
    """Return what tells the car, and worlds by their names, from others that a file of that name may have held before.

    Args:
        robot: the car.
        worlds: by what rows call them.
    """
    car = [robot.wheelbase_m, robot.track_m, robot.rear_axle_x_m, robot.weight_n, *robot.lidar_xyz_base]
    found = {"car": digest([rounded(robot.footprint_base), rounded(car)])}
    return found | {name: fingerprint(world) for name, world in (worlds or {}).items()}


def claim_folder(
    folder: Path, holds: str, task: TaskConfig, geometry: Mapping[str, str] | None = None, **more: float
) -> None:
    """Write what all rows of a folder have in common to its `study.json`, or refuse one where it is something else.

    Other worlds may join; the car, and a world that is there, must be what they were.

    Args:
        folder: made where it is not there.
        holds: what its rows are, for the refusal.
        task: the task driven; its ray caster does not count, for either gives the same cloud.
        geometry: as the function of that name returns it.
        more: what else they share, by name.

    Raises:
        ConfigError: the folder holds rows that were driven under something else.
    """
    common = more | {"task": json.loads(to_json(_any_caster(task)))}
    path = folder / "study.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(common, indent=1))
    then = read_json(path, ConfigError)
    if not isinstance(then, dict) or not isinstance(then.get("task"), dict):
        raise ConfigError(f"{path}: holds no settings of a study; name another --out")
    differing = [name for name in more if then.get(name) != more[name]]
    # One from before a setting came says nothing of it: it was as by default.
    if _any_caster(from_plain(TaskConfig, then["task"])) != _any_caster(task):
        differing.append("task")
    given, known = dict(geometry or {}), then.get("geometry") or {}
    differing += [name for name in given if known.get(name, given[name]) != given[name]]
    if differing:
        raise ConfigError(f"{folder} holds {holds} driven under another {', '.join(differing)}; name another --out")
    if not given.items() <= known.items():
        path.write_text(json.dumps(then | {"geometry": known | given}, indent=1))


def _any_caster(task: TaskConfig) -> TaskConfig:
    return replace(task, lidar=replace(task.lidar, caster="bullet"))
