"""The worlds of a training run, checked with the car that will drive there."""

from collections.abc import Sequence

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import World, load_world, require_winnable


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
