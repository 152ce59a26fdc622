"""Poses that users name: of which kind they must be, and where."""

from numbers import Real

import numpy as np
import shapely

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.elements import MOST_COORDINATE_M
from zebrat_bullet.world.world import World


def pose_from(value: object, what: str) -> Pose2:
    """Return a pose that is a Pose2 or three numbers, x, y in m and yaw in rad.

    Args:
        value: what a user named.
        what: how messages name it.

    Raises:
        ConfigError: it is neither, or not finite.
    """
    values = np.asarray(value, dtype=object).reshape(-1)
    if len(values) != 3 or not all(isinstance(each, Real) for each in values):
        raise ConfigError(f"{what} is a Pose2 or (x, y, yaw) in m and rad, got {shown(repr(value))}")
    if not all(abs(each) <= MOST_COORDINATE_M for each in values):
        raise ConfigError(f"{what} must be finite, within {MOST_COORDINATE_M:g} of 0, got {shown(repr(value))}")
    return Pose2(*map(float, values))


def require_inside(pose: Pose2, world: World, what: str) -> None:
    """Refuse a pose off the ground that a world's walls and its floor reach over.

    Raises:
        ConfigError: it is; the message says how far they reach.
    """
    x0, y0, x1, y1 = shapely.GeometryCollection([world.walls, world.free_space]).bounds
    if not (x0 <= pose.x <= x1 and y0 <= pose.y <= y1):
        raise ConfigError(
            f"{what} {tuple(pose)} lies outside {world.name!r}, x {x0:.2f} to {x1:.2f}, y {y0:.2f} to {y1:.2f} m; "
            "move it"
        )
