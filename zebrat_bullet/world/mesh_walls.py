"""Where the walls of a mesh stand, seen from above."""

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray

from zebrat_bullet.config import FlattenConfig
from zebrat_bullet.world.elements import LOWEST_WALL_M
from zebrat_bullet.world.solid import Solid, polygons_of
from zebrat_bullet.world.world import Mesh

BAND_M = (FlattenConfig.height_min_m, LOWEST_WALL_M)
"""Heights that the flat scan is made of, and that a wall must fill to be seen wherever it is."""
HIGHEST_CUT_M = LOWEST_WALL_M - 0.01
"""What is none of the walls of a mesh begins above this height, or ends below the band."""
# Heights at which a mesh is cut; just beside round numbers, where corners lie.
_CUTS_M = (*(np.arange(0.1, LOWEST_WALL_M - 0.05, 0.1) + 2e-4), HIGHEST_CUT_M)
# A wall may lean by so much before its foot counts as a low wall beside it.
_LEANS_M = 0.01
# What reaches no further than this into a band of heights is not in it.
_HAIR_M = 1e-4
# Faces that are seen from the edge cover no ground.
_LEAST_FACE_M2 = 1e-9


def mesh_solids(closed: trimesh.Trimesh, surfaces: trimesh.Trimesh | None, thickness_m: float | None) -> list[Solid]:
    """Return the walls that closed bodies, and surfaces of a thickness, are within the height band of the flat scan.

    Args:
        closed: closed bodies, which may touch or overlap, in m, floor at z = 0.
        surfaces: open ones, or None.
        thickness_m: how thick these are.
    """
    layers = [_layer(closed, surfaces, thickness_m, height) for height in _CUTS_M]
    every = shapely.union_all(layers)
    low = every.difference(layers[-1]).buffer(-_LEANS_M / 2, join_style="mitre")
    low = low.buffer(_LEANS_M / 2 + 1e-6, join_style="mitre").intersection(every)
    between = _between_cuts(closed, surfaces, thickness_m, every)
    if not between.is_empty:
        every, low = every.union(between), low.union(between.difference(layers[-1]))
    tops = [body.bounds[1, 2] for body in (closed, surfaces) if body is not None and len(body.faces)]
    top = float(max(tops, default=LOWEST_WALL_M))
    if low.is_empty:
        return [Solid(part, 0.0, top) for part in polygons_of(every)]
    high = [Solid(part, 0.0, top) for part in polygons_of(every.difference(low))]
    corners = np.vstack([body.vertices for body in (closed, surfaces) if body is not None])
    corners = corners[(corners[:, 2] >= BAND_M[0]) & (corners[:, 2] < LOWEST_WALL_M)]
    return high + [Solid(part, 0.0, _top_of(part, corners), low=True) for part in polygons_of(low)]


def _top_of(part: shapely.Polygon, corners: NDArray[np.float64]) -> float:
    """Return the height of a low wall: that of the highest of (C, 3) corners over it."""
    over = shapely.intersects_xy(part.buffer(2 * _LEANS_M), *corners[:, :2].T)
    return float(corners[over, 2].max() if over.any() else _CUTS_M[0])


