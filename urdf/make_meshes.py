"""Makes the meshes of the shipped cars: `python urdf/make_meshes.py` writes meshes/*.stl.

They are for show, but for hexagon.stl, which is also the collision shape and so the footprint of hexagon.urdf.
"""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray

Points = NDArray[np.float64]
Warp = Callable[[Points], Points]

MESHES = Path(__file__).parent / "meshes"
WHEEL_RADIUS, WHEEL_WIDTH = 0.15, 0.09
AXLES_X = (-0.271, 0.289)
BODY_HALF_WIDTH, CABIN_HALF_WIDTH = 0.288, 0.245
HEXAGON = [(-0.6, 0.0), (-0.3, -0.35), (0.3, -0.35), (0.6, 0.0), (0.3, 0.35), (-0.3, 0.35)]
GRID = 0.05  # length of an edge, which smooth stripes and curves need


def rounded(points: list[tuple[float, float]], radius: float) -> shapely.Polygon:
    """Return a polygon with every corner rounded."""
    polygon = shapely.Polygon(points).buffer(-radius, 3).buffer(2 * radius, 3).buffer(-radius, 3)
    return shapely.geometry.polygon.orient(polygon)


def loft(outline: shapely.Polygon, half_width: float, edge: float, warp: Warp) -> trimesh.Trimesh:
    """Return the solid between y = -half_width and half_width over an outline (x, z), its rims rounded by `edge`."""
    ring = np.array(outline.segmentize(GRID).exterior.coords)[:-1]
    tangent = np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0)
    inward = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.linalg.norm(tangent, axis=1)[:, None]
    turn = np.linspace(0.0, np.pi / 2, 3)
    rim = [(half_width - edge + edge * np.sin(a), edge * (1 - np.cos(a))) for a in turn]
    flat = np.linspace(0.0, half_width - edge, 5)[:-1]
    half = [(y, 0.0) for y in flat] + rim
    layers = [(-y, inset) for y, inset in half[:0:-1]] + half
    rows = [np.insert(ring + inward * inset, 1, y, axis=1) for y, inset in layers]
    n = len(ring)
    here, following = np.arange(n), np.roll(np.arange(n), -1)
    quads = [
        np.concatenate(
            [
                np.column_stack([here + k * n, here + (k + 1) * n, following + k * n]),
                np.column_stack([following + k * n, here + (k + 1) * n, following + (k + 1) * n]),
            ]
        )
        for k in range(len(rows) - 1)
    ]
    parts = [trimesh.Trimesh(np.concatenate(rows), np.concatenate(quads), process=False)]
    for row in (rows[0], rows[-1]):
        flat_points, faces = trimesh.creation.triangulate_polygon(shapely.Polygon(row[:, [0, 2]]), engine="earcut")
        vertices, faces = trimesh.remesh.subdivide_to_size(np.insert(flat_points, 1, 0.0, axis=1), faces, 1.4 * GRID)
        vertices[:, 1] = row[0, 1]
        cap = trimesh.Trimesh(vertices, faces, process=False)
        if cap.face_normals[0, 1] * row[0, 1] < 0:
            cap.invert()
        parts.append(cap)
    solid = trimesh.util.concatenate(parts)
    solid.vertices = warp(solid.vertices)
    return solid


def side_panel(outline: shapely.Polygon, y: float, warp: Warp) -> trimesh.Trimesh:
    """Return two thin panels (x, z) on both sides of a loft with the same warp."""
    vertices, faces = trimesh.creation.triangulate_polygon(outline, engine="earcut")
    vertices, faces = trimesh.remesh.subdivide_to_size(np.insert(vertices, 1, y, axis=1), faces, 1.4 * GRID)
    left = trimesh.Trimesh(warp(vertices), faces)
    if left.face_normals[0, 1] < 0:
        left.invert()
    right = left.copy()
    right.apply_transform(np.diag([1.0, -1.0, 1.0, 1.0]))
    return trimesh.util.concatenate([left, right])


