"""A stroke drawn freehand becomes a few corners: smoothed, simplified, and as round as its bends are drawn."""

import math

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from zebrat_bullet.errors import WorldError
from zebrat_bullet.play.drawing import LONGEST_M, MOST_CORNERS, Drawing, lay, naming_the_field
from zebrat_bullet.robot import RobotModel

MOST_SAMPLES = 5000
_FAR_M = 500.0
SHORTEST_M = 0.5
_SPACING_M, _SHAKY_M = 0.05, 0.15
# Tried one after the other: few corners first, then as close to the hand as tight bends need, then ever more roughly.
_TOLERANCES_M = (0.12, 0.07, 0.04, 0.2, 0.35)
# A round bend leaves the corner of the line on its inner side, by so much at most.
_CUT_M = 0.3


def fit_stroke(samples: object, width_m: float, robot: RobotModel) -> Drawing:
    """Return the passage that was meant by a stroke.

    Args:
        samples: where the pen was, [[x, y], ...] in m.
        width_m: of the passage.
        robot: the car that is to drive there.

    Returns:
        The first of several simplifications that can be laid; if none can, the first, for its faults to be shown.

    Raises:
        WorldError: it is no stroke, one too short or too long, or the width is none of a passage.
    """
    line = _smoothed(_checked(samples))
    simple = [_simplified(line, tolerance) for tolerance in _TOLERANCES_M]
    with naming_the_field():
        fits = [_as_drawing(points, width_m) for points in simple if len(points) <= MOST_CORNERS]
    if not fits:
        raise WorldError("The line is too tangled to be a passage: draw it more plainly", at=_first(line))
    for drawing in fits:
        try:
            lay(drawing, robot)
        except WorldError:
            continue
        return drawing
    return fits[0]


def _checked(samples: object) -> NDArray[np.float64]:
    try:
        line = np.array(samples, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise WorldError("this is no stroke: a list of [x, y] in m is needed") from error
    if line.ndim != 2 or line.shape[1] != 2 or not 2 <= len(line) <= MOST_SAMPLES:
        raise WorldError(f"this is no stroke: 2 to {MOST_SAMPLES} points [x, y] are needed, got the shape {line.shape}")
    if not (np.abs(line) <= _FAR_M).all():  # nor where it is nan
        raise WorldError(f"this is no stroke: every number must lie within {_FAR_M:.0f} m")
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    if length < SHORTEST_M:
        raise WorldError(f"The line is {length:.2f} m long: drag on, for {SHORTEST_M} m at least", at=_first(line))
    if length > 2.0 * LONGEST_M:
        raise WorldError(f"The line is {length:.0f} m long; at most {LONGEST_M:.0f} m are drawn here")
    return line


def _smoothed(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N, 2) line evenly sampled, without the trembling of a hand; its ends stay."""
    distances = np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T).cumsum()])
    moved = np.concatenate([[True], np.diff(distances) > 0.0])
    at = np.linspace(0.0, distances[-1], max(2, math.ceil(distances[-1] / _SPACING_M)))
    even = np.column_stack([np.interp(at, distances[moved], axis[moved]) for axis in line.T])
    smooth: NDArray[np.float64] = gaussian_filter1d(even, _SHAKY_M / _SPACING_M, axis=0, mode="nearest")
    smooth[[0, -1]] = even[[0, -1]]
    return smooth


def _simplified(line: NDArray[np.float64], tolerance_m: float) -> NDArray[np.float64]:
    # Where the line crosses itself, keeping its topology would keep nearly all of its points.
    kept: NDArray[np.float64] = shapely.get_coordinates(
        shapely.LineString(line).simplify(tolerance_m, preserve_topology=False)
    )
    return kept


def _as_drawing(points: NDArray[np.float64], width_m: float) -> Drawing:
    yaws = np.arctan2(*np.diff(points, axis=0).T[::-1])
    turns = np.abs(np.remainder(np.diff(yaws) + math.pi, 2.0 * math.pi) - math.pi)
    cut = 1.0 / np.cos(np.minimum(turns, 2.9) / 2.0) - 1.0
    radii = np.minimum(_CUT_M / np.maximum(cut, 1e-6), 20.0)
    return Drawing(
        points=[(round(x, 3), round(y, 3)) for x, y in points.tolist()],
        widths=[width_m] * (len(points) - 1),
        radii=radii.round(2).tolist(),
    )


def _first(line: NDArray[np.float64]) -> tuple[float, float]:
    return float(line[0, 0]), float(line[0, 1])
