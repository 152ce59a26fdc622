"""A small picture of a place in a world: walls, how cars stood there in the end, and how one of them came."""

from collections.abc import Iterable, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.geometry import to_world
from zebrat_bullet.report.comparison.evidence import Drive, Way
from zebrat_bullet.report.comparison.figures import OUTCOMES, outcome_of
from zebrat_bullet.report.track_figure import EXIT, WALL
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World

_HALF_M = (4.0, 2.5)
_CM = 100.0
_MOST_CARS = 24


def draw_place(
    world: World, footprint: NDArray[np.float64], at: tuple[float, float], drives: Sequence[Drive], way: Way | None
) -> bytes:
    """Return an SVG, 8 by 5 m, in cm; the first drive's car is filled, those of the others are outlines.

    Args:
        world: where.
        footprint: (K, 2) outline of the car in its base frame, m.
        at: (x, y) of the middle, m, world frame.
        drives: whose ends are shown.
        way: how the first came there, if it is known.
    """
    low, high = np.subtract(at, _HALF_M), np.add(at, _HALF_M)
    colour = OUTCOMES[outcome_of(drives[0])]
    parts = [f'<path d="{_rings(_clipped(world.walls, low, high), low, high)}" fill="{WALL}" fill-rule="evenodd"/>']
    if world.open_line is not None:
        line = _clipped(shapely.LineString(world.open_line), low, high)
        parts.append(f'<path d="{_lines(line, low, high)}" fill="none" stroke="{EXIT}" stroke-width="6"/>')
    if way is not None and len(way) > 1:
        line = _clipped(shapely.LineString(way), low, high)
        parts.append(f'<path d="{_lines(line, low, high)}" fill="none" stroke="#2a6f97" stroke-width="5"/>')
    for i, drive in reversed(list(enumerate(drives[:_MOST_CARS]))):
        fill = (
            f'fill="{colour}" stroke="#fff" stroke-width="3"'
            if i == 0
            else f'fill="none" stroke="{colour}" stroke-width="2"'
        )
        parts.append(f'<path d="{_rings(_car(drive, footprint), low, high)}" {fill}/>')
    nose = _nose(drives[0], footprint)
    parts.append(f'<path d="{_rings(nose, low, high)}" fill="#fff"/>')
    size = f"{2 * _HALF_M[0] * _CM:.0f} {2 * _HALF_M[1] * _CM:.0f}"
    width, height = size.split()
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {size}">'
        f'<rect width="{width}" height="{height}" fill="#f4f6f9"/>{"".join(parts)}</svg>\n'
    ).encode()


def _pose(drive: Drive) -> Pose2:
    return Pose2(drive.x1 or 0.0, drive.y1 or 0.0, drive.yaw1 or 0.0)


def _car(drive: Drive, footprint: NDArray[np.float64]) -> shapely.Polygon:
    return shapely.Polygon(to_world(footprint, _pose(drive)))


def _nose(drive: Drive, footprint: NDArray[np.float64]) -> shapely.Polygon:
    tip = float(footprint[:, 0].max())
    mark = np.array([[tip - 0.12, 0.0], [tip - 0.38, 0.14], [tip - 0.38, -0.14]])
    return shapely.Polygon(to_world(mark, _pose(drive)))


def _clipped(shape: shapely.Geometry, low: NDArray[np.float64], high: NDArray[np.float64]) -> shapely.Geometry:
    return shapely.intersection(shape, shapely.box(*low, *high))


def _rings(shape: shapely.Geometry, low: NDArray[np.float64], high: NDArray[np.float64]) -> str:
    return "".join(f"{_d(ring.coords, low, high)}Z" for ring in shapely.get_rings(shapely.get_parts(shape)))


def _lines(shape: shapely.Geometry, low: NDArray[np.float64], high: NDArray[np.float64]) -> str:
    lines = [part for part in shapely.get_parts(shape) if part.geom_type == "LineString"]
    return "".join(_d(line.coords, low, high) for line in lines)


def _d(coordinates: Iterable[Sequence[float]], low: NDArray[np.float64], high: NDArray[np.float64]) -> str:
    """Return a path through (x, y) in m, in whole cm from the upper left corner."""
    cm = [(round((x - low[0]) * _CM), round((high[1] - y) * _CM)) for x, y in coordinates]
    return "M" + "L".join(f"{x} {y}" for x, y in cm)
