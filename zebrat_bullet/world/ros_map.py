"""ROS map_server maps, read as map_server reads them and turned into upright walls."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL.Image import Image
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from zebrat_bullet.errors import WorldError
from zebrat_bullet.files import is_file, read_image, refusing, shown
from zebrat_bullet.geometry import rotation_2d
from zebrat_bullet.world.elements import MOST_COORDINATE_M
from zebrat_bullet.world.schema import StartSpec, Unknown, read_yaml
from zebrat_bullet.world.solid import Solid, polygons_of

IMAGE_SUFFIXES = (".pgm", ".png", ".ppm", ".pbm", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff", ".gif", ".webp")
FREE, UNKNOWN, OCCUPIED = 0, -1, 100
"""What a cell of an occupancy grid says (nav_msgs/OccupancyGrid)."""
# Walls with more corners have more triangles than PyBullet takes.
_MOST_CORNERS = 58_000
# Where unknown ground has more corners, only what is so far round the start is known, in so many cells each way.
_MOST_UNKNOWN_CORNERS = 10_000
_ROUND_START_M, _ROUND_START_CELLS = 3.0, 300
_HAIR_CELLS = 0.01
# What map_server makes of pixels that are see-through.
_ALPHA = {"trinary": " as dark", "scale": " as unknown", "raw": " for nothing"}
# Beyond these a map is taken as it is written, but hardly meant so.
_MOST_LIKELY_YAW_RAD, _COARSEST_LIKELY_M = 2 * math.pi, 0.5


def _lower(value: object) -> object:
    return value.lower() if isinstance(value, str) else value


Coordinate = Annotated[float, Field(ge=-MOST_COORDINATE_M, le=MOST_COORDINATE_M)]


class _MapFile(BaseModel):
    """The fields of a map_server file; those of other tools are left alone."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    image: Path
    resolution: Annotated[float, Field(gt=0, le=10)]
    origin: tuple[Coordinate, Coordinate, Coordinate]
    negate: bool = False
    occupied_thresh: Annotated[float, Field(ge=0, le=1)] = 0.65
    free_thresh: Annotated[float, Field(ge=0, le=1)] = 0.196
    mode: Annotated[Literal["trinary", "scale", "raw"], BeforeValidator(_lower)] = "trinary"


@dataclass(frozen=True)
class RosMap:
    """A map as walls.

    Attributes:
        solids: its occupied cells as upright walls, world frame.
        ground: all that the image shows.
        unknown: the cells that nobody has mapped, round the start at least; empty where they do not matter.
        notes: what was taken to be meant.
    """

    solids: list[Solid]
    ground: shapely.Polygon
    unknown: shapely.MultiPolygon
    notes: tuple[str, ...]


def read_ros_map(path: Path, height_m: float, unknown: Unknown | None, start: StartSpec) -> RosMap:
    """Read a map and make walls of the given height of its occupied cells.

    Args:
        path: its YAML file.
        height_m: of the walls.
        unknown: what unknown cells are: "free", "occupied" (walls) or "refused"; None: no walls, but the car does not
            begin there.
        start: where it begins.

    Raises:
        WorldError: names the field of the map file that is wrong.
    """
    spec, notes = _map_file(path)
    image_path = _image_of(path, spec, notes)
    with refusing(image_path, WorldError, "image: cannot be read as a map", "save it as 8-bit grey PNG or PGM"):
        values, see_through = _cell_values(read_image(image_path, WorldError), spec)
    cells = np.flipud(values)
    not_known = cells == UNKNOWN
    share = float(not_known.mean())
    if share and unknown == "refused":
        raise WorldError(f"{path}: unknown: {share:.1%} of the cells are unknown, and the world file refuses such maps")
    occupied = (cells == OCCUPIED) | not_known if unknown == "occupied" else cells == OCCUPIED
    if share and unknown is None:
        notes.append(
            f"{share:.0%} of the cells are unknown: no walls, but no car begins there; `unknown: occupied` or "
            "`unknown: free` in a world file says otherwise"
        )
    if not occupied.any():
        raise WorldError(
            f"{path}: occupied_thresh: no cell is darker than {spec.occupied_thresh}; lower it or negate (the image is "
            f"read in mode {spec.mode!r})"
        )
    if occupied.all() or (unknown != "free" and not (cells == FREE).any()):
        raise WorldError(f"{path}: image: no cell is free: {_shares(cells, see_through, spec)}")
    _check_corners(occupied, path)
    turn = rotation_2d(spec.origin[2]) * spec.resolution

    def placed(shape: Any) -> Any:
        return shapely.transform(shape, lambda points: points @ turn.T + spec.origin[:2])

    unknown_ground = shapely.MultiPolygon()
    if share and unknown is None and _n_corners(not_known) <= _MOST_UNKNOWN_CORNERS:
        unknown_ground = shapely.MultiPolygon(polygons_of(placed(_runs(not_known))))
    elif share and unknown is None and start.pose is not None:
        at = np.linalg.solve(turn, np.array(start.pose[:2]) - spec.origin[:2])
        reach = _ROUND_START_M + float(np.hypot(start.range_x_m, start.range_y_m))
        unknown_ground = shapely.MultiPolygon(polygons_of(placed(_near(not_known, at, reach / spec.resolution))))
    walls = polygons_of(placed(_cell_outlines(occupied)))
    n_rows, n_columns = occupied.shape
    return RosMap(
        [Solid(part, 0.0, height_m) for part in walls],
        placed(shapely.box(0, 0, n_columns, n_rows)),
        unknown_ground,
        tuple(notes),
    )


