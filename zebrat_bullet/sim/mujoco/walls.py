"""Walls as convex pieces: MuJoCo collides a mesh as its convex hull, and a ring's hull would fill the passage."""

from collections.abc import Iterator

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.world.solid import ExtrudedMesh, Solid, polygons_of
from zebrat_bullet.world.world import World

_THINNEST_M = 1e-6


def convex_prisms(world: World) -> Iterator[tuple[NDArray[np.float64], float, float]]:
    """Yield upright convex prisms that together fill the walls of a world: (K, 2) corners in m, bottom and top in m.

    The outlines are cut into triangles with corners of their own alone, so no wall grows or shrinks. A mesh that is not
    made of upright solids stands for its outlines, as high as it reaches.
    """
    for solid in _solids(world):
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(solid.outline))
        for triangle in triangles.tolist():
            corners = shapely.get_coordinates(triangle)[:3]
            if _thickness(corners) > _THINNEST_M:
                yield corners, solid.bottom_m, solid.top_m


def _solids(world: World) -> tuple[Solid, ...]:
    if isinstance(world.mesh, ExtrudedMesh):
        return world.mesh.solids
    top_m = float(world.mesh.vertices[:, 2].max(initial=0.0))
    return tuple(Solid(part, 0.0, top_m) for part in polygons_of(world.walls) if top_m > 0.0)


def _thickness(triangle: NDArray[np.float64]) -> float:
    """Return the least height of a (3, 2) triangle in m."""
    sides = np.roll(triangle, -1, axis=0) - triangle
    twice_area = abs(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0])
    return float(twice_area / np.hypot(*sides.T).max())
