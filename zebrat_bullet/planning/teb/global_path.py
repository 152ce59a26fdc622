"""The global plan as the local planner follows it: smoothed, pruned behind the car, cut at the lookahead."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

_SMOOTHED_M = 0.4


class GlobalPath:
    """A global plan and how far along it the car has come.

    Args:
        points: (N, 2) float64, m, world frame, evenly spaced but for a factor of two. A plan over cells has kinks
            where ROS's planners follow the smooth gradient of their potential, so it is averaged over 0.4 m first.
    """

    def __init__(self, points: NDArray[np.float64]) -> None:
        spacing = float(np.median(np.hypot(*np.diff(points, axis=0).T)))
        smooth = uniform_filter1d(points, 2 * round(0.5 * _SMOOTHED_M / spacing) + 1, axis=0, mode="nearest")
        smooth[0], smooth[-1] = points[0], points[-1]
        self._points = smooth
        self._length = np.append(0.0, np.cumsum(np.hypot(*np.diff(smooth, axis=0).T)))
        self._at = 0

    def distance_to(self, xy: NDArray[np.float64]) -> float:
        """Return how far in m a point is from the part of the plan not yet passed."""
        return float(np.hypot(*(self._points[self._at :] - xy).T).min())

    def ahead(self, xy: NDArray[np.float64], lookahead_m: float, part: float) -> tuple[NDArray[np.float64], float]:
        """Return the plan ahead of the car, (M, 2) in m with M >= 2, and the heading in rad at its end.

        Args:
            xy: (2,) where the car is; what it has passed is forgotten.
            lookahead_m: length of plan to return.
            part: of that length, unless the plan's end is within it already.
        """
        end = int(np.searchsorted(self._length, self._length[self._at] + lookahead_m))
        self._at += int(np.argmin(np.hypot(*(self._points[self._at : end + 1] - xy).T)))
        start_m = self._length[self._at]
        last = len(self._points) - 1
        if start_m + lookahead_m < self._length[-1]:
            last = int(np.searchsorted(self._length, start_m + part * lookahead_m))
        first = min(self._at, last - 1)
        dx, dy = self._points[min(last + 3, len(self._points) - 1)] - self._points[max(last - 1, 0)]
        return self._points[first : last + 1], math.atan2(dy, dx)
