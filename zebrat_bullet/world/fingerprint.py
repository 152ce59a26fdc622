"""Tells worlds apart by their geometry."""

import hashlib
import json
from collections.abc import Iterable

import numpy as np
import shapely

from zebrat_bullet.world.world import Start, World

_DIGITS = 6


def fingerprint(world: World) -> str:
    """Return the SHA-256 of a world's walls, obstacles, start and exit, to a micrometre; names count for nothing."""
    line = [] if world.open_line is None else rounded(world.open_line)
    return digest([rounded_rings(world.walls), rounded_rings(world.low_obstacles), line, rounded_start(world.start)])


def digest(facts: list) -> str:
    """Return the SHA-256 of numbers."""
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


def rounded(values: object) -> list:
    """Return an array as lists of numbers, to a micrometre, so that what rounding did to the last digit is alike."""
    return (np.asarray(values, dtype=float).round(_DIGITS) + 0.0).tolist()


def rounded_rings(shapes: shapely.MultiPolygon) -> list:
    """Return the rings of polygons, to a micrometre, in an order of their own."""
    whole = shapely.transform(shapes, lambda points: points.round(_DIGITS) + 0.0).normalize()
    return [rounded(shapely.get_coordinates(ring)) for ring in shapely.get_rings(shapely.get_parts(whole))]


def rounded_start(start: Start) -> list:
    """Return pose and ranges of a start, to a micrometre."""
    pose = start.pose
    return rounded([pose.x, pose.y, pose.yaw, start.range_x_m, start.range_y_m, start.range_yaw_rad])


def joint_fingerprint(fingerprints: Iterable[str]) -> str:
    """Return one SHA-256 for several worlds in their order."""
    return hashlib.sha256("".join(fingerprints).encode()).hexdigest()
