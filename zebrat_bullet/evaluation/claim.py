"""A folder that grows over several runs holds rows of one study only: what they have in common stands beside them."""

import json
from dataclasses import replace
from pathlib import Path

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_plain, to_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import read_json


def claim_folder(folder: Path, holds: str, task: TaskConfig, **more: float) -> None:
    """Write what all rows of a folder have in common to its `study.json`, or refuse one where it is something else.

    Args:
        folder: made where it is not there.
        holds: what its rows are, for the refusal.
        task: the task driven; its ray caster does not count, for either gives the same cloud.
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
    if differing:
        raise ConfigError(f"{folder} holds {holds} driven under another {', '.join(differing)}; name another --out")


def _any_caster(task: TaskConfig) -> TaskConfig:
    return replace(task, lidar=replace(task.lidar, caster="bullet"))
