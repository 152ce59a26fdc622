"""Worlds that others made: mesh files and ROS map_server maps, turned into upright walls."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from zebrat_bullet.errors import WorldError
from zebrat_bullet.geometry import rotation_2d
from zebrat_bullet.world.schema import LOWEST_WALL_M, read_yaml
from zebrat_bullet.world.solid import Solid, is_watertight, polygons_of
from zebrat_bullet.world.world import Mesh

MESH_SUFFIXES = (".obj", ".stl", ".ply", ".glb")
# Heights at which a mesh is cut to see where its walls stand: the band of the flat scan.
_CUTS_M = np.arange(0.1, LOWEST_WALL_M, 0.1)
_HAIR_CELLS = 0.01


class _RosMap(BaseModel):
    """The fields of a ROS map_server file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    image: Path
    resolution: Annotated[float, Field(gt=0)]
    origin: tuple[float, float, float]
    negate: Literal[0, 1] = 0
    occupied_thresh: Annotated[float, Field(ge=0, le=1)] = 0.65
    free_thresh: Annotated[float, Field(ge=0, le=1)] = 0.196
    mode: Literal["trinary", "scale", "raw"] = "trinary"


def read_mesh(path: Path) -> Mesh:
    """Read a mesh file in metres, z up, floor at z = 0; corner points at the same place are merged.

    Raises:
        WorldError: the file holds no triangles, or no closed bodies.
    """
    if not path.is_file():
        raise WorldError(f"{path}: mesh: no such file; correct the path, relative to the world file")
    try:
        loaded = trimesh.load(path, force="mesh")
    except Exception as error:
        raise WorldError(f"{path}: mesh: not readable ({error}); export it again as OBJ, STL, PLY or GLB") from error
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        raise WorldError(f"{path}: mesh: holds no triangles; export surfaces, not curves or points")
    loaded.merge_vertices(merge_tex=True, merge_norm=True)
    mesh = Mesh(np.array(loaded.vertices, dtype=np.float64), np.array(loaded.faces, dtype=np.int32))
    if not is_watertight(mesh):
        raise WorldError(
            f"{path}: mesh: not watertight, so a ray could pass through a wall; close its holes, merge double vertices "
            "and turn all faces outward (in Blender: Fill Holes, Merge by Distance, Recalculate Normals)"
        )
    return mesh


def mesh_outlines(mesh: Mesh) -> list[shapely.Polygon]:
    """Return where the solids of a closed mesh stand, seen from above, within the height band of the flat scan."""
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    layers = []
    for height in _CUTS_M:
        cut = trimesh.intersections.mesh_plane(body, [0.0, 0.0, 1.0], [0.0, 0.0, height])
        if len(cut):
            layers += _filled(np.asarray(cut)[:, :, :2])
    return polygons_of(shapely.union_all(layers))


def _filled(edges: NDArray[np.float64]) -> list[shapely.Polygon]:
    """Return the inside of the loops that (E, 2, 2) edges make, by the even-odd rule."""
    lines = shapely.union_all(shapely.linestrings(edges), grid_size=1e-5)
    faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(lines))).tolist()
    return [face for face in faces if _encloses(edges, face.representative_point())]


def _encloses(edges: NDArray[np.float64], point: shapely.Point) -> bool:
    (x0, y0), (x1, y1) = edges[:, 0].T, edges[:, 1].T
    spans = (y0 > point.y) != (y1 > point.y)
    x = x0[spans] + (point.y - y0[spans]) / (y1[spans] - y0[spans]) * (x1[spans] - x0[spans])
    return int((x > point.x).sum()) % 2 == 1


def read_ros_map(path: Path, height_m: float) -> list[Solid]:
    """Return the occupied cells of a ROS map as walls of the given height; unknown cells count as free.

    Raises:
        WorldError: names the field of the map file that is wrong.
    """
    try:
        spec = _RosMap.model_validate(read_yaml(path))
    except ValidationError as error:
        lines = (f"{path}: {'.'.join(map(str, e['loc']))}: {e['msg']} (got {e['input']!r})" for e in error.errors())
        raise WorldError("\n".join(lines) + "; a map needs image, resolution and origin [x, y, yaw]") from error
    image_path = path.parent / spec.image
    try:
        grey = np.array(Image.open(image_path).convert("L"), dtype=np.float64) / 255.0
    except (OSError, UnidentifiedImageError) as error:
        raise WorldError(f"{path}: image: cannot read {image_path} ({error}); correct the path") from error
    occupied = (grey if spec.negate else 1.0 - grey) > spec.occupied_thresh
    if not occupied.any():
        raise WorldError(f"{path}: occupied_thresh: no cell is darker than {spec.occupied_thresh}; lower it or negate")
    cells = _cell_outlines(np.flipud(occupied))
    turn = rotation_2d(spec.origin[2]) * spec.resolution
    placed = shapely.transform(cells, lambda points: points @ turn.T + spec.origin[:2])
    return [Solid(part, 0.0, height_m) for part in polygons_of(placed)]


def _cell_outlines(occupied: NDArray[np.bool_]) -> shapely.Geometry:
    """Return the outlines of the True cells of a grid, row 0 at y = 0, one unit a cell."""
    padded = np.pad(occupied.astype(np.int8), ((0, 0), (1, 1)))
    steps = np.diff(padded, axis=1)
    rows, begins = np.nonzero(steps == 1)
    _, ends = np.nonzero(steps == -1)
    joined = shapely.union_all(shapely.box(begins, rows, ends, rows + 1))
    # Cells that meet in a corner only would make a body that touches itself in a point; a hair wider they overlap.
    return joined.buffer(_HAIR_CELLS, join_style="mitre").simplify(0.0)
