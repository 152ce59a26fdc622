"""Where the three representations watch the outlines of cars, drawn to one scale."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from numpy.typing import NDArray

from zebrat_bullet.config import LidarConfig, SafetyRegionConfig
from zebrat_bullet.files import shown
from zebrat_bullet.robot import Inspection
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.sensing.safety_region import SafetyRegion, make_region

_KINDS = {"sr": "safety region", "firect": "FIRect", "fifr": "FIFR"}
_BODY, _EDGE, _RAY, _POINT, _LIDAR = "#dfe5ee", "#5b6778", "#9fb0c5", "#2f6fb5", "#e4572e"
_PANEL_WIDTH_INCH, _ROOM_M, _TITLE_INCH = 4.2, 0.15, 0.35
_LINE_INCH, _LINE_CHARACTERS = 0.125, 125


def draw_regions(cars: Mapping[str, Inspection], config: SafetyRegionConfig, path: Path) -> None:
    """Draw a row for each car: its outline, axles, hinges and lidar, and what each representation watches.

    Every ray ends where a return nearer than it would be called a collision; cars head to the right. Of a car that is
    refused, what was understood is drawn, and beside it all that is wrong with it.

    Args:
        cars: by name.
        config: spacing and margin; all kinds are drawn, whichever it names.
        path: the picture to write (PNG, SVG or PDF).
    """
    n_bearings = LidarConfig().n_bearings
    rows = [
        [make_region(at.robot, replace(config, kind=kind), n_bearings) for kind in _KINDS] if at.robot else []
        for at in cars.values()
    ]
    boxes = [_bounds(row, at, n_bearings) for row, at in zip(rows, cars.values(), strict=True)]
    scale = _PANEL_WIDTH_INCH / max(box[1, 0] - box[0, 0] for box in boxes)
    said = [_wrapped(at.problems) for at in cars.values()]
    heights = [
        max(float(box[1, 1] - box[0, 1]) * scale, _LINE_INCH * len(lines)) + _TITLE_INCH
        for box, lines in zip(boxes, said, strict=True)
    ]
    size = _PANEL_WIDTH_INCH * len(_KINDS), sum(heights)
    figure = Figure(figsize=size, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(rows), len(_KINDS), squeeze=False, height_ratios=heights)
    width_m = _PANEL_WIDTH_INCH / scale
    for (name, seen), row, box, line, lines in zip(cars.items(), rows, boxes, panels, said, strict=True):
        middle_x = (box[0, 0] + box[1, 0]) / 2.0
        for axes in line:
            axes.set(xlim=(middle_x - width_m / 2, middle_x + width_m / 2), ylim=box[:, 1], aspect="equal")
            axes.axis("off")
        for kind, region, axes in zip(_KINDS, row, line, strict=False):
            _draw_region(axes, region, n_bearings)
            axes.set_title(f"{name}, {_KINDS[kind]}: {len(region.indices)} bearings", fontsize=10)
        _draw_understood(line[0], seen)
        if not row:
            line[0].axis("on")
            line[0].set_title(f"{shown(name, 40)}, refused; understood, in m:", fontsize=10)
            line[1].text(0.0, 1.0, "\n".join(lines), transform=line[1].transAxes, va="top", fontsize=7)
    figure.savefig(path, dpi=120)


def _wrapped(problems: Sequence[str]) -> list[str]:
    """Return the lines of a numbered list, as wide as two panels."""
    return [
        line for n, text in enumerate(problems, start=1) for line in textwrap.wrap(f"{n}. {text}", _LINE_CHARACTERS)
    ]


def _draw_understood(axes: Axes, seen: Inspection) -> None:
    """Draw what is known of a car, about its lidar where that is known."""
    origin = _origin(seen)
    if seen.robot is None and seen.body is not None and seen.body.outline is not None:
        axes.add_patch(Polygon(seen.body.outline - origin, facecolor=_BODY, edgecolor=_EDGE, linewidth=1.2))
    if seen.chassis is not None:
        wheels = zip(seen.chassis.wheels, seen.chassis.radii, seen.chassis.widths, strict=True)
        for (x, y, _), radius, width in wheels:
            width = max(width, 0.15 * radius)
            corner = (x - radius - origin[0], y - width / 2 - origin[1])
            axes.add_patch(Rectangle(corner, 2 * radius, width, facecolor="none", edgecolor=_EDGE, linewidth=0.9))
        for axle in (seen.chassis.wheels[:2], seen.chassis.wheels[2:]):
            axes.plot(*(axle[:, :2] - origin).T, color=_EDGE, linewidth=0.6)
        axes.plot(*(seen.chassis.hinges[:, :2] - origin).T, "+", color=_POINT, markersize=7.0)
    if seen.robot is None and seen.lidar_base is not None:
        axes.plot(*(seen.lidar_base[:2] - origin), "o", color=_LIDAR, markersize=6.0)


def _origin(seen: Inspection) -> NDArray[np.float64]:
    """Return the (2,) point of the base frame about which a car is drawn: its lidar, or where it is refused, 0."""
    return np.zeros(2) if seen.robot is None else np.asarray(seen.robot.lidar_xyz_base[:2])


def _ends(region: SafetyRegion, n_bearings: int) -> NDArray[np.float64]:
    """Return the (R, 2) ends in m of the region's rays, about the lidar."""
    bearings = beam_bearings(n_bearings)[region.indices]
    return region.range_m[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)


def _bounds(row: Sequence[SafetyRegion], seen: Inspection, n_bearings: int) -> NDArray[np.float64]:
    """Return the (2, 2) lower and upper corner in m that hold a car's outline, its wheels and all its rays."""
    found = [*(region.outline_lidar for region in row), *(_ends(region, n_bearings) for region in row)]
    if seen.body is not None and seen.body.outline is not None:
        found.append(seen.body.outline - _origin(seen))
    if seen.chassis is not None:
        found += [
            seen.chassis.wheels[:, :2] - _origin(seen) + reach
            for reach in (-float(seen.chassis.radii.max()), float(seen.chassis.radii.max()))
        ]
    points = np.concatenate(found or [np.array([(-0.5, -0.3), (0.5, 0.3)])])
    return np.array([points.min(axis=0) - _ROOM_M, points.max(axis=0) + _ROOM_M])


def _draw_region(axes: Axes, region: SafetyRegion, n_bearings: int) -> None:
    ends = _ends(region, n_bearings)
    axes.add_patch(Polygon(region.outline_lidar, facecolor=_BODY, edgecolor=_EDGE, linewidth=1.2))
    axes.add_collection(LineCollection([((0.0, 0.0), end) for end in ends], colors=_RAY, linewidths=0.7))
    axes.plot(*ends.T, "o", color=_POINT, markersize=3.2)
    axes.plot(0.0, 0.0, "o", color=_LIDAR, markersize=6.0)
