"""Passages of one shape and one width: what a car is measured in that is to get through narrow places."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.elements import Straight, Turn
from zebrat_bullet.world.load import default_robot
from zebrat_bullet.world.schema import StartSpec, WorldSpec
from zebrat_bullet.world.track import corner_extent
from zebrat_bullet.world.validate import check_closed, validate_world
from zebrat_bullet.world.world import World

SHAPES = ("straight", "45", "90", "180")
"""A straight; sharp corners of so many degrees; a U-turn of two right angles round a thin wall."""
SENSES = ("left", "right")
U_WALL_M = 0.1
"""Thickness of the wall that the U-turn goes round."""
# Straights before and behind the turn that no corner takes anything of; the car begins 1 m from the closed end.
_BEFORE_M, _BEHIND_M, _BEGIN_M = 2.5, 2.0, 1.0
# At every pose of its start range the car is so far from the walls.
START_GAP_M = 0.02
RANGE_Y_M, RANGE_YAW_RAD = 0.1, 0.15
"""The usual range of a start."""


def passage(shape: str, width_m: float, sense: str = "left", robot: RobotModel | None = None) -> World:
    """Build a passage as wide everywhere, named `SHAPE-SENSE-WIDTH`: a straight, a turn, a straight.

    The start range is the usual one, narrowed in proportion where the passage leaves less room.

    Args:
        shape: one of `SHAPES`.
        width_m: of the passage.
        sense: the turn's, "left" or "right"; a straight has none, and only "left" is taken for it.
        robot: the car that must fit; ZebraT if None.

    Raises:
        ConfigError: no such shape or sense.
        WorldError: the passage is hardly wider than the car.
    """
    if shape not in SHAPES or sense not in senses(shape):
        known = ", ".join(f"{name} ({' or '.join(senses(name))})" for name in SHAPES)
        raise ConfigError(f"no passage {shape!r} with the sense {sense!r}; there are {known}")
    robot = robot or default_robot()
    car_width = float(np.ptp(robot.footprint_base[:, 1]))
    if width_m <= car_width + 2 * START_GAP_M:
        raise WorldError(
            f"a passage {width_m:.3f} m wide leaves no room to begin to a car of {car_width:.3f} m; "
            f"make it wider than {car_width + 2 * START_GAP_M:.3f} m"
        )
    share = start_share(width_m, robot.footprint_base)
    name = f"{shape}-{sense}-{width_m:.3f}"
    spec = WorldSpec(
        name=name,
        description=f"{shape}, {width_m:.3f} m wide",
        segments=_segments(shape, width_m, 1.0 if sense == "left" else -1.0),
        start=StartSpec(at_m=_BEGIN_M, range_y_m=share * RANGE_Y_M, range_yaw_rad=share * RANGE_YAW_RAD),
    )
    world = build_world(spec, Path(name))
    check_closed(world, name)
    validate_world(world, robot, name)
    return world


def senses(shape: str) -> tuple[str, ...]:
    """Return the senses in which a shape is driven."""
    return SENSES[:1] if shape == "straight" else SENSES


def _segments(shape: str, width: float, side: float) -> list[Straight | Turn]:
    if shape == "straight":
        return [Straight(straight=_BEFORE_M + _BEHIND_M, width=width)]
    turn = Turn(turn=side * min(float(shape), 90.0), width=width)
    taken = corner_extent(turn, width)
    between: list[Straight | Turn] = [Straight(straight=width + U_WALL_M, width=width), turn] if shape == "180" else []
    return [
        Straight(straight=_BEFORE_M + taken, width=width),
        turn,
        *between,
        Straight(straight=_BEHIND_M + taken, width=width),
    ]


def start_share(width_m: float, footprint: NDArray[np.float64]) -> float:
    """Return the largest share of the usual start range, in twentieths, that a straight leaves room for.

    Args:
        width_m: of the straight.
        footprint: (K, 2) float64, corners of the car in its base frame, m.
    """
    x, y = footprint.T
    for share in np.linspace(1.0, 0.0, 21):
        yaws = np.linspace(-1.0, 1.0, 9)[:, None] * share * RANGE_YAW_RAD
        reach = np.abs(x * np.sin(yaws) + y * np.cos(yaws)).max() + share * RANGE_Y_M
        if reach <= width_m / 2 - START_GAP_M:
            return float(share)
    return 0.0


def turn_rad(shape: str) -> float:
    """Return by how much one corner of a shape turns."""
    return 0.0 if shape == "straight" else math.radians(min(float(shape), 90.0))
