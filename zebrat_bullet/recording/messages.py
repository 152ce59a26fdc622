"""What the car sensed, where it was and what it was told, as ROS messages: dictionaries; what is left out is 0."""

import math
from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zebrat_bullet.deploy.senses import turned_rays
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.recording.stamps import header
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.ros.messages import POINT, POINT_FIELDS, native_big_endian, packed_cloud, yaw_rate
from zebrat_bullet.types import Command, FlatScan, PointCloud, RobotState

MAP, ODOM, BASE, LIDAR = "map", "odom", "base_link", "lidar"
"""Frames of a recording, each in the one before it (REP 105); the car's odometry is without error."""
Message = dict[str, Any]


def cloud_message(cloud: PointCloud, n_channels: int, time_s: float) -> Message:
    """Return a `PointCloud2`, organised: a row for each channel, lowest first; nan where a ray had no return."""
    points = packed_cloud(cloud, n_channels)
    width = len(points) // n_channels
    return {
        "header": header(time_s, LIDAR),
        "height": n_channels,
        "width": width,
        "fields": [dict(zip(("name", "offset", "datatype", "count"), each, strict=True)) for each in POINT_FIELDS],
        "is_bigendian": native_big_endian(),
        "point_step": POINT.itemsize,
        "row_step": POINT.itemsize * width,
        "data": points.tobytes(),
        "is_dense": False,
    }


def scan_message(scan: FlatScan, robot: RobotModel, period_s: float, time_s: float) -> Message:
    """Return a whole scan as a `LaserScan` in the lidar's frame; inf where nothing was seen (REP 117).

    Where the lidar looks ahead its bearings are those of the car, from -pi on.
    """
    n = len(scan.ranges_m)
    first, increment = turned_rays(rotation_from_rpy(*robot.lidar_rpy).T, -math.pi, 2.0 * math.pi / n)
    ranges = np.where(scan.ranges_m < scan.range_max_m, scan.ranges_m, np.float32(np.inf))
    return {
        "header": header(time_s, LIDAR),
        "angle_min": first,
        "angle_max": first + (n - 1) * increment,
        "angle_increment": increment,
        "scan_time": period_s,
        "range_max": float(scan.range_max_m),
        "ranges": array("f", ranges.astype(np.float32).tobytes()),
    }


def odometry_message(state: RobotState, robot: RobotModel, time_s: float) -> Message:
    """Return the true state as an `Odometry`; its twist is that of the base frame's origin."""
    position, orientation = _position(state), _orientation(state)
    # The rear axle does not slip sideways; what stands before it is swung around.
    sideways = -robot.rear_axle_x_m * state.yaw_rate_radps
    twist = {"linear": _vector((state.speed_mps, sideways, 0.0)), "angular": _vector((0.0, 0.0, state.yaw_rate_radps))}
    return {
        "header": header(time_s, ODOM),
        "child_frame_id": BASE,
        "pose": {"pose": {"position": _vector(position), "orientation": orientation}},
        "twist": {"twist": twist},
    }


def moving_frames(state: RobotState, time_s: float) -> Message:
    """Return the `TFMessage` of where the car is."""
    return {"transforms": [_transform(ODOM, BASE, _position(state), _orientation(state), time_s)]}


def fixed_frames(robot: RobotModel) -> Message:
    """Return the `TFMessage` of what never moves: the odometry's origin, and the lidar on the car."""
    mount = _quaternion(Rotation.from_euler("xyz", robot.lidar_rpy))
    return {
        "transforms": [
            _transform(MAP, ODOM, (0.0, 0.0, 0.0), _quaternion(Rotation.identity()), 0.0),
            _transform(BASE, LIDAR, robot.lidar_xyz_base, mount, 0.0),
        ]
    }


def twist_message(command: Command, robot: RobotModel, time_s: float) -> Message:
    """Return a command as a `TwistStamped`: speed of the rear axle and yaw rate; no steering at standstill."""
    turning = yaw_rate(command.speed_mps, command.steering_rad, robot.wheelbase_m)
    return {
        "header": header(time_s, BASE),
        "twist": {"linear": _vector((command.speed_mps, 0.0, 0.0)), "angular": _vector((0.0, 0.0, turning))},
    }


def ackermann_message(command: Command, time_s: float) -> Message:
    """Return a command as an `AckermannDriveStamped`."""
    drive = {"speed": command.speed_mps, "steering_angle": command.steering_rad}
    return {"header": header(time_s, BASE), "drive": drive}


def _transform(frame: str, child: str, at: Any, rotation: Message, time_s: float) -> Message:
    moved = {"translation": _vector(at), "rotation": rotation}
    return {"header": header(time_s, frame), "child_frame_id": child, "transform": moved}


def _position(state: RobotState) -> tuple[float, float, float]:
    return state.pose.x, state.pose.y, state.height_m


def _orientation(state: RobotState) -> Message:
    return _quaternion(Rotation.from_euler("xyz", (state.roll, state.pitch, state.pose.yaw)))


def _quaternion(rotation: Rotation) -> Message:
    return dict(zip("xyzw", map(float, rotation.as_quat()), strict=True))


def _vector(values: tuple[float, float, float] | NDArray[np.float64]) -> Message:
    return dict(zip("xyz", map(float, values), strict=True))
