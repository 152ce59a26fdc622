"""Where the three representations watch the outlines of cars, drawn to one scale."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from zebrat_bullet.config import LidarConfig, SafetyRegionConfig
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.sensing.safety_region import SafetyRegion, make_region

_KINDS = {"sr": "safety region", "firect": "FIRect", "fifr": "FIFR"}
_BODY, _EDGE, _RAY, _POINT, _LIDAR = "#dfe5ee", "#5b6778", "#9fb0c5", "#2f6fb5", "#e4572e"
_PANEL_WIDTH_INCH, _ROOM_M, _TITLE_INCH = 4.2, 0.15, 0.35


def draw_regions(robots: Sequence[tuple[str, RobotModel]], config: SafetyRegionConfig, path: Path) -> None:
    """Draw a row for each car: its outline, its lidar, and what each representation watches (PNG, SVG or PDF).

    Every ray ends where a return nearer than it would be called a collision; cars head to the right.

    Args:
        robots: names and cars.
        config: spacing and margin; all kinds are drawn, whichever it names.
        path: the picture to write.
    """
    n_bearings = LidarConfig().n_bearings
    rows = [[make_region(robot, replace(config, kind=kind), n_bearings) for kind in _KINDS] for _, robot in robots]
    boxes = [_bounds(row, n_bearings) for row in rows]
    scale = _PANEL_WIDTH_INCH / max(box[1, 0] - box[0, 0] for box in boxes)
    heights = [float(box[1, 1] - box[0, 1]) * scale + _TITLE_INCH for box in boxes]
    size = _PANEL_WIDTH_INCH * len(_KINDS), sum(heights)
    figure = Figure(figsize=size, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(rows), len(_KINDS), squeeze=False, height_ratios=heights)
    width_m = _PANEL_WIDTH_INCH / scale
    for (name, _), row, box, line in zip(robots, rows, boxes, panels, strict=True):
        middle_x = (box[0, 0] + box[1, 0]) / 2.0
        for kind, region, axes in zip(_KINDS, row, line, strict=True):
            _draw_region(axes, region, n_bearings)
            axes.set(xlim=(middle_x - width_m / 2, middle_x + width_m / 2), ylim=box[:, 1], aspect="equal")
            axes.set_title(f"{name}, {_KINDS[kind]}: {len(region.indices)} bearings", fontsize=10)
            axes.axis("off")
    figure.savefig(path, dpi=120)


def _ends(region: SafetyRegion, n_bearings: int) -> NDArray[np.float64]:
    """Return the (R, 2) ends in m of the region's rays, about the lidar."""
    bearings = beam_bearings(n_bearings)[region.indices]
    return region.range_m[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)


def _bounds(row: Sequence[SafetyRegion], n_bearings: int) -> NDArray[np.float64]:
    """Return the (2, 2) lower and upper corner in m, about the lidar, that hold a car's outline and all its rays."""
    points = np.concatenate([row[0].outline_lidar, *[_ends(region, n_bearings) for region in row]])
    return np.array([points.min(axis=0) - _ROOM_M, points.max(axis=0) + _ROOM_M])


def _draw_region(axes: Axes, region: SafetyRegion, n_bearings: int) -> None:
    ends = _ends(region, n_bearings)
    axes.add_patch(Polygon(region.outline_lidar, facecolor=_BODY, edgecolor=_EDGE, linewidth=1.2))
    axes.add_collection(LineCollection([((0.0, 0.0), end) for end in ends], colors=_RAY, linewidths=0.7))
    axes.plot(*ends.T, "o", color=_POINT, markersize=3.2)
    axes.plot(0.0, 0.0, "o", color=_LIDAR, markersize=6.0)
