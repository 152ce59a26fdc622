"""Whether a car's lidar, where it is mounted, sees a wall that stands beside the car."""

import numpy as np
import shapely

from zebrat_bullet.config import FlattenConfig, LidarConfig
from zebrat_bullet.errors import RobotError
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_directions
from zebrat_bullet.sensing.safety_region import leave_outline

_N_SECTORS = 8
_SECTORS = ("back", "back right", "right", "front right", "ahead", "front left", "left", "back left")


def check_sight(robot: RobotModel, lidar: LidarConfig, flatten: FlattenConfig) -> None:
    """Raise where the lidar sees no wall in some direction, or only one that stands away from the car's outline.

    Of a wall right beside the car it would say "open space" there.

    Raises:
        RobotError: no beam of some direction meets the height band before it leaves the outline.
    """
    directions = beam_directions(lidar) @ rotation_from_rpy(*robot.lidar_rpy).T
    level = np.hypot(directions[:, 0], directions[:, 1])
    height = float(robot.lidar_xyz_base[2])
    low, high = flatten.height_min_m - height, flatten.height_max_m - height
    slopes = np.where(np.abs(directions[:, 2]) < 1e-12, 1e-12, directions[:, 2]) / np.maximum(level, 1e-12)
    into, out = np.sort([low / slopes, high / slopes], axis=0)
    first = np.where(np.minimum(out, lidar.range_max_m * level) >= np.maximum(into, 0.0), np.maximum(into, 0.0), np.inf)
    bearings = np.arctan2(directions[:, 1], directions[:, 0])
    sectors = np.round((bearings + np.pi) / (2.0 * np.pi) * _N_SECTORS).astype(int) % _N_SECTORS
    nearest, outside = np.full(_N_SECTORS, np.inf), np.full(_N_SECTORS, np.inf)
    np.minimum.at(nearest, sectors, first)
    body = shapely.Polygon(np.asarray(robot.footprint_base) - robot.lidar_xyz_base[:2]).convex_hull
    outline = np.array(shapely.geometry.polygon.orient(body).exterior.coords)[:-1]
    np.minimum.at(outside, sectors, first - np.maximum(leave_outline(outline, bearings)[1], 0.0))
    blind = [name for name, at in zip(_SECTORS, nearest, strict=True) if np.isinf(at)]
    late = [i for i in range(_N_SECTORS) if 0.0 < outside[i] < np.inf]
    if not blind and not late:
        return
    said = [f"sees no wall at all ({', '.join(blind)})"] if blind else []
    if late:
        where = ", ".join(f"{_SECTORS[i]} from {nearest[i]:.2f} m" for i in late)
        said.append(f"sees walls only beyond the car's outline ({where})")
    raise RobotError(
        f"{robot.urdf_path}: the lidar, {height:.3f} m above the floor, {' and '.join(said)}: its beams pass "
        f"above or below the height band of {flatten.height_min_m} to {flatten.height_max_m} m. Mount it level within "
        "the band (lidar_mount), or change flatten.height_min_m, flatten.height_max_m or the lidar's elevations"
    )
