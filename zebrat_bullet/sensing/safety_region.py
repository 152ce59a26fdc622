"""The safety region (paper, Algorithm 1): a few bearings of the scan that watch the car's outline evenly.

Equal angles watch the near nose closely and the far tail hardly at all; the safety region spaces its bearings evenly
along the outline. Between two of them it is blind: an obstacle thinner than their spacing can reach into the outline.
"""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.arrays import Array, like
from zebrat_bullet.config import SafetyRegionConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.types import Clearance, Clearances, FlatScan

_AXES_RAD = np.array([-math.pi, -math.pi / 2.0, 0.0, math.pi / 2.0])


class SafetyRegion:
    """R bearings of the scan and the range at which each leaves the outline; collision where the scan is within it.

    Bearings are ordered from straight back counter-clockwise. The four axes and the corners, seen from the lidar, cut
    the outline into phases; each phase is divided evenly in length into round(length / `resolution_m`) intervals. A
    point of the outline is watched by the scan index nearest to its bearing, with the range of that index's own
    bearing, so nothing outside the outline is called a collision. The axes are met exactly where `n_bearings` is a
    multiple of 4. A side that would fall between two indices gets one more bearing, so that a wall flush with it is
    seen: every side of at least `resolution_m` that some bearing of the scan meets is watched.

    Neighbouring points lie less than 1.5 `resolution_m` apart (a phase just shorter than that is one interval), and
    their indices up to half a scan step further each. Where the outline runs away from the lidar, as along a long
    nose, that half step is the larger part, and indices may repeat: only a finer scan sees more there. A lidar that is
    tilted, or yawed by no whole number of scan steps, has its returns up to half a step beside their index as well.

    Args:
        footprint_lidar: (K, 2) convex outline in m, about the lidar, x along the car's heading. Every corner takes a
            bearing, so give a round body no more corners than it needs.
        config: spacing and margin; a margin moves every side outwards. The longer outline then holds more bearings at
            the same spacing: raise `resolution_m` with it to keep their number (0.05 m and 0.11 m keep ZebraT's 32).
        n_bearings: bearings of the scan.

    Attributes:
        outline_lidar: (K, 2) float64, the outline with its margin.
        indices: (R,) int, V_index, scan index of each bearing; they ascend, but the last may be 0 again.
        range_m: (R,) float32, V_range, from the lidar to the outline along the bearing of that index.
        back, right, front, left: positions among the R bearings of the four axes, or of what is nearest to them where
            bearings ignore the axes (FIRect, FIFR with an R that is no multiple of 4).
        corners: positions of the corners among the R bearings; empty where bearings ignore the outline (FIRect, FIFR).

    Raises:
        ConfigError: the outline is not convex, or the lidar is not inside of it.
    """

    def __init__(self, footprint_lidar: NDArray[np.float64], config: SafetyRegionConfig, n_bearings: int) -> None:
        self.outline_lidar = _enlarged(footprint_lidar, config.margin_m)
        self._gap_rad = config.gap_rad
        bearings, axes, self.corners = self._place(config.resolution_m, n_bearings)
        self.back, self.right, self.front, self.left = axes
        self.indices = _scan_indices(bearings, n_bearings)
        self.range_m = self._ranges(beam_bearings(n_bearings)[self.indices]).astype(np.float32)
        self._n_bearings = n_bearings
        for array in (self.outline_lidar, self.indices, self.range_m):
            array.setflags(write=False)  # a reward term of the user's own sees the region, every agent its ranges

    def measure(self, scan: FlatScan) -> Clearance:
        """Return what the scan says along the region's bearings (V_obs), and whether any of it is a collision.

        Raises:
            ConfigError: the scan has another number of bearings than the region was made for.
        """
        if len(scan.ranges_m) != self._n_bearings:
            raise ConfigError(
                f"the scan has {len(scan.ranges_m)} bearings, the region was made for {self._n_bearings}; "
                "make both from one LidarConfig"
            )
        obs = scan.ranges_m[self.indices]
        return Clearance(obs, self.range_m, bool(self.clearances(obs[None]).collision[0]))

    def clearances(self, obs_m: Array) -> Clearances:
        """Return what (N, R) ranges along the region's bearings, V_obs of N cars, say (paper, Algorithm 1)."""
        range_m = like(self.range_m, obs_m)
        return Clearances(obs_m, range_m, (obs_m <= range_m).any(-1))

    def _place(self, resolution_m: float, n_bearings: int) -> tuple[NDArray[np.float64], list[int], tuple[int, ...]]:
        """Return (R,) bearings in rad, the positions of the four axes and those of the corners among them."""
        corner_bearings = _bearings_of(self.outline_lidar)
        bounds = np.unique(np.concatenate([_AXES_RAD, corner_bearings]).round(9))
        bearings, first = self._divide(bounds, resolution_m)
        missed = self._missed_sides(_scan_indices(bearings, n_bearings), resolution_m, n_bearings)
        if len(missed):
            bounds = np.unique(np.concatenate([bounds, missed.round(9)]))
            bearings, first = self._divide(bounds, resolution_m)

        def positions(angles: NDArray[np.float64]) -> list[int]:
            return [int(i) for i in first[np.searchsorted(bounds, np.sort(angles).round(9))]]

        return bearings, positions(_AXES_RAD), tuple(positions(corner_bearings))

    def _divide(self, bounds: NDArray[np.float64], resolution_m: float) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return (R,) bearings that divide the phases between the (B,) bounds, and where among them each begins."""
        ends = _outline_points(self.outline_lidar, np.append(bounds, bounds[0]))
        lengths = np.hypot(*np.diff(ends, axis=0).T)
        n_intervals = np.maximum(1, _nearest(lengths / resolution_m))
        points = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(ends, ends[1:], n_intervals, strict=False)]
        first = np.concatenate([[0], np.cumsum(n_intervals)[:-1]])
        bearings = _bearings_of(np.concatenate(points))
        # Where the outline is near the lidar, bearings evenly along it lie far apart.
        apart = np.diff(bearings, append=bearings[0]) % (2.0 * math.pi)
        n_parts = np.maximum(1, np.ceil(apart / self._gap_rad - 1e-9)).astype(np.intp)
        parts = [at + gap * np.arange(n) / n for at, gap, n in zip(bearings, apart, n_parts, strict=True)]
        return np.concatenate(parts), np.concatenate([[0], np.cumsum(n_parts)[:-1]])[first]

    def _missed_sides(self, indices: NDArray[np.intp], resolution_m: float, n_bearings: int) -> NDArray[np.float64]:
        """Return the middle bearing of the scan for each long enough side that it meets and `indices` do not."""
        beams = beam_bearings(n_bearings)
        met = leave_outline(self.outline_lidar, beams)[0]
        lengths = np.hypot(*(np.roll(self.outline_lidar, -1, axis=0) - self.outline_lidar).T)
        long_enough = np.flatnonzero(lengths > resolution_m * (1.0 - 1e-9))
        missed = np.setdiff1d(np.intersect1d(met, long_enough), met[indices])
        # A side across straight back has that axis, so the bearings of a missed one are not split by the wrap.
        return np.array([beams[met == side][(met == side).sum() // 2] for side in missed])

    def _ranges(self, bearings: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (R,) range in m that each bearing must keep free."""
        return np.hypot(*_outline_points(self.outline_lidar, bearings).T)


