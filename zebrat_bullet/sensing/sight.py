"""Whether a car's lidar, where it is mounted, sees a wall that stands beside the car."""

import numpy as np

from zebrat_bullet.config import FlattenConfig, LidarConfig
from zebrat_bullet.errors import RobotError
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_directions

_N_SECTORS = 8
_SECTORS = ("back", "back right", "right", "front right", "ahead", "front left", "left", "back left")


def check_sight(robot: RobotModel, lidar: LidarConfig, flatten: FlattenConfig) -> None:
    """Raise where the lidar sees no wall in some direction, or only one that is farther off than the car's own corners.

    All it would say there is "open space", at once and wherever the car stands.

    Raises:
        RobotError: no beam of some direction meets the height band nearer than that.
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
    nearest = np.full(_N_SECTORS, np.inf)
    np.minimum.at(nearest, sectors, first)
    reach = float(np.hypot(*(np.asarray(robot.footprint_base) - robot.lidar_xyz_base[:2]).T).max())
    blind = [name for name, at in zip(_SECTORS, nearest, strict=True) if at > reach]
    if not blind:
        return
    seen = "sees no wall at all" if np.isinf(nearest).all() else f"sees no wall nearer than {nearest.max():.2f} m"
    raise RobotError(
        f"{robot.urdf_path}: the lidar, {height:.3f} m above the floor, {seen} ({', '.join(blind)}): its beams pass "
        f"above or below the height band of {flatten.height_min_m} to {flatten.height_max_m} m. Mount it level within "
        "the band (lidar_mount), or change flatten.height_min_m, flatten.height_max_m or the lidar's elevations"
    )
