"""A folder of demonstrations says what made it, so that a run that was killed goes on and no two data sets mix."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import to_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import is_file, read_json

_SETTINGS = "made_by.json"


def begin_or_go_on(folder: Path, task: TaskConfig, **how: Any) -> None:
    """Make a folder for a data set, or find the beginnings of the same one there.

    Args:
        folder: where it is.
        task: the task driven; its ray caster does not count, for either gives the same cloud.
        how: what else its files depend on, by name, as JSON has it.

    Raises:
        ConfigError: the folder holds something else, or demonstrations that were made otherwise.
    """
    path, wanted = folder / _SETTINGS, json.loads(json.dumps(how)) | {"task": json.loads(to_json(task))}
    wanted["task"]["lidar"]["caster"] = ""
    if is_file(path):
        made_by = read_json(path, ConfigError)
        there: Mapping[str, Any] = made_by if isinstance(made_by, dict) else {}
        if differing := [name for name in wanted if there.get(name) != wanted[name]]:
            raise ConfigError(
                f"{folder} holds demonstrations made with another {', '.join(differing)}; name a new folder, so that "
                "no two data sets mix"
            )
        return
    if folder.exists() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty; name a new folder, so that no two data sets mix")
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(wanted))
