"""What the environment's reset may be told of the episode to begin."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown
from zebrat_bullet.geometry import footprint_hits
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World
from zebrat_bullet.world.poses import pose_from, require_inside


def seed_of(seed: object) -> int | None:
    """Return the seed of a reset, a whole number from 0 up, numpy's among them; None stays None.

    Raises:
        ConfigError: it is something else.
    """
    if seed is None:
        return None
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigError(f"reset's seed is a whole number from 0 up or None, got {shown(repr(seed))}")
    return int(seed)


def options_of(options: Mapping[str, Any] | None) -> tuple[int | None, Pose2 | None]:
    """Return the episode's number and the start pose that reset's options name."""
    options = {} if options is None else options
    if not isinstance(options, Mapping):
        raise ConfigError(f"reset's options are a mapping of episode and pose, got {shown(repr(options))}")
    if unknown := sorted(str(name) for name in options if name not in ("episode", "pose")):
        raise ConfigError(f"reset has no option {shown(unknown)}; there are episode and pose")
    number, pose = options.get("episode"), options.get("pose")
    if number is not None and (isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 0):
        raise ConfigError(f"options['episode'] is a whole number from 0 up, got {shown(repr(number))}")
    return None if number is None else int(number), None if pose is None else pose_from(pose, "options['pose']")


def check_pose(pose: Pose2, world: World, footprint_base: NDArray[np.float64]) -> None:
    """Refuse a pose in a wall, or off the ground that the world's walls and its floor reach over."""
    if footprint_hits(world.walls, footprint_base, pose):
        raise ConfigError(f"options['pose'] {tuple(pose)} puts the car into a wall of {world.name!r}; move it")
    require_inside(pose, world, "options['pose']")
