"""The safety region (paper, Algorithm 1): a few bearings of the scan that watch the car's outline evenly.

Equal angles watch the near nose closely and the far tail hardly at all; the safety region spaces its bearings evenly
along the outline. Between two of them it is blind: an obstacle thinner than their spacing can reach into the outline.
"""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import SafetyRegionConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.types import Clearance, FlatScan

_AXES_RAD = np.array([-math.pi, -math.pi / 2.0, 0.0, math.pi / 2.0])


class SafetyRegion:
    """R bearings of the scan and the range at which each leaves the outline; collision where the scan is within it.

    Bearings are ordered from straight back counter-clockwise. The four axes and the corners, seen from the lidar, cut
    the outline into phases; each phase is divided evenly in length into round(length / `resolution_m`) intervals. A
    point of the outline is watched by the scan index nearest to its bearing, with the range of that index's own
    bearing, so nothing outside the outline is called a collision. The axes are met exactly where `n_bearings` is a
    multiple of 4.

    Args:
        footprint_lidar: (K, 2) convex outline in m, counter-clockwise, about the lidar, x along the car's heading.
        config: spacing and margin; a margin moves every side outwards. The longer outline then holds more bearings at
            the same spacing: raise `resolution_m` with it to keep their number (0.05 m and 0.11 m keep ZebraT's 32).
        n_bearings: bearings of the scan.

    Attributes:
        outline_lidar: (K, 2) float64, the outline with its margin.
        indices: (R,) int, V_index, scan index of each bearing.
        range_m: (R,) float32, V_range, from the lidar to the outline along the bearing of that index.
        back, right, front, left: positions of the four axes among the R bearings.
        corners: positions of the corners among the R bearings; empty where bearings ignore the outline (FIRect, FIFR).

    Raises:
        ConfigError: the lidar is not inside the outline.
    """

    def __init__(self, footprint_lidar: NDArray[np.float64], config: SafetyRegionConfig, n_bearings: int) -> None:
        self.outline_lidar = _enlarged(footprint_lidar, config.margin_m)
        bearings, axes, self.corners = self._place(config.resolution_m)
        self.back, self.right, self.front, self.left = axes
        self.indices = _nearest((bearings + math.pi) * (n_bearings / (2.0 * math.pi))) % n_bearings
        self.range_m = self._ranges(beam_bearings(n_bearings)[self.indices]).astype(np.float32)
        self._n_bearings = n_bearings

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
        return Clearance(obs, self.range_m, bool((obs <= self.range_m).any()))

    def _place(self, resolution_m: float) -> tuple[NDArray[np.float64], list[int], tuple[int, ...]]:
        """Return (R,) bearings in rad, the positions of the four axes and those of the corners among them."""
        corner_bearings = _bearings_of(self.outline_lidar)
        bounds = np.unique(np.concatenate([_AXES_RAD, corner_bearings]).round(9))
        ends = _outline_points(self.outline_lidar, np.append(bounds, bounds[0]))
        lengths = np.hypot(*np.diff(ends, axis=0).T)
        n_intervals = np.maximum(1, _nearest(lengths / resolution_m))
        points = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(ends, ends[1:], n_intervals, strict=False)]
        first = np.concatenate([[0], np.cumsum(n_intervals)[:-1]])
        bearings = _bearings_of(np.concatenate(points))

        def positions(angles: NDArray[np.float64]) -> list[int]:
            return [int(i) for i in first[np.searchsorted(bounds, np.sort(angles).round(9))]]

        return bearings, positions(_AXES_RAD), tuple(positions(corner_bearings))

    def _ranges(self, bearings: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (R,) range in m that each bearing must keep free."""
        return np.hypot(*_outline_points(self.outline_lidar, bearings).T)


class FIRect(SafetyRegion):
    """The rival with fixed intervals: as many bearings as the safety region, at equal angles, ranges to the outline.

    Equal angles need not fall on the scan's bearings (360 / 32 = 11.25 degrees); the nearest index is taken.
    """

    def _place(self, resolution_m: float) -> tuple[NDArray[np.float64], list[int], tuple[int, ...]]:
        n = len(super()._place(resolution_m)[0])
        return beam_bearings(n), [round(quarter * n / 4) for quarter in range(4)], ()


class FIFR(FIRect):
    """The rival with fixed intervals and one fixed range, which covers no more than the car's width."""

    def _ranges(self, bearings: NDArray[np.float64]) -> NDArray[np.float64]:
        half_width = np.abs(_outline_points(self.outline_lidar, np.array([-math.pi / 2.0, math.pi / 2.0]))[:, 1]).max()
        return np.full(len(bearings), half_width)


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


def _outline_points(outline: NDArray[np.float64], bearings: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (P, 2) points where rays from the lidar at these bearings leave the convex outline around it."""
    sides = np.roll(outline, -1, axis=0) - outline
    normals = np.stack([sides[:, 1], -sides[:, 0]], axis=1)
    offsets = np.einsum("kd,kd->k", normals, outline)
    directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    approach = directions @ normals.T
    with np.errstate(divide="ignore"):
        ranges = np.where(approach > 1e-12, offsets / approach, np.inf).min(axis=1)
    return directions * ranges[:, None]