def across_panel(lower: tuple, upper: tuple) -> trimesh.Trimesh:
    """Return a pane from one side to the other, between (x, half width, z) below and above, 4 mm thick."""
    corners = [(x, side * y, z) for x, y, z in (lower, upper) for side in (-1, 1)]
    normal = np.cross(np.subtract(corners[1], corners[0]), np.subtract(corners[2], corners[0]))
    normal *= 0.004 / np.linalg.norm(normal)
    return trimesh.convex.convex_hull(np.concatenate([corners, np.array(corners) + normal]))


def striped(solid: trimesh.Trimesh, stripes: list[tuple[float, float, float]]) -> tuple[trimesh.Trimesh, ...]:
    """Cut a solid into (plain, stripes): each stripe, from back to front, is (x, width, lean of x with z).

    They are cut by planes in a space in which x is bent by height and side, so that they come out wavy.
    """

    def bend(points: Points, sign: float) -> Points:
        x, y, z = points.T
        bow = 0.022 * np.sin(13.0 * z + 5.0 * np.abs(y)) + 0.10 * np.abs(y)
        return np.column_stack([x + sign * bow, y, z])

    rest = trimesh.Trimesh(bend(solid.vertices, 1.0), solid.faces, process=False)
    plain, black = [], []
    for x, width, lean in stripes:
        tips = ((x - width / 2, lean + 0.04), (x + width / 2, lean - 0.04))  # planes that are not parallel: a taper
        for (at, slope), kept in zip(tips, (plain, black), strict=True):
            normal = np.array([1.0, 0.0, -slope])
            kept.append(rest.slice_plane((at, 0.0, 0.3), -normal))
            rest = rest.slice_plane((at, 0.0, 0.3), normal)
    plain.append(rest)
    parts = [trimesh.util.concatenate([part for part in kept if len(part.faces)]) for kept in (plain, black)]
    for part in parts:
        part.vertices = bend(part.vertices, -1.0)
    return tuple(parts)


def body_warp(points: Points) -> Points:
    """Narrow the nose, tail and shoulders, and crown the bonnet."""
    x, y, z = points.T
    side = np.abs(y) / BODY_HALF_WIDTH
    narrow = 1.0 - 0.10 * np.clip((np.abs(x) - 0.36) / 0.13, 0, 1) ** 2 - 0.07 * np.clip((z - 0.22) / 0.14, 0, 1) ** 2
    bow = np.sign(x) * 0.030 * side**2 * np.clip((np.abs(x) - 0.30) / 0.19, 0, 1)
    crown = 0.022 * side**2 * np.clip((z - 0.26) / 0.08, 0, 1)
    return np.column_stack([x - bow, y * narrow, z - crown])


def cabin_warp(points: Points) -> Points:
    """Lean the cabin's sides in towards the roof."""
    x, y, z = points.T
    return np.column_stack([x, y * (1.0 - 0.22 * np.clip((z - 0.33) / 0.14, 0, 1)), z])


def body() -> trimesh.Trimesh:
    """Return the body with its four wheel arches."""
    tail = [(-0.44, 0.368), (-0.482, 0.33), (-0.488, 0.12), (-0.45, 0.085)]
    nose = [(0.44, 0.085), (0.488, 0.13), (0.482, 0.30), (0.43, 0.335), (0.17, 0.368)]
    outline = rounded(tail + nose, 0.012)
    for x in AXLES_X:
        outline -= shapely.Point(x, WHEEL_RADIUS).buffer(WHEEL_RADIUS + 0.022, 10)
    outline -= shapely.box(-1.0, 0.0, 1.0, 0.086)
    return loft(shapely.geometry.polygon.orient(outline), BODY_HALF_WIDTH, 0.018, body_warp)


def cabin() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Return the cabin's shell and its windows."""
    shell = loft(
        rounded([(-0.455, 0.34), (0.20, 0.34), (0.06, 0.468), (-0.385, 0.468)], 0.010),
        CABIN_HALF_WIDTH,
        0.014,
        cabin_warp,
    )
    front_door = rounded([(-0.13, 0.378), (0.115, 0.378), (0.045, 0.446), (-0.13, 0.446)], 0.008)
    rear_door = rounded([(-0.16, 0.378), (-0.16, 0.446), (-0.365, 0.446), (-0.405, 0.378)], 0.008)
    panes = [side_panel(door, CABIN_HALF_WIDTH + 0.0015, cabin_warp) for door in (front_door, rear_door)]
    panes.append(across_panel((0.171, 0.205, 0.368), (0.089, 0.178, 0.443)))
    panes.append(across_panel((-0.443, -0.200, 0.372), (-0.399, -0.178, 0.443)))
    return shell, trimesh.util.concatenate(panes)