def refuse_image(path: Path) -> None:
    """Refuse an image that is handed over as if it were a map, and name the file that is meant.

    Raises:
        WorldError: always.
    """
    beside = next((at for suffix in (".yaml", ".yml") if is_file(at := path.with_suffix(suffix))), None)
    hint = (
        f"name {beside} instead"
        if beside is not None
        else f"write {path.with_suffix('.yaml').name} beside it with `image: {path.name}`, `resolution: 0.05` (m a "
        "cell) and `origin: [x, y, yaw]` of its lower left corner, and name that"
    )
    raise WorldError(f"{shown(path)}: is an image, which says neither scale nor place; {hint}")


def _map_file(path: Path) -> tuple[_MapFile, list[str]]:
    data = read_yaml(path)
    try:
        spec = _MapFile.model_validate(data)
    except ValidationError as error:
        lines = (
            f"{path}: {'.'.join(map(str, e['loc']))}: {e['msg']} (got {shown(repr(e['input']))})"
            for e in error.errors()
        )
        raise WorldError(
            "\n".join(lines) + "; a map needs image, resolution in m a cell and origin [x, y, yaw], finite numbers"
        ) from error
    others = sorted(set(data) - set(_MapFile.model_fields))
    notes = [f"fields of other tools left alone: {shown(', '.join(others))}"] if others else []
    if abs(spec.origin[2]) > _MOST_LIKELY_YAW_RAD:
        yaw = spec.origin[2]
        notes.append(
            f"origin: the map is turned by {yaw:g} rad, as written; if degrees are meant, write {math.radians(yaw):.4f}"
        )
    if spec.resolution > _COARSEST_LIKELY_M:
        notes.append(f"resolution: a cell is {spec.resolution:g} m wide, as written; 0.05 is usual")
    return spec, notes


def _image_of(path: Path, spec: _MapFile, notes: list[str]) -> Path:
    """Return where the image lies: as the file says, or, if it was moved there with the map, beside it."""
    with refusing(path, WorldError, "image: names no file", "correct the path"):
        named = path.parent / spec.image.expanduser()
    beside = path.parent / spec.image.name
    if is_file(named) or not is_file(beside):
        if not is_file(named):
            raise WorldError(f"{path}: image: no file {shown(named)}; correct the path, relative to this file")
        return named
    notes.append(f"there is no image {shown(named)}; the one of that name beside the map is taken")
    return beside


def _shares(cells: NDArray[np.int8], see_through: float, spec: _MapFile) -> str:
    """Say how cells of which none is free were read, by what, and what to do; `see_through` is the share of pixels."""
    occupied, unknown = (float((cells == value).mean()) for value in (OCCUPIED, UNKNOWN))
    said = (
        f"{occupied:.1%} of them are read as occupied, {unknown:.1%} as unknown (negate: {int(spec.negate)}, "
        f"occupied_thresh: {spec.occupied_thresh}, free_thresh: {spec.free_thresh}, mode: {spec.mode}); "
    )
    if see_through:
        said += f"{see_through:.1%} of the pixels are see-through, which counts{_ALPHA[spec.mode]}: save it on white "
        said += "without alpha, or "
    return said + "change negate or the thresholds" + (", or say `unknown: free` in a world file" if unknown else "")


def _cell_values(image: Image, spec: _MapFile) -> tuple[NDArray[np.int8], float]:
    """Return the (H, W) values of the cells, row 0 on top, as map_server finds them, and the share of see-through ones.

    They are `FREE`, `UNKNOWN` or `OCCUPIED`. Where map_server passes a number between free and occupied on (modes
    scale and raw), ours is unknown, as it is for AMCL.
    """
    level, white, see_through = _levels(image, averaged=spec.mode == "trinary")
    if spec.mode == "raw":
        value = np.round(level * np.float32(255.0 / white))
        known, occupancy = value <= 100.0, value / 100.0
        occupied = known & (occupancy >= spec.occupied_thresh)
        free = known & (occupancy <= spec.free_thresh)
    else:
        # As map_server calculates: a cell that is just as dark as a threshold lies on the same side of it.
        darkness = (level if spec.negate else white - level) / white
        occupied, free = darkness > spec.occupied_thresh, darkness < spec.free_thresh
        if spec.mode == "scale" and see_through is not None:
            occupied, free = occupied & ~see_through, free & ~see_through
    cells = np.full(level.shape, UNKNOWN, dtype=np.int8)
    cells[free] = FREE
    cells[occupied] = OCCUPIED
    return cells, 0.0 if see_through is None else float(see_through.mean())


