"""Refuses worlds made in Python that say what no world file could say."""

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.errors import WorldError
from zebrat_bullet.files import shown
from zebrat_bullet.world.elements import LOWEST_WALL_M, MOST_COORDINATE_M
from zebrat_bullet.world.goal import GATES, on_sides
from zebrat_bullet.world.solid import ExtrudedMesh
from zebrat_bullet.world.world import World

# Outlines that are joined again may differ by what rounding leaves.
_LEAST_WALL_M2 = 1e-3


def check_in_memory(world: World, source: str) -> None:
    """Check the numbers of a world that may come from nowhere, before a car is stood in it.

    Args:
        world: what was made, or replaced in part.
        source: its name, for the message.

    Raises:
        WorldError: names the field and the remedy.
    """
    start, gates = world.start, np.asarray(world.gates)
    if not all(abs(each) <= MOST_COORDINATE_M for each in start.pose):
        raise WorldError(
            f"{source}: start.pose: must be finite, within {MOST_COORDINATE_M:g} of 0, got {tuple(start.pose)}; move it"
        )
    ranges = (start.range_x_m, start.range_y_m, start.range_yaw_rad)
    if not all(0.0 <= each <= MOST_COORDINATE_M for each in ranges):
        raise WorldError(
            f"{source}: start: range_x_m, range_y_m and range_yaw_rad are half-widths and must be finite, 0 or more, "
            f"got {ranges}; correct them"
        )
    if gates.shape[1:] != (2, 2) or len(gates) > GATES or not np.isfinite(gates).all():
        raise WorldError(
            f"{source}: gates: must be finite, of the shape (G, 2, 2) with at most {GATES} gates, got "
            f"{shown(repr(gates.tolist()))}; leave out some"
        )
    if world.open_line is not None:
        _check_outward(world, np.asarray(world.open_line), source)
    _check_mesh(world, source)


def _check_outward(world: World, line: NDArray[np.float64], source: str) -> None:
    if line.shape != (2, 2) or not np.isfinite(line).all() or np.array_equal(*line):
        raise WorldError(
            f"{source}: open_line: must be two finite points that differ, got {shown(repr(line.tolist()))}; correct it"
        )
    if on_sides(line, world.free_space) == (True, False):
        raise WorldError(
            f"{source}: open_line: the way out must lie to the right when going from its first end to its second, and "
            "there lies the passage; swap its ends"
        )


def _check_mesh(world: World, source: str) -> None:
    """Refuse walls that physics would not know of, or that only physics knows of."""
    if not isinstance(world.mesh, ExtrudedMesh):
        return
    standing = shapely.union_all([each.outline for each in world.mesh.solids if each.bottom_m < LOWEST_WALL_M])
    if standing.symmetric_difference(world.walls).area > _LEAST_WALL_M2:
        raise WorldError(
            f"{source}: mesh: its outlines are not those of `walls`, so the car would hit what no planner knows of, or "
            "drive through walls; replace both (mesh=ExtrudedMesh([Solid(outline, bottom_m, top_m), ...]), of "
            "zebrat_bullet.world.solid), or write a world file"
        )
