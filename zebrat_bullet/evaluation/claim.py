"""A folder that grows over several runs holds rows of one study only: what they have in common stands beside them."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_plain, to_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import is_file, read_json
from zebrat_bullet.outputs import written_whole
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import World
from zebrat_bullet.world.fingerprint import digest, fingerprint, rounded

STUDY = "study.json"
# These and no others, in this order: a number that cars get later must not make each of them another one.
_OF_A_CAR = (
    *("wheelbase_m", "track_m", "hinge_track_m", "hinge_offset_m", "wheel_radius_m", "front_radius_m", "rear_axle_x_m"),
    *("footprint_base", "lidar_xyz_base", "lidar_rpy", "body_top_m", "knuckle_limit_rad", "rolling_mass_kg"),
    *("yaw_inertia_kgm2", "weight_n", "wheel_effort_nm", "wheel_speed_radps", "hinge_speed_radps", "plain_body"),
    "base_from_root",
)


def claim_folder(
    folder: Path, holds: str, task: TaskConfig, worlds: Mapping[str, World] | None = None, **more: Any
) -> None:
    """Write what all rows of a folder have in common to its `study.json`, or refuse one where it is something else.

    Other worlds may join; the car, and a world that is there, must be what they were under that name.

    Args:
        folder: made where it is not there.
        holds: what its rows are, for the refusal.
        task: the task driven; its ray caster does not count, for either gives the same cloud.
        worlds: driven in, by what the rows call them.
        more: what else the rows share, by name, as JSON has it.

    Raises:
        ConfigError: the folder holds rows that were driven under something else.
    """
    more = json.loads(json.dumps(more))
    car, places = digests(task, worlds or {}).values()
    path = folder / STUDY
    if not path.exists():
        _write(path, more | {"task": json.loads(to_json(_any_caster(task))), "car": car, "worlds": places})
    then = read_json(path, ConfigError)
    if not isinstance(then, dict) or not isinstance(then.get("task"), dict):
        raise ConfigError(f"{path}: holds no settings of a study; name another --out")
    # One from before a setting came says nothing of it: it was as by default, and as the files are now.
    known: dict[str, str] = named if isinstance(named := then.get("worlds"), dict) else {}
    differing = [name for name in more if then.get(name) != more[name]]
    differing += [name for name in places if known.get(name, places[name]) != places[name]]
    differing += [] if then.get("car", car) == car else ["car"]
    if _any_caster(from_plain(TaskConfig, then["task"])) != _any_caster(task):
        differing.append("task")
    if differing:
        raise ConfigError(f"{folder} holds {holds} driven under another {', '.join(differing)}; name another --out")
    if not places.items() <= known.items() or "car" not in then:
        _write(path, then | {"car": car, "worlds": known | places})


def claim_data_set(folder: Path, task: TaskConfig, worlds: Mapping[str, World] | None = None, **more: Any) -> None:
    """Claim a folder as `claim_folder` does, and refuse one that holds something and does not say what.

    Raises:
        ConfigError: it does, or what it holds was made under something else.
    """
    if not is_file(folder / STUDY) and folder.exists() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty; name a new folder, so that no two data sets mix")
    claim_folder(folder, "demonstrations", task, worlds, **more)


def _write(path: Path, common: Mapping[str, Any]) -> None:
    with written_whole(path) as part:
        part.write_text(json.dumps(common, indent=1), encoding="utf-8")


def _any_caster(task: TaskConfig) -> TaskConfig:
    return replace(task, lidar=replace(task.lidar, caster="bullet"))


def digests(task: TaskConfig, worlds: Mapping[str, World]) -> dict[str, Any]:
    """Return what tells a car and worlds from others that their files may hold some day.

    Returns:
        `car`: of all its numbers. `worlds`: of each, by its name.
    """
    robot = load_robot(task.robot)
    # How near to the floor its body reaches decides which worlds it may drive in, not how it drives in them.
    values = (getattr(robot, name) for name in _OF_A_CAR)
    car = digest([rounded(value) for value in values if value is not None])
    return {"car": car, "worlds": {name: _digest_of(world) for name, world in worlds.items()}}


def _digest_of(world: World) -> str:
    ways = [rounded(world.gates), rounded(world.waypoints), world.max_steps]
    return digest([fingerprint(world), *ways, rounded(world.mesh.vertices)])