class FIRect(SafetyRegion):
    """The rival with fixed intervals: as many bearings as the safety region, at equal angles, ranges to the outline.

    Equal angles need not fall on the scan's bearings (360 / 32 = 11.25 degrees); the nearest index is taken.
    """

    def _place(self, resolution_m: float, n_bearings: int) -> tuple[NDArray[np.float64], list[int], tuple[int, ...]]:
        n = len(super()._place(resolution_m, n_bearings)[0])
        return beam_bearings(n), [round(quarter * n / 4) for quarter in range(4)], ()


class FIFR(FIRect):
    """The rival with fixed intervals and one fixed range: half the car's width, a circle about the lidar.

    The circle is no part of the outline: where the lidar is nearer to the outline than half the width (the nose of
    ZebraT, the near side of a car whose lidar is off its centre line), it fires before anything touches.
    """

    def _ranges(self, bearings: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.full(len(bearings), np.ptp(self.outline_lidar[:, 1]) / 2.0)


_KINDS = {"sr": SafetyRegion, "firect": FIRect, "fifr": FIFR}


def make_region(robot: RobotModel, config: SafetyRegionConfig, n_bearings: int) -> SafetyRegion:
    """Return the representation that `config.kind` names, for the robot's own outline and lidar mount.

    Raises:
        ConfigError: the lidar is not mounted inside the outline.
    """
    outline = np.asarray(robot.footprint_base) - np.asarray(robot.lidar_xyz_base)[:2]
    return _KINDS[config.kind](outline, config, n_bearings)


def _enlarged(outline: NDArray[np.float64], margin_m: float) -> NDArray[np.float64]:
    """Return the (K, 2) outline, counter-clockwise, with every side moved outwards."""
    polygon = shapely.Polygon(outline)
    if not polygon.is_valid or polygon.convex_hull.area - polygon.area > 1e-9:
        raise ConfigError(f"the outline must be convex, got {np.round(outline, 3).tolist()}; give its convex hull")
    if margin_m > 0.0:
        polygon = polygon.buffer(margin_m, join_style="mitre", mitre_limit=1e3)
    if not polygon.contains(shapely.Point(0.0, 0.0)):
        raise ConfigError(
            f"the lidar must stand inside the outline it watches, got {np.round(outline, 3).tolist()} about it; "
            "move its mount, or give the safety region a margin"
        )
    return np.array(shapely.geometry.polygon.orient(polygon).exterior.coords)[:-1]


def _nearest(values: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the nearest integers, halves to even whatever their last bits say: left and right stay mirror images."""
    return np.rint(values.round(6)).astype(np.intp)


def _bearings_of(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (P,) bearings of (P, 2) points in [-pi, pi)."""
    bearings = np.arctan2(points[:, 1], points[:, 0])
    return np.where(bearings > math.pi - 1e-9, -math.pi, bearings)


def _scan_indices(bearings: NDArray[np.float64], n_bearings: int) -> NDArray[np.intp]:
    """Return the (R,) scan indices nearest to these bearings."""
    return _nearest((bearings + math.pi) * (n_bearings / (2.0 * math.pi))) % n_bearings


def _outline_points(outline: NDArray[np.float64], bearings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (P, 2) points where rays from the lidar at these bearings leave the convex outline around it."""
    ranges = leave_outline(outline, bearings)[1]
    return np.stack([np.cos(bearings), np.sin(bearings)], axis=1) * ranges[:, None]


def leave_outline(
    outline: NDArray[np.float64], bearings: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the (P,) sides through which rays at these bearings leave a convex outline, and their (P,) ranges in m.

    Args:
        outline: (K, 2) counter-clockwise about the lidar, which stands inside of it, in m.
        bearings: (P,) in rad.
    """
    sides = np.roll(outline, -1, axis=0) - outline
    normals = np.stack([sides[:, 1], -sides[:, 0]], axis=1)
    offsets = np.einsum("kd,kd->k", normals, outline)
    approach = np.stack([np.cos(bearings), np.sin(bearings)], axis=1) @ normals.T
    with np.errstate(divide="ignore"):
        ranges = np.where(approach > 1e-12, offsets / approach, np.inf)
    return ranges.argmin(axis=1), ranges.min(axis=1)
