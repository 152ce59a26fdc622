"""Whether a car's lidar, where it is mounted, sees a wall that stands beside the car."""

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import FlattenConfig, LidarConfig
from zebrat_bullet.errors import RobotError
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_directions
from zebrat_bullet.sensing.safety_region import leave_outline

_N_SECTORS = 8
_SECTORS = ("back", "back right", "right", "front right", "ahead", "front left", "left", "back left")
_SIGHT_M = 0.3
"""So far beyond the outline a wall must be seen: a lidar on its side looks steeply past the body, and no further."""


def check_sight(robot: RobotModel, lidar: LidarConfig, flatten: FlattenConfig) -> None:
    """Raise unless in every bearing of the scan some beam sees walls from the car's outline to `_SIGHT_M` beyond it.

    Of a wall that it misses the lidar would say "open space" there. A tilted one's beams may leave out a single
    bearing; its neighbours then stand for it.

    Raises:
        RobotError: the beams of some bearing meet the height band too late, leave it too early, or there are none.
    """
    nearest, outside = _sight(robot, lidar, flatten)
    blind, late = np.isinf(nearest), np.isfinite(nearest) & (outside > 0.0)
    sectors = np.round(np.arange(lidar.n_bearings) / lidar.n_bearings * _N_SECTORS).astype(int) % _N_SECTORS
    said = []
    if blind.any():
        where = ", ".join(_SECTORS[i] for i in np.unique(sectors[blind]))
        said.append(
            f"sees no wall at all, or none {_SIGHT_M} m beyond the car's outline, in {blind.sum()} of "
            f"{lidar.n_bearings} bearings ({where})"
        )
    if late.any():
        from_m = {_SECTORS[i]: nearest[late & (sectors == i)].min() for i in np.unique(sectors[late])}
        where = ", ".join(f"{sector} from {at:.2f} m" for sector, at in from_m.items())
        said.append(f"sees walls only beyond the car's outline ({where})")
    if said:
        roll, pitch = (float(angle) + 0.0 for angle in robot.lidar_rpy[:2].round(3))
        raise RobotError(
            f"{robot.urdf_path}: the lidar, {float(robot.lidar_xyz_base[2]):.3f} m above the floor, roll {roll:g} and "
            f"pitch {pitch:g} rad, {' and '.join(said)}: its beams pass above or below the height band of "
            f"{flatten.height_min_m} to {flatten.height_max_m} m. Mount it level within the band (lidar_mount; a frame "
            "with z up, no optical one), or change flatten.height_min_m, flatten.height_max_m or the lidar's elevations"
        )


def _sight(
    robot: RobotModel, lidar: LidarConfig, flatten: FlattenConfig
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (n_bearings,) where walls are seen from, in m from the lidar and from the outline; inf for nowhere."""
    directions = beam_directions(lidar) @ rotation_from_rpy(*robot.lidar_rpy).T
    level = np.hypot(directions[:, 0], directions[:, 1])
    height = float(robot.lidar_xyz_base[2])
    low, high = flatten.height_min_m - height, flatten.height_max_m - height
    slopes = np.where(np.abs(directions[:, 2]) < 1e-12, 1e-12, directions[:, 2]) / np.maximum(level, 1e-12)
    into, out = np.sort([low / slopes, high / slopes], axis=0)
    bearings = np.arctan2(directions[:, 1], directions[:, 0])
    body = shapely.Polygon(np.asarray(robot.footprint_base) - robot.lidar_xyz_base[:2]).convex_hull
    outline = np.array(shapely.geometry.polygon.orient(body).exterior.coords)[:-1]
    leave = np.maximum(leave_outline(outline, bearings)[1], 0.0)
    seen_to = np.minimum(out, lidar.range_max_m * level)
    first = np.where(seen_to >= np.maximum(into, leave + _SIGHT_M), np.maximum(into, 0.0), np.inf)
    return _least(bearings, first, lidar.n_bearings), _least(bearings, first - leave, lidar.n_bearings)


def _least(bearings: NDArray[np.float64], values: NDArray[np.float64], n_bearings: int) -> NDArray[np.float64]:
    """Return the (n_bearings,) least value of the beams that fall to each bearing of the scan or beside it."""
    index = np.rint((bearings + np.pi) * (n_bearings / (2.0 * np.pi))).astype(np.intp) % n_bearings
    least = np.full(n_bearings, np.inf)
    np.minimum.at(least, index, values)
    return np.min([np.roll(least, shift) for shift in (-1, 0, 1)], axis=0)