def tyre() -> trimesh.Trimesh:
    """Return a tyre about the y axis, its tread grooved."""
    w, r = WHEEL_WIDTH / 2, WHEEL_RADIUS
    profile = [(0.100, -w * 0.8), (0.112, -w), (r - 0.016, -w), (r - 0.004, -w * 0.86), (r, -w * 0.6)]
    for groove in (-0.35, 0.35):
        profile += [(r, w * (groove - 0.1)), (r - 0.006, w * (groove - 0.06))]
        profile += [(r - 0.006, w * (groove + 0.06)), (r, w * (groove + 0.1))]
    profile += [(r, w * 0.6), (r - 0.004, w * 0.86), (r - 0.016, w), (0.112, w), (0.100, w * 0.8), (0.100, -w * 0.8)]
    return about_y(trimesh.creation.revolve(profile, sections=48))


def rim() -> trimesh.Trimesh:
    """Return a five-spoke rim about the y axis, the same from both sides."""
    w = WHEEL_WIDTH / 2
    ring = [(0.092, -w * 0.85), (0.101, -w * 0.85), (0.101, w * 0.85), (0.092, w * 0.85), (0.092, -w * 0.85)]
    parts = [
        trimesh.creation.revolve(ring, sections=40),
        trimesh.creation.cylinder(0.026, WHEEL_WIDTH * 0.8, sections=20),
    ]
    for k in range(5):
        narrow, wide = 0.011, 0.019
        corners = [(0.015, s * wide, t * w * 0.72) for s in (-1, 1) for t in (-1, 1)]
        corners += [(0.096, s * narrow, t * w * 0.55) for s in (-1, 1) for t in (-1, 1)]
        spoke = trimesh.convex.convex_hull(np.array(corners))
        spoke.apply_transform(trimesh.transformations.rotation_matrix(2 * np.pi * k / 5, (0, 0, 1)))
        parts.append(spoke)
    return about_y(trimesh.util.concatenate(parts))


def about_y(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Turn a mesh about z into one about y."""
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    return mesh


def stack(layers: list[tuple[float, float]]) -> trimesh.Trimesh:
    """Return the hexagonal body through layers of (z, inset), lowest first."""
    rings = [
        np.insert(shapely.Polygon(HEXAGON).buffer(-inset, join_style="mitre").exterior.coords[:-1], 2, z, axis=1)
        for z, inset in layers
    ]
    pairs = pairwise(rings)
    return trimesh.util.concatenate([trimesh.convex.convex_hull(np.concatenate(pair)) for pair in pairs])


def main() -> None:
    """Write every mesh."""
    places = np.arange(-0.46, 0.60, 0.082)
    widths = 0.036 + 0.008 * np.sin(2.3 * np.arange(len(places)))
    stripes = [(float(x), float(width), 0.25 * np.sin(1.7 * x)) for x, width in zip(places, widths, strict=True)]
    shell, windows = cabin()
    body_white, body_black = striped(body(), stripes)
    cabin_white, cabin_black = striped(shell, stripes)
    MESHES.mkdir(exist_ok=True)
    meshes = {
        "coat": trimesh.util.concatenate([body_white, cabin_white]),
        "stripes": trimesh.util.concatenate([body_black, cabin_black]),
        "windows": windows,
        "tyre": tyre(),
        "rim": rim(),
        "hexagon": stack([(0.09, 0.0), (0.40, 0.0)]),
        "hexagon_coat": stack([(0.10, 0.03), (0.13, 0.006), (0.25, 0.006), (0.37, 0.10), (0.39, 0.14)]),
        "hexagon_trim": stack([(0.17, 0.0), (0.20, 0.0)]),
    }
    for name, mesh in meshes.items():
        mesh.export(MESHES / f"{name}.stl")
        print(f"{name}: {len(mesh.faces)} triangles")


if __name__ == "__main__":
    main()
