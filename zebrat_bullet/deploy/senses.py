"""What a real lidar sends, checked, as the cloud and the flat scan that the policy was trained with."""

import math

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import SensorError
from zebrat_bullet.files import shown
from zebrat_bullet.types import FlatScan, PointCloud

EARLY = 0.75
"""A scan that comes sooner than this share of a control step after the last is not driven by: a lidar at 10 Hz."""
_ORIGIN_M = 0.01
"""Nearer than this a point is none: many lidars report a lost ray as the origin."""
_REACH = 1.0 - 1e-6
"""A point at the reach itself may stand a rounding error before it."""
_SECTORS = 8
MOST_HEIGHT_M = 10.0
"""Of a lidar above the floor; higher is no number of m."""
_SLACK = 0.01
"""Of a bearing's step: 360 rays from -pi to pi, both named, stand 1.003 degrees apart."""
_MOST_POINTS = 10_000_000
_MOST_RAYS = 100_000


def cloud_of(
    points_lidar: object,
    rotation_level: object,
    height_m: float,
    range_max_m: float,
    least_points: int,
    least_sector_points: int = 0,
) -> PointCloud:
    """Return a cloud as the lidar of the training would report it, what it could not see marked as no return.

    Args:
        points_lidar: (N, 3) float32 or float64, m, lidar frame.
        rotation_level: (3, 3), turns lidar-frame vectors into the gravity-levelled frame at the lidar.
        height_m: of the lidar above the floor.
        range_max_m: reach of the training's lidar.
        least_points: returns within it.
        least_sector_points: of these, in each eighth of a turn about the lidar.

    Raises:
        SensorError: an array is of another shape or kind, or there are too few returns, all around or on one side.
    """
    points = _floats(points_lidar, "a cloud", "(N, 3)", 2, _MOST_POINTS)
    if points.shape[1] != 3:
        raise SensorError(f"a cloud is an array of shape (N, 3), got {points.shape}; give x, y and z of each point")
    rotation = _rotation(rotation_level)
    if not (isinstance(height_m, float | int | np.number) and 0.0 <= height_m <= MOST_HEIGHT_M):
        raise SensorError(
            f"the lidar's height above the floor is 0 to {MOST_HEIGHT_M:g} m, got {shown(repr(height_m))}"
        )
    with np.errstate(invalid="ignore", over="ignore"):
        squared = np.einsum("nd,nd->n", points, points)  # nan and inf stay what they are, and compare as False
        valid = (squared >= _ORIGIN_M**2) & (squared < (range_max_m * _REACH) ** 2)
    if (n := int(np.count_nonzero(valid))) < least_points:
        raise SensorError(
            f"{n} of {len(points)} points are returns within {range_max_m:g} m, at least {least_points} are needed; "
            "look whether the lidar is covered or its driver leaves points out"
        )
    x, y = points[valid, 0], points[valid, 1]
    # Without an arctangent: the signs name the quarter, the greater coordinate its half.
    sectors = np.bincount((x > 0.0) * 4 + (y > 0.0) * 2 + (abs(x) > abs(y)), minlength=_SECTORS)
    if (fewest := int(sectors.min())) < least_sector_points:
        raise SensorError(
            f"an eighth of the turn about the lidar holds {fewest} returns, at least {least_sector_points} are needed, "
            "of walls or floor; look whether the lidar is covered on a side or its driver sends parts of a turn; where "
            "it cannot see the floor, allow it (least_sector_points 0)"
        )
    return PointCloud(points, valid, rotation, float(height_m))


def turned_rays(rotation: NDArray[np.floating], first_rad: float, step_rad: float) -> tuple[float, float]:
    """Return at which bearing the rays of a level scan begin in another level frame, and their step there.

    Args:
        rotation: (3, 3) turns vectors of the scan's frame into the other one: about the vertical, or upside down too.
        first_rad, step_rad: in the scan's own frame, counter-clockwise from its x axis.
    """
    yaw, sense = math.atan2(rotation[1, 0], rotation[0, 0]), 1.0 if rotation[2, 2] > 0.0 else -1.0
    turned = yaw + sense * first_rad
    # What is no bearing stays none, to be refused.
    return math.remainder(turned, 2.0 * math.pi) if abs(first_rad) <= 2.0 * math.pi else first_rad, sense * step_rad


