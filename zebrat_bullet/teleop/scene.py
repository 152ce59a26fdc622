"""What a page draws, as plain data for JSON: walls, a car that never changes, and where it is now."""

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.task.drive import Drive
from zebrat_bullet.world import World


def walls_of(world: World) -> list[list[list[list[float]]]]:
    """Return the rings of each wall, in m to the millimetre, world frame."""
    return [
        [np.asarray(ring.coords).round(3).tolist() for ring in (polygon.exterior, *polygon.interiors)]
        for polygon in world.walls.geoms
        if isinstance(polygon, shapely.Polygon)
    ]


def car_of(drive: Drive) -> dict[str, object]:
    """Return what of a car never changes: outline and wheels, where the lidar and its 32 bearings are, in m."""
    robot, region = drive.robot, drive.region
    return {
        "step_s": drive.config.physics.control_step_s,
        "footprint": np.asarray(robot.footprint_base).round(4).tolist(),
        "lidar": np.asarray(robot.lidar_xyz_base[:2]).tolist(),
        "wheelbase_m": robot.wheelbase_m,
        "track_m": robot.track_m,
        "wheel_radius_m": robot.wheel_radius_m,
        "rear_axle_x_m": robot.rear_axle_x_m,
        "range_max_m": drive.config.lidar.range_max_m,
        "n_bearings": drive.config.lidar.n_bearings,
        "indices": [int(i) for i in region.indices],
        "range_m": region.range_m.round(4).tolist(),
    }


def view_of(
    pose: tuple[float, float, float],
    ranges_m: NDArray[np.float32],
    time_s: float,
    speed_mps: float,
    steering_rad: float,
) -> dict[str, object]:
    """Return what of a car changes; ranges are whole millimetres to keep it small."""
    return {
        "pose": [round(value, 4) for value in pose],
        "scan_mm": np.rint(ranges_m * 1000.0).astype(int).tolist(),
        "time_s": round(time_s, 3),
        "speed_mps": round(speed_mps, 3),
        "steering_rad": round(steering_rad, 3),
    }
