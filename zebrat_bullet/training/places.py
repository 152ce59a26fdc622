"""What a training run reads: its worlds, checked with the car that will drive there, and what else it names by path."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.claim import digests
from zebrat_bullet.files import is_file, read_json
from zebrat_bullet.robot import load_robot, named_robot
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.world import World, anywhere, load_world, require_winnable


def from_any_folder(config: TrainConfig) -> TrainConfig:
    """Return the config with the user's own files named so that a run resumed from elsewhere finds the same ones."""
    return replace(
        config,
        worlds=tuple(map(anywhere, config.worlds)),
        eval_worlds=tuple(map(anywhere, config.eval_worlds)),
        init=str(Path(config.init).resolve()) if config.init else "",
        task=replace(config.task, robot=named_robot(config.task.robot)),
    )


def training_worlds(names: Sequence[str], task: TaskConfig) -> list[World]:
    """Load the worlds that a policy is to learn in.

    Raises:
        ConfigError: episodes are to begin anywhere along a centre line, and a world has none.
        AssetError, WorldError: a world cannot be loaded, driven or won.
    """
    loaded = judging_worlds(names, task)
    for world in loaded:
        if task.episode.start != "start" and not len(world.centre_line):
            raise ConfigError(
                f"world {world.name!r} has no centre line, and episodes are to begin {task.episode.start!r} along it; "
                "give it one (centre_line in its world file), or begin at its start: --set task.episode.start=start"
            )
    return loaded


def judging_worlds(names: Sequence[str], task: TaskConfig) -> list[World]:
    """Load worlds that a policy is judged in.

    Raises:
        AssetError, WorldError: a world cannot be loaded, driven or won.
    """
    robot = load_robot(task.robot)
    loaded = [load_world(name, robot=robot) for name in names]
    for world in loaded:
        require_winnable(world)
    return loaded


def car_and_worlds(config: TrainConfig) -> dict[str, Any]:
    """Return what a run's car and those of its worlds that are named are now: `digests`.

    Raises:
        AssetError, ConfigError, RobotError, WorldError: one of them cannot be loaded, driven or won.
    """
    learned_in, judged_in = training_worlds(config.worlds, config.task), judging_worlds(config.eval_worlds, config.task)
    named = zip((*config.worlds, *config.eval_worlds), (*learned_in, *judged_in), strict=True)
    return digests(config.task, dict(named))


def changed_since(folder: Path, robot: str, now: Mapping[str, Any]) -> list[str]:
    """Return what is no longer what it was when the run in a folder began; an earlier version's run does not say.

    Args:
        folder: of the run; its `versions.json` says what it began with.
        robot: the name of its car.
        now: as `car_and_worlds` has it.
    """
    path = folder / "versions.json"
    then = read_json(path, ConfigError) if is_file(path) else {}
    then = then if isinstance(then, dict) else {}
    known = known if isinstance(known := then.get("worlds"), dict) else now["worlds"]
    worlds = [name for name, world in now["worlds"].items() if known.get(name, world) != world]
    changed = [] if then.get("car", now["car"]) == now["car"] else [f"robot {robot}"]
    return changed + [f"world {name}" for name in worlds]