def _levels(image: Image, averaged: bool) -> tuple[NDArray[np.float32], np.float32, NDArray[np.bool_] | None]:
    """Return the (H, W) levels of grey, that of white, and which pixels are see-through, None where none can be.

    Args:
        image: of any kind.
        averaged: alpha counts as one more colour, as in mode trinary of map_server.
    """
    if image.mode == "F":
        raise WorldError("pixels that are no whole numbers have no white")
    if image.mode.startswith("I"):
        whole = np.asarray(image)
        if int(whole.max()) > 65535 or int(whole.min()) < 0:
            raise WorldError("pixels beyond 16 bits have no white")
        return whole.astype(np.float32), np.float32(65535.0), None
    white = np.float32(255.0)
    if image.mode in ("1", "L"):
        return np.asarray(image.convert("L"), dtype=np.float32), white, None
    if image.mode in ("LA", "La", "PA", "RGBA", "RGBa") or "transparency" in image.info:
        bands = image.convert("RGBA").split()
        return _mean(bands if averaged else bands[:3]), white, np.asarray(bands[3]) < 255
    return _mean(image.convert("RGB").split()), white, None


def _mean(bands: Sequence[Image]) -> NDArray[np.float32]:
    """Return the (H, W) mean of channels, one at a time: all together they are many times the image."""
    total = np.zeros(bands[0].size[::-1], dtype=np.float32)
    for band in bands:
        total += np.asarray(band)
    mean: NDArray[np.float32] = np.divide(total, len(bands), dtype=np.float32)
    return mean


def _check_corners(occupied: NDArray[np.bool_], path: Path) -> None:
    """Refuse a map of more detail than can be driven in, before hours go into its outlines."""
    n = _n_corners(occupied)
    if n > _MOST_CORNERS:
        raise WorldError(
            f"{path}: image: the outlines of its occupied cells have {n} corners, and at most {_MOST_CORNERS} can be "
            "driven among; remove specks (a median filter in any image editor), crop it, or halve its size and double "
            "the resolution"
        )


def _n_corners(cells: NDArray[np.bool_]) -> int:
    padded = np.pad(cells, 1)
    a, b, c, d = padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]
    # A corner is where one or three of four cells are True, and twice where two meet in a point.
    return int((a ^ b ^ c ^ d).sum()) + 2 * int(((a == d) & (b == c) & (a != b)).sum())


def _near(cells: NDArray[np.bool_], at: NDArray[np.float64], reach: float) -> shapely.Geometry:
    """Return the outlines of the True cells within so many cells of a place."""
    n = int(min(np.ceil(reach), _ROUND_START_CELLS))
    column, row = (int(np.clip(np.floor(value), -n, max(cells.shape) + n)) for value in at)
    left, low = max(column - n, 0), max(row - n, 0)
    part = cells[low : max(row + n + 1, 0), left : max(column + n + 1, 0)]
    return shapely.transform(_runs(part), lambda points: points + np.array([left, low]))


def _runs(cells: NDArray[np.bool_], wider: float = 0.0) -> shapely.Geometry:
    """Return the outlines of the True cells of a grid, `wider` on every side, row 0 at y = 0, one unit a cell."""
    padded = np.pad(cells.astype(np.int8), ((0, 0), (1, 1)))
    steps = np.diff(padded, axis=1)
    rows, begins = np.nonzero(steps == 1)
    _, ends = np.nonzero(steps == -1)
    # Runs one above the other that begin and end alike are one box: fewer to join.
    order = np.lexsort((rows, ends, begins))
    rows, begins, ends = rows[order], begins[order], ends[order]
    first = np.ones(len(rows), dtype=bool)
    first[1:] = (np.diff(begins) != 0) | (np.diff(ends) != 0) | (np.diff(rows) != 1)
    tops = rows[np.append(np.flatnonzero(first)[1:], len(rows)) - 1] + 1 if len(rows) else rows
    return shapely.union_all(shapely.box(begins[first] - wider, rows[first] - wider, ends[first] + wider, tops + wider))


def _cell_outlines(occupied: NDArray[np.bool_]) -> shapely.Geometry:
    # Cells that meet in a corner only would make a body that touches itself in a point; a hair wider they overlap.
    return _runs(occupied, _HAIR_CELLS).simplify(0.0)