def seen_from_above(mesh: Mesh | trimesh.Trimesh, low_m: float, high_m: float) -> NDArray[np.float64]:
    """Return the (T, 3, 2) triangles that the faces of a mesh cover of the ground between two heights.

    Together with where any level between them is solid, they are all that the mesh covers there.
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    z = vertices[faces][:, :, 2]
    faces = faces[(z.max(axis=1) > low_m + _HAIR_M) & (z.min(axis=1) < high_m - _HAIR_M)]
    for upward, height in ((1.0, low_m), (-1.0, high_m)):
        vertices, faces, _ = trimesh.intersections.slice_faces_plane(
            vertices, faces, [0.0, 0.0, upward], [0.0, 0.0, height]
        )
    return vertices[faces][:, :, :2].reshape(-1, 3, 2)


def beyond(triangles: NDArray[np.float64], walls: shapely.Geometry) -> shapely.Geometry:
    """Return the ground under those of (T, 3, 2) triangles that reach further out than walls may lean."""
    a, b, c = (triangles[:, k] for k in range(3))
    twice_area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return _not_over(shapely.polygons(triangles[np.abs(twice_area) > 2 * _LEAST_FACE_M2]), walls)


def _not_over(shapes: NDArray[np.object_], walls: shapely.Geometry) -> shapely.Geometry:
    near = walls.buffer(_LEANS_M, join_style="mitre")
    shapely.prepare(near)
    return shapely.union_all(shapes[~shapely.covers(near, shapes)], grid_size=1e-5)


def _between_cuts(
    closed: trimesh.Trimesh, surfaces: trimesh.Trimesh | None, thickness_m: float | None, walls: shapely.Geometry
) -> shapely.Geometry:
    """Return what stands in the band and is in no cut: what ends below the lowest, or lies between two."""
    found = beyond(seen_from_above(closed, BAND_M[0], HIGHEST_CUT_M), walls)
    if surfaces is not None and thickness_m is not None:
        sheets = shapely.convex_hull(shapely.multipoints(seen_from_above(surfaces, BAND_M[0], HIGHEST_CUT_M)))
        thick = _not_over(sheets, walls).buffer(thickness_m / 2, cap_style="square", join_style="mitre")
        found = found.union(thick)
    return found


def _layer(
    closed: trimesh.Trimesh, surfaces: trimesh.Trimesh | None, thickness_m: float | None, height_m: float
) -> shapely.Geometry:
    parts: list[shapely.Geometry] = _filled(_cut(closed, height_m))
    if surfaces is not None and thickness_m is not None:
        edges = _cut(surfaces, height_m)
        if len(edges):
            lines = shapely.line_merge(shapely.union_all(shapely.linestrings(edges), grid_size=1e-5))
            parts.append(lines.buffer(thickness_m / 2, cap_style="square", join_style="mitre"))
    return shapely.union_all(parts)


def _cut(body: trimesh.Trimesh, height_m: float) -> NDArray[np.float64]:
    """Return the (E, 2, 2) edges in which a mesh meets a level, the solid to the left of each."""
    if not len(body.faces):
        return np.empty((0, 2, 2))
    edges, faces = trimesh.intersections.mesh_plane(body, [0.0, 0.0, 1.0], [0.0, 0.0, height_m], return_faces=True)
    if not len(edges):
        return np.empty((0, 2, 2))
    flat = np.asarray(edges)[:, :, :2]
    along, outward = flat[:, 1] - flat[:, 0], body.face_normals[faces][:, :2]
    wrong = along[:, 1] * outward[:, 0] - along[:, 0] * outward[:, 1] < 0
    flat[wrong] = flat[wrong, ::-1]
    return flat[np.abs(along).max(axis=1) > 1e-9]


def _filled(edges: NDArray[np.float64]) -> list[shapely.Geometry]:
    """Return the inside of the loops that (E, 2, 2) edges make: what they go round more often one way than the other.

    So bodies may overlap, and a hollow in a body stays hollow.
    """
    if not len(edges):
        return []
    lines = shapely.union_all(shapely.linestrings(edges), grid_size=1e-5)
    faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(lines))).tolist()
    return [face for face in faces if _winding(edges, face.representative_point()) != 0]


def _winding(edges: NDArray[np.float64], point: shapely.Point) -> int:
    (x0, y0), (x1, y1) = edges[:, 0].T, edges[:, 1].T
    up, down = (y0 <= point.y) & (y1 > point.y), (y0 > point.y) & (y1 <= point.y)
    spans = up | down
    x = x0[spans] + (point.y - y0[spans]) / (y1[spans] - y0[spans]) * (x1[spans] - x0[spans])
    return int(np.where(up[spans], 1, -1)[x > point.x].sum())
