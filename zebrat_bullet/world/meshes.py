"""Mesh files that others made, brought to metres, z up, floor at z = 0, and closed."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from zebrat_bullet.errors import WorldError
from zebrat_bullet.files import is_file, refusing, require_file, shown
from zebrat_bullet.world.mesh_walls import BAND_M, mesh_solids
from zebrat_bullet.world.schema import WorldSpec
from zebrat_bullet.world.solid import ExtrudedMesh, Solid, is_watertight, join
from zebrat_bullet.world.world import Mesh

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".glb")
OTHER_SUFFIXES = {
    ".world": "is a Gazebo world: export the meshes of its models as one OBJ, STL, PLY or GLB",
    ".sdf": "is a Gazebo model: export its meshes as one OBJ, STL, PLY or GLB",
    ".urdf": "describes a robot: export the meshes of a place as one OBJ, STL, PLY or GLB",
    **dict.fromkeys(
        (".dae", ".gltf", ".fbx", ".blend", ".step", ".stp", ".3ds", ".usd", ".usda", ".usdz", ".dxf", ".off", ".3mf"),
        "is a kind of mesh that is not read: export it as OBJ, STL, PLY or GLB, in metres",
    ),
}
_MOST_FACES = 2_000_000
# Longer than this, a drawing is in millimetres, if its walls then are of a height that walls have.
_LONGEST_M, _MM_HEIGHT_M = 1000.0, (0.2, 20.0)
# Longer than this, one in metres is not what this car drives in.
_LONG_M = 100.0
_NEAR_FLOOR_M = 0.05
# A slab under walls is at most so thick, and covers at least this share of the ground.
_SLAB_M, _SLAB_SHARE, _ABOVE_SLAB_M = 0.5, 0.5, 0.3
# What is thinner is no slab, or its face is on the floor already.
_THINNEST_SLAB_M = 1e-3
# Its face lies so far below the floor that nothing ever touches it.
_BELOW_FLOOR_M = 0.002
_MERGE_DIGITS = (None, 4)


@dataclass(frozen=True)
class MeshWalls:
    """A mesh file as walls.

    Attributes:
        mesh: closed, m, z up, floor at z = 0.
        solids: where its walls stand; those are `low` whose top the lidar can lose.
        notes: what was taken to be meant.
    """

    mesh: Mesh
    solids: list[Solid]
    notes: tuple[str, ...]


def read_mesh(path: Path, spec: WorldSpec) -> MeshWalls:
    """Read a mesh file as a world file says it is meant, or as its own extents say where that leaves no doubt.

    Raises:
        WorldError: the file holds no triangles, no walls, or no closed bodies.
    """
    notes: list[str] = []
    body = _load(path)
    _turn_upright(body, path, spec, notes)
    closed, surfaces = _bodies(body, path, spec.thickness_m, notes)
    _lift_off_slab(closed, surfaces, spec, notes)
    solids = mesh_solids(closed, surfaces, spec.thickness_m)
    if not solids:
        raise WorldError(
            f"{path}: mesh: no wall stands between {BAND_M[0]} and {BAND_M[1]} m, the heights of the scan; "
            f"{_extents(body)}; set `scale`, `up: y` or `offset: [0, 0, z]` in a world file so that its floor is z = 0"
        )
    low = [solid for solid in solids if solid.low]
    if low and not spec.low:
        x, y = low[0].outline.representative_point().coords[0]
        raise WorldError(
            f"{path}: mesh: the wall at ({x:.2f}, {y:.2f}) ends {low[0].top_m:.2g} m above the floor, and the lidar "
            f"can lose what is lower than {BAND_M[1]} m; make it higher, or declare such walls with `low: true` in a "
            f"world file; {_extents(body)}"
        )
    made = ExtrudedMesh(solids) if surfaces is not None else None
    mesh = Mesh(np.array(closed.vertices, dtype=np.float64), np.array(closed.faces, dtype=np.int32))
    if made is not None:
        mesh = join([mesh, made]) if len(mesh.faces) else join([made])
    return MeshWalls(mesh, solids, tuple(notes))


def refuse_other(path: Path) -> None:
    """Refuse a file by its kind, if that is one that others use for places.

    Raises:
        WorldError: it is.
    """
    why = OTHER_SUFFIXES.get(path.suffix.lower())
    if why is not None:
        raise WorldError(f"{shown(path)}: mesh: {path.suffix} {why}")


def _load(path: Path) -> trimesh.Trimesh:
    """Return the triangles of a file, corner points at the same place merged."""
    if not is_file(path):
        raise WorldError(f"{shown(path)}: mesh: no such file; correct the path, relative to the world file")
    refuse_other(path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise WorldError(f"{shown(path)}: mesh: {path.suffix!r} is not read; export it as OBJ, STL, PLY or GLB")
    require_file(path, WorldError)
    with refusing(path, WorldError, "mesh: not readable", "export it again as OBJ, STL, PLY or GLB"):
        # What one writes in millimetres or with an axis of its own is for the world file to say.
        loaded = trimesh.load(path, force="mesh", skip_materials=True)
        if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
            raise WorldError(f"{path}: mesh: holds no triangles; export surfaces, not curves or points")
        if len(loaded.faces) > _MOST_FACES:
            raise WorldError(f"{path}: mesh: {len(loaded.faces)} faces, more than {_MOST_FACES}; simplify it")
        if loaded.faces.min() < 0 or loaded.faces.max() >= len(loaded.vertices):
            raise WorldError(f"{path}: mesh: a face names a corner that there is not; export it again")
        if not np.isfinite(loaded.vertices).all() or np.abs(loaded.vertices).max() > 1e8:
            raise WorldError(f"{path}: mesh: a corner is not a finite number, or beyond all measure; export it again")
        loaded.merge_vertices(merge_tex=True, merge_norm=True)
        return loaded


def _turn_upright(body: trimesh.Trimesh, path: Path, spec: WorldSpec, notes: list[str]) -> None:
    """Bring the mesh to metres, z up, and where the file says it stands."""
    up = spec.up
    if up is None and _is_y_up(body.bounds, path.suffix.lower() == ".glb"):
        up = "y"
        notes.append("taken as y-up, by its extents (`up: z` in a world file says otherwise)")
    if up == "y":
        # Not in place: what is cached of a mesh outlives its corners.
        body.vertices = body.vertices @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    scale = spec.scale
    height = float(np.ptp(body.vertices[:, 2])) / 1000.0
    longest = float(np.ptp(body.vertices, axis=0).max())
    if scale is None and longest >= _LONGEST_M and _MM_HEIGHT_M[0] <= height <= _MM_HEIGHT_M[1]:
        scale = 0.001
        notes.append(f"{longest:.0f} long, so taken as millimetres (`scale: 1` in a world file says otherwise)")
    elif scale is None and longest >= _LONG_M:
        notes.append(f"taken as metres, {longest:.0f} of them (`scale: 0.01` in a world file if it is in centimetres)")
    body.vertices = body.vertices * (scale or 1.0) + np.array(spec.offset or (0.0, 0.0, 0.0))


def _is_y_up(bounds: NDArray[np.float64], by_standard: bool) -> bool:
    """Return whether a mesh must be meant y-up: it stands on y = 0 and is flat that way, and z = 0 is no floor of it.

    Args:
        bounds: (2, 3) least and greatest corner.
        by_standard: the file's format is y-up by its standard, as GLB's: then it is so unless all speaks for z.
    """
    low, size = bounds[0], np.ptp(bounds, axis=0)
    on_floor = np.abs(low) <= _NEAR_FLOOR_M * np.maximum(size, 1.0)
    flat_y, flat_z = size[1] <= size[[0, 2]].min(), size[2] <= size[:2].min()
    if by_standard:
        return bool(not on_floor[2] and on_floor[1]) or bool(flat_y and not flat_z)
    return bool(on_floor[1] and flat_y and not flat_z and not on_floor[2])


def _bodies(
    body: trimesh.Trimesh, path: Path, thickness_m: float | None, notes: list[str]
) -> tuple[trimesh.Trimesh, trimesh.Trimesh | None]:
    """Return the closed bodies of a mesh as one, and its open surfaces, None where there are none that stand."""
    for digits in _MERGE_DIGITS:
        if digits is not None:
            body.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=digits)
        if _closed(body):
            return body, None
    with refusing(path, WorldError, "mesh: its faces cannot be turned outward", "recalculate normals and export again"):
        trimesh.repair.fix_normals(body, multibody=True)
    if _closed(body):
        notes.append("faces that looked inward were turned outward")
        return body, None
    parts = body.split(only_watertight=False, repair=False)
    closed = [part for part in parts if _closed(part)]
    open_ = [part for part in parts if not _closed(part)]
    flat = [part for part in open_ if _lies_flat(part)]
    standing = [part for part in open_ if not _lies_flat(part)]
    if flat:
        notes.append("surfaces that lie flat on the floor or hang above the car are no walls")
    if standing and thickness_m is None:
        raise WorldError(
            f"{path}: mesh: not watertight, so a ray could pass through a wall: {len(standing)} of its {len(parts)} "
            "parts are open; close its holes, merge double vertices and turn all faces outward (in Blender: Fill "
            "Holes, Merge by Distance, Recalculate Normals), or make walls of its surfaces: `thickness_m: 0.1` in a "
            f"world file; {_extents(body)}"
        )
    none = trimesh.Trimesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64), process=False)
    return (_joined(closed) if closed else none), (_joined(standing) if standing else None)


def _joined(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    made: trimesh.Trimesh = trimesh.util.concatenate(parts)  # type: ignore[assignment]
    return made


def _closed(body: trimesh.Trimesh) -> bool:
    return is_watertight(Mesh(np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int32)))


def _lies_flat(part: trimesh.Trimesh) -> bool:
    """Return whether an open surface is a floor or a ceiling, beside the heights that the scan is made of."""
    low, high = part.bounds[:, 2]
    return bool(high <= BAND_M[0] or low >= BAND_M[1])


def _lift_off_slab(
    closed: trimesh.Trimesh, surfaces: trimesh.Trimesh | None, spec: WorldSpec, notes: list[str]
) -> None:
    """Lower a mesh whose walls stand on a slab, so that the slab's upper face is the floor."""
    if spec.offset is not None or not len(closed.faces):
        return
    low = float(closed.bounds[0, 2])
    high = max(float(body.bounds[1, 2]) for body in (closed, surfaces) if body is not None)
    upward = closed.face_normals[:, 2] > 0.999
    heights = closed.triangles_center[upward, 2].round(3)
    areas = closed.area_faces[upward]
    ground = float(np.prod(np.ptp(closed.bounds[:, :2], axis=0)))
    for height in np.unique(heights):
        thickness = round(height - low, 6)
        of_slab = _THINNEST_SLAB_M <= thickness <= _SLAB_M and height + _ABOVE_SLAB_M <= high
        if height >= _THINNEST_SLAB_M and of_slab and areas[heights == height].sum() >= _SLAB_SHARE * ground:
            notes.append(f"the slab {thickness:.3g} m thick under its walls is taken as the floor")
            for body in (closed, surfaces):
                if body is not None:
                    body.vertices = body.vertices - (0.0, 0.0, height + _BELOW_FLOOR_M)
            return


def _extents(body: trimesh.Trimesh) -> str:
    """Say how large a mesh is, and how much of it stands where the scan is made."""
    sizes = [f"{axis} {low:.2f} to {high:.2f}" for axis, low, high in zip("xyz", *body.bounds, strict=True)]
    z = body.triangles[:, :, 2]
    share = float(((z.max(axis=1) > BAND_M[0]) & (z.min(axis=1) < BAND_M[1])).mean())
    return f"it reaches from {', '.join(sizes)} m, and {share:.0%} of its faces stand in that band"
