"""Tells worlds apart by their geometry."""

import hashlib
import json
from collections.abc import Iterable

import numpy as np
import shapely

from zebrat_bullet.world.world import World

_DIGITS = 6


def fingerprint(world: World) -> str:
    """Return the SHA-256 of a world's walls, obstacles, start and exit, to a micrometre; names count for nothing."""

    def rounded(values: object) -> list:
        return (np.asarray(values, dtype=float).round(_DIGITS) + 0.0).tolist()

    start, facts = world.start, []
    for shapes in (world.walls, world.low_obstacles):
        whole = shapely.transform(shapes, lambda points: points.round(_DIGITS) + 0.0).normalize()
        facts.append([rounded(shapely.get_coordinates(ring)) for ring in shapely.get_rings(shapely.get_parts(whole))])
    facts.append([] if world.open_line is None else rounded(world.open_line))
    pose = start.pose
    facts.append(rounded([pose.x, pose.y, pose.yaw, start.range_x_m, start.range_y_m, start.range_yaw_rad]))
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


def joint_fingerprint(fingerprints: Iterable[str]) -> str:
    """Return one SHA-256 for several worlds in their order."""
    return hashlib.sha256("".join(fingerprints).encode()).hexdigest()
