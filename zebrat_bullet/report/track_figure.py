"""One figure of many tracks, all to the same scale, each with the car at its start."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from zebrat_bullet.geometry import to_world
from zebrat_bullet.world.summary import world_summary
from zebrat_bullet.world.world import World

WALL, _FLOOR, _LINE, CAR, EXIT, _TEXT = "#2f3b4c", "#eef2f7", "#9fb0c5", "#e4572e", "#2a9d6f", "#5b6778"
# Room round a track for the way out, and above it for its name, in m.
_GAP_M, _TITLE_M = 1.5, 2.1
_SCALE_BAR_M = 5.0
_INCH_PER_M = 0.30


def draw_worlds(worlds: Sequence[World], path: Path, footprint: NDArray[np.float64]) -> None:
    """Draw tracks to scale, side by side, into a PNG, SVG or PDF.

    Args:
        worlds: what to draw; one much taller than the others gets the left column.
        path: the picture to write.
        footprint: (K, 2) outline of the car in its base frame, m.
    """
    sizes = [_size(world) for world in worlds]
    corners, (width, height) = _pack(sizes)
    figure = Figure(figsize=(width * _INCH_PER_M, height * _INCH_PER_M), facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, width), ylim=(0.0, height), aspect="equal")
    axes.axis("off")
    for world, (left, top) in zip(worlds, corners, strict=True):
        low_x, _, _, high_y = _bounds(world)
        draw_track(axes, world, footprint, np.array([left - low_x, top - _TITLE_M - high_y]))
        _draw_title(axes, world, left, top)
    _draw_scale_bar(axes, width)
    figure.savefig(path, dpi=150)


def _bounds(world: World) -> tuple[float, float, float, float]:
    shown = [world.walls, shapely.MultiPoint(world.waypoints)] if len(world.waypoints) else [world.walls]
    bounds: tuple[float, float, float, float] = shapely.GeometryCollection(shown).bounds
    return bounds


def _size(world: World) -> tuple[float, float]:
    low_x, low_y, high_x, high_y = _bounds(world)
    # A title is at least so wide.
    return max(high_x - low_x, 8.5) + _GAP_M, high_y - low_y + _TITLE_M + _GAP_M


def _pack(sizes: list[tuple[float, float]]) -> tuple[list[tuple[float, float]], tuple[float, float]]:
    """Return the upper left corner of each box and the size of the smallest sheet that shelves of boxes make."""
    tall = max(range(len(sizes)), key=lambda i: sizes[i][1])
    column = len(sizes) > 2 and sizes[tall][1] > 1.4 * sorted(size[1] for size in sizes)[-2]
    begin, height = (sizes[tall]) if column else (0.0, 0.0)
    rest = [i for i in range(len(sizes)) if not (column and i == tall)]
    best: tuple[dict[int, tuple[float, float]], float, float] | None = None
    for shelf_m in np.linspace(max(sizes[i][0] for i in rest), max(sum(sizes[i][0] for i in rest) / 2, 1.0), 40):
        corners, width, depth = _shelves(sizes, rest, begin, float(shelf_m))
        depth = max(depth, height)
        if best is None or _cost(width, depth) < _cost(best[1], best[2]):
            best = corners, width, depth
    assert best is not None
    corners, width, depth = best[0] | ({tall: (0.0, 0.0)} if column else {}), best[1], best[2] + _GAP_M
    placed = [(corners[i][0] + _GAP_M / 2, corners[i][1] + depth - _GAP_M / 2) for i in range(len(sizes))]
    return placed, (width + _GAP_M / 2, depth)


def _cost(width: float, depth: float) -> float:
    """Return the area of a sheet; of one more than twice as long as wide, that of the sheet half as wide as long."""
    longer = max(width, depth)
    return longer * max(min(width, depth), longer / 2.0)


def _shelves(
    sizes: list[tuple[float, float]], order: list[int], begin: float, shelf_m: float
) -> tuple[dict[int, tuple[float, float]], float, float]:
    """Put boxes on shelves from the top; return their upper left corners, the right end and the depth of all."""
    corners: dict[int, tuple[float, float]] = {}
    x, y, shelf_depth, right = 0.0, 0.0, 0.0, 0.0
    for i in order:
        if x > 0.0 and x + sizes[i][0] > shelf_m + 1e-6:
            x, y, shelf_depth = 0.0, y - shelf_depth, 0.0
        corners[i] = (begin + x, y)
        x += sizes[i][0]
        right, shelf_depth = max(right, begin + x), max(shelf_depth, sizes[i][1])
    return corners, right, shelf_depth - y


def draw_track(axes: Axes, world: World, footprint: NDArray[np.float64], shift: NDArray[np.float64]) -> None:
    """Draw one track, moved by a (2,) shift in m: walls, the way out, and a car of this (K, 2) outline at its start."""
    if world.open_line is not None:
        axes.add_patch(patch(world.free_space, shift, facecolor=_FLOOR))
    for wall in world.walls.geoms:
        axes.add_patch(patch(wall, shift, facecolor=WALL, edgecolor="white", linewidth=0.3))
    if len(world.centre_line):
        axes.plot(*(world.centre_line + shift).T, color=_LINE, linewidth=1.0, linestyle=(0, (4, 3)), zorder=2)
    if world.open_line is not None:
        axes.plot(*(world.open_line + shift).T, color=EXIT, linewidth=2.2, solid_capstyle="butt", zorder=3)
        tip, tail = world.waypoints[-1] + shift, world.open_line.mean(axis=0) + shift
        arrow = {"arrowstyle": "-|>", "color": EXIT, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, tail, arrowprops=arrow, zorder=3)
    for gate in world.gates:
        axes.plot(*(gate + shift).T, color=EXIT, linewidth=2.2, marker="x", markersize=9, zorder=3)
    car = to_world(footprint, world.start.pose) + shift
    axes.add_patch(Polygon(car, facecolor=CAR, edgecolor="white", linewidth=0.6, zorder=4, joinstyle="round"))
    nose = float(footprint[:, 0].max())
    mark = to_world(np.array([[nose - 0.15, 0.0], [nose - 0.45, 0.16], [nose - 0.45, -0.16]]), world.start.pose) + shift
    axes.add_patch(Polygon(mark, facecolor="white", zorder=5))


def patch(shape: shapely.Polygon, shift: NDArray[np.float64], **style: object) -> PathPatch:
    """Return the patch of a polygon, moved by a (2,) shift in m, its holes left open."""
    rings = [Outline(np.array(ring.coords) + shift, closed=True) for ring in (shape.exterior, *shape.interiors)]
    return PathPatch(Outline.make_compound_path(*rings), **({"linewidth": 0.0} | style))


def _draw_title(axes: Axes, world: World, left: float, top: float) -> None:
    facts = world_summary(world)
    axes.text(left, top, world.name, fontsize=17, fontweight="bold", color=WALL, va="top")
    if facts["length_m"] is not None:
        line = f"{facts['length_m']:.1f} m long, narrowest {facts['narrowest_m']:.2f} m"
        axes.text(left, top - 0.95, line, fontsize=12, color=_TEXT, va="top")


def _draw_scale_bar(axes: Axes, width: float) -> None:
    right, y = width - _GAP_M / 2, 0.7
    axes.plot([right - _SCALE_BAR_M, right], [y, y], color=WALL, linewidth=2.5, solid_capstyle="butt")
    axes.text(
        right - _SCALE_BAR_M / 2, y + 0.2, f"{_SCALE_BAR_M:.0f} m", fontsize=13, color=WALL, ha="center", va="bottom"
    )
