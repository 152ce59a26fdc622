"""Makes ROS messages of what the package knows."""

import math
from array import array
from functools import cache
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from std_msgs.msg import Header

from zebrat_bullet.deploy.car import Car
from zebrat_bullet.deploy.senses import turned_rays
from zebrat_bullet.ros.messages import POINT, POINT_FIELDS, native_big_endian, packed_cloud, yaw_rate
from zebrat_bullet.types import Command, FlatScan, PointCloud, RobotState


def time_of(time_s: float) -> Time:
    """Return a time in s as a stamp."""
    nanoseconds = round(time_s * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def header(stamp: Time, frame: str) -> Header:
    """Return a header."""
    return Header(stamp=stamp, frame_id=frame)


def cloud_message(cloud: PointCloud, n_channels: int, stamp: Time, frame: str) -> PointCloud2:
    """Return a cloud as an organised PointCloud2: a row for each channel; nan where a ray had no return."""
    points = packed_cloud(cloud, n_channels)
    message = PointCloud2(header=header(stamp, frame), height=n_channels, width=len(points) // n_channels)
    message.fields = [
        PointField(name=name, offset=offset, datatype=datatype, count=count)
        for name, offset, datatype, count in POINT_FIELDS
    ]
    message.is_bigendian, message.is_dense = native_big_endian(), False
    message.point_step, message.row_step = POINT.itemsize, POINT.itemsize * message.width
    message.data = _array("B", points)
    return message


def scan_message(
    scan: FlatScan, rotation_base: NDArray[np.floating], stamp: Time, frame: str, period_s: float
) -> LaserScan:
    """Return a whole scan as a LaserScan in the frame of a lidar so mounted; inf where nothing was seen."""
    n = len(scan.ranges_m)
    first, increment = turned_rays(rotation_base.T, -math.pi, 2.0 * math.pi / n)
    message = LaserScan(header=header(stamp, frame), angle_min=first, angle_increment=increment)
    message.angle_max, message.scan_time = first + (n - 1) * increment, period_s
    message.range_min, message.range_max = 0.0, float(scan.range_max_m)
    message.ranges = _array("f", np.where(scan.ranges_m < scan.range_max_m, scan.ranges_m, np.float32(np.inf)))
    return message


def odometry_message(state: RobotState, stamp: Time, frame: str, child: str) -> Odometry:
    """Return the true state of a car; its twist is that of the rear axle's centre."""
    message = Odometry(header=header(stamp, frame), child_frame_id=child)
    position, turn = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y = float(state.pose.x), float(state.pose.y)
    turn.z, turn.w = math.sin(state.pose.yaw / 2.0), math.cos(state.pose.yaw / 2.0)
    message.twist.twist.linear.x = float(state.speed_mps)
    message.twist.twist.angular.z = float(state.yaw_rate_radps)
    return message


def twist(command: Command, car: Car) -> Twist:
    """Return a command as ackermann_steering_controller takes it: speed of the rear axle and yaw rate."""
    message = Twist()
    message.linear.x = command.speed_mps
    message.angular.z = yaw_rate(command.speed_mps, command.steering_rad, car.wheelbase_m)
    return message


def twist_stamped(command: Command, car: Car, stamp: Time, frame: str) -> TwistStamped:
    """Return the same with a stamp."""
    return TwistStamped(header=header(stamp, frame), twist=twist(command, car))


@cache
def ackermann_type() -> Any:
    """Return `ackermann_msgs/AckermannDriveStamped`, or None where that package is not installed."""
    try:
        from ackermann_msgs.msg import AckermannDriveStamped
    except ImportError:
        return None
    return AckermannDriveStamped


def ackermann_drive(command: Command, stamp: Time, frame: str) -> Any:
    """Return a command with its steering, which is kept at standstill; only where `ackermann_type` is there."""
    message = ackermann_type()(header=header(stamp, frame))
    message.drive.speed, message.drive.steering_angle = command.speed_mps, command.steering_rad
    return message


def _array(code: str, values: NDArray) -> array:
    """Return values as the array type that rclpy copies at once; anything else it takes number by number."""
    made = array(code)
    made.frombytes(values.tobytes())
    return made
