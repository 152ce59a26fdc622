"""Upright solids: outlines extruded to watertight triangle meshes."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.world.world import Mesh

# What encloses less is a sheet with two sides.
_LEAST_VOLUME_M3 = 1e-9


@dataclass(frozen=True)
class Solid:
    """An upright prism: its outline, and the heights of its lower and upper face in m."""

    outline: shapely.Polygon
    bottom_m: float
    top_m: float
    low: bool = False


class ExtrudedMesh(Mesh):
    """The mesh of upright solids, made when it is first looked at: who drives in the plane never needs it."""

    def __init__(self, solids: Iterable[Solid]) -> None:
        self.solids = tuple(solids)

    @property
    def vertices(self) -> NDArray[np.float64]:
        """(V, 3) float64 in m, world frame."""
        return self._made.vertices

    @property
    def faces(self) -> NDArray[np.int32]:
        """(F, 3) int32, outward counter-clockwise."""
        return self._made.faces

    @cached_property
    def _made(self) -> Mesh:
        return join(extrude(solid.outline, solid.bottom_m, solid.top_m) for solid in self.solids)


def extrude(outline: shapely.Polygon, bottom_m: float, top_m: float) -> Mesh:
    """Return the closed prism over a polygon (holes allowed), faces outward."""
    outline = shapely.geometry.polygon.orient(outline)
    rings = [np.array(ring.coords)[:-1] for ring in (outline.exterior, *outline.interiors)]
    points = np.concatenate(rings)
    n = len(points)
    ends = np.cumsum([len(ring) for ring in rings])
    caps = _triangles(outline, points)
    here = np.arange(n)
    following = here + 1
    following[ends - 1] = np.concatenate([[0], ends[:-1]])
    sides = np.concatenate(
        [np.stack([here, following, following + n], axis=1), np.stack([here, following + n, here + n], axis=1)]
    )
    vertices = np.concatenate([np.column_stack([points, np.full(n, z)]) for z in (bottom_m, top_m)])
    return Mesh(vertices, np.concatenate([caps[:, ::-1], caps + n, sides]).astype(np.int32))


def _triangles(outline: shapely.Polygon, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return (T, 3) counter-clockwise triangles over a polygon's own (N, 2) corner points, all of them used.

    Not by ear cutting as trimesh does: that leaves out points on a straight line, and the prism would not close.
    """
    triangles = shapely.orient_polygons(shapely.get_parts(shapely.constrained_delaunay_triangles(outline)))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    index = {point: i for i, point in enumerate(map(tuple, points.tolist()))}
    return np.array([[index[tuple(corner)] for corner in triangle] for triangle in corners.tolist()], dtype=np.int64)


def join(meshes: Iterable[Mesh]) -> Mesh:
    """Return one mesh of all given bodies; nothing is merged, so closed bodies stay closed."""
    vertices, faces, offset = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int32)], 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces + np.int32(offset))
        offset += len(mesh.vertices)
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def is_watertight(mesh: Mesh) -> bool:
    """Return whether every edge runs as often one way as the other, and the bodies face outward.

    Bodies may touch along an edge or a face: then more than two faces meet there, and none is open all the same.
    """
    if len(mesh.faces) == 0:
        return False
    faces = mesh.faces.astype(np.int64)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    n = len(mesh.vertices)
    there = np.sort(edges[:, 0] * n + edges[:, 1])
    back = np.sort(edges[:, 1] * n + edges[:, 0])
    vertices = mesh.vertices - mesh.vertices[0]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0
    return bool((there == back).all()) and volume > _LEAST_VOLUME_M3


def polygons_of(shape: shapely.Geometry) -> list[shapely.Polygon]:
    """Return the polygons in any geometry, slivers under 1 square millimetre left out."""
    return [part for part in shapely.get_parts(shape).tolist() if part.geom_type == "Polygon" and part.area > 1e-6]
