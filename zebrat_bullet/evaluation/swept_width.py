"""How wide a passage must be for a car, from its outline and its turning circle alone."""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.robot import RobotModel, within_limits
from zebrat_bullet.world.passage import U_WALL_M, turn_rad

_STEP_M = 0.001
_WIDEST_M = 10.0


def rigid_width_m(shape: str, robot: RobotModel) -> float | None:
    """Return the width below which a car gets through nowhere, however it may move; None if it is no rectangle.

    Halfway through a corner by theta it must stand across it, at theta / 2 to either straight: there it is held between
    the inner corner, width / cos(theta / 2) from the outer one, and the two outer walls that its far side touches. That
    takes width >= b cos(theta / 2) + l / 2 sin(theta / 2) for a rectangle l by b. It could turn in the straight itself
    where that is wider than the rectangle is at theta / 2 to it.
    """
    length, breadth = np.ptp(robot.footprint_base, axis=0)
    if shapely.Polygon(robot.footprint_base).area < length * breadth - 1e-6:
        return None
    half = turn_rad(shape) / 2
    across = breadth * math.cos(half) + length / 2 * math.sin(half)
    within = breadth * math.cos(half) + length * math.sin(half)
    return float(min(across, within))


def one_sweep_width_m(shape: str, robot: RobotModel, physics: PhysicsConfig) -> float | None:
    """Return the least width for the turn in one go: one arc forward at full lock, entered and left along the walls.

    The car comes along the outer wall, as near as its rear corner lets it, and its front corner just clears the outer
    wall that it turns to; the inner corner must lie within the circle that its inner side leaves free. To a millimetre;
    None from 10 m on.
    """
    if shape == "straight":
        return float(np.ptp(robot.footprint_base[:, 1]))
    # Frame: the turning centre of a left turn is the origin, the car comes along +x below it.
    radius = robot.wheelbase_m / math.tan(within_limits(physics, robot).max_steering_rad)
    outline = robot.footprint_base - (robot.rear_axle_x_m, radius)
    free = float(shapely.Polygon(outline).distance(shapely.Point(0.0, 0.0)))
    turn = math.radians(float(shape))
    below, beyond = _reach(outline, -math.pi / 2, turn), _reach(outline, turn - math.pi / 2, turn)
    ahead = _reach(outline, 0.0, turn)
    for width in np.arange(_STEP_M, _WIDEST_M, _STEP_M):
        if shape == "180":
            tips = [(ahead - width, width - below), (ahead - width, width - below + U_WALL_M)]
            fits = 2 * width + U_WALL_M >= below + beyond
        else:
            y = width - below
            tips = [((beyond - width + y * math.cos(turn)) / math.sin(turn), y)]
            fits = True
        if fits and max(math.hypot(*tip) for tip in tips) <= free:
            return round(float(width), 3)
    return None


def _reach(outline: NDArray[np.float64], direction_rad: float, turn_rad: float) -> float:
    """Return how far an outline that turns left about the origin by `turn_rad` gets in a direction."""
    radii, angles = np.hypot(*outline.T), np.arctan2(outline[:, 1], outline[:, 0])
    # From the corner to the direction, counter-clockwise; the turn takes the corner that far if it is large enough.
    missing = (direction_rad - angles) % (2 * math.pi)
    nearest = np.where(missing <= turn_rad, 0.0, np.minimum(np.abs(missing - turn_rad), 2 * math.pi - missing))
    return float((radii * np.cos(nearest)).max())