class ScanReader:
    """Turns 2D scans of any number of rays into flat scans: the nearest return of each bearing.

    A ray counts for the bearings that are at most half a bearing's step away. A bearing all of whose rays were lost has
    the nearer range of its two neighbours; one whose neighbours were lost too is unknown.

    Args:
        n_bearings: of the flat scan.
        needed: (R,) indices of the bearings that must be known.
        range_max_m: reach of the training's lidar.
        least_share: of the rays, that must have a return within it.
    """

    def __init__(self, n_bearings: int, needed: NDArray[np.intp], range_max_m: float, least_share: float) -> None:
        self._n_bearings, self._needed = n_bearings, needed
        self._range_max_m, self._least_share = range_max_m, least_share
        self._laid: tuple[int, float, float] | None = None
        self._rays = self._bearings = np.zeros(0, np.intp)

    def read(self, ranges_m: object, angle_min_rad: float, angle_increment_rad: float | None) -> FlatScan:
        """Return the flat scan, nan in a bearing that no ray looked into.

        Raises:
            SensorError: the array is of another shape or kind, its rays are too coarse or leave out a bearing that is
                needed, or too little was seen.
        """
        ranges = _floats(ranges_m, "a scan", "(n,)", 1, _MOST_RAYS)
        self._lay(len(ranges), angle_min_rad, angle_increment_rad)
        if (ranges < 0.0).any():
            raise SensorError(f"a ray reads {ranges.min()} m: something is too near to be measured; clear the lidar")
        ranges = np.where(ranges == 0.0, np.nan, ranges)
        n = int(np.count_nonzero(ranges < self._range_max_m))
        if n < self._least_share * len(ranges):
            raise SensorError(
                f"{n} of {len(ranges)} rays have a return within {self._range_max_m:g} m, at least "
                f"{self._least_share:.0%} are needed; look whether the lidar is covered or turned away"
            )
        # fmin prefers a number to nan, so a bearing is nan where every ray into it was lost.
        scan = np.full(self._n_bearings, np.nan, np.float32)
        np.fmin.at(scan, self._bearings, np.minimum(ranges, self._range_max_m).astype(np.float32)[self._rays])
        around = np.fmin(np.roll(scan, 1), np.roll(scan, -1))
        looked = np.zeros(self._n_bearings, bool)
        looked[self._bearings] = True
        scan = np.where(np.isnan(scan) & looked, around, scan)
        if np.isnan(scan[self._needed]).any():
            n_lost = int(np.isnan(scan[self._needed]).sum())
            raise SensorError(
                f"the rays to {n_lost} of the {len(self._needed)} bearings that the policy watches were lost, and "
                "those beside them; clean the lidar"
            )
        return FlatScan(scan, self._range_max_m)

    def _lay(self, n_rays: int, angle_min_rad: float, angle_increment_rad: float | None) -> None:
        """Find which rays look into which bearings, once for all scans that are alike."""
        step = 2.0 * math.pi / self._n_bearings
        increment = 2.0 * math.pi / max(n_rays, 1) if angle_increment_rad is None else angle_increment_rad
        if self._laid == (n_rays, angle_min_rad, increment):
            return
        numbers = all(isinstance(each, float | int | np.number) for each in (angle_min_rad, increment))
        if not (numbers and abs(angle_min_rad) <= 2.0 * math.pi and 0.0 < abs(increment) <= 2.0 * math.pi):
            raise SensorError(
                f"a scan begins at a bearing of -2 pi to 2 pi and goes on by steps other than 0, both in radians, got "
                f"angle_min {shown(repr(angle_min_rad))} and angle_increment {shown(repr(increment))}"
            )
        if abs(increment) > step * (1.0 + _SLACK):
            raise SensorError(
                f"the scan has a ray every {math.degrees(abs(increment)):.4g} degrees, the policy needs one every "
                f"{math.degrees(step):.4g}: {self._n_bearings} all around; use a finer lidar"
            )
        position = (angle_min_rad + increment * np.arange(n_rays) + math.pi) / step
        below = np.floor(position)
        pairs = [
            (ray, at) for at in (below, below + 1.0) if len(ray := np.flatnonzero(abs(position - at) <= 0.5 + _SLACK))
        ]
        rays = np.concatenate([ray for ray, _ in pairs]) if pairs else np.zeros(0, np.intp)
        bearings = np.concatenate([at[ray] for ray, at in pairs]).astype(np.intp) if pairs else rays
        bearings %= self._n_bearings
        if missed := len(np.setdiff1d(self._needed, bearings)):
            raise SensorError(
                f"the scan, from {math.degrees(angle_min_rad):.1f} to "
                f"{math.degrees(angle_min_rad + increment * (n_rays - 1)):.1f} degrees, leaves out {missed} of the "
                f"{len(self._needed)} bearings that the policy watches; it needs a lidar that looks all around"
            )
        self._rays, self._bearings = rays, bearings
        self._laid = n_rays, angle_min_rad, increment


def _floats(array: object, what: str, shape: str, n_dimensions: int, most: int) -> NDArray[np.floating]:
    if isinstance(array, np.ma.MaskedArray) and array.dtype.kind == "f":
        array = array.filled(np.nan)
    if not isinstance(array, np.ndarray) or array.dtype not in (np.float32, np.float64):
        kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise SensorError(f"{what} is a NumPy array of float32 or float64, got {shown(kind)}; convert it")
    if array.ndim != n_dimensions or len(array) > most:
        raise SensorError(f"{what} is an array of shape {shape}, of at most {most} rows, got {array.shape}")
    return array


def _rotation(matrix: object) -> NDArray[np.float64]:
    """Return a (3, 3) rotation that is one."""
    try:
        rotation = np.asarray(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        rotation = np.zeros(0)
    turned = rotation.shape == (3, 3) and abs(rotation @ rotation.T - np.eye(3)).max() < 1e-3
    if not turned or np.linalg.det(rotation) < 0.0:  # a mirror image is none
        raise SensorError(f"rotation_level must be a (3, 3) rotation matrix, got {shown(matrix)}")
    return rotation
