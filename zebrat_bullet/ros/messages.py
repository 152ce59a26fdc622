"""ROS messages as numpy arrays. Duck-typed: a message from rclpy, from a bag, or any object with the same fields."""

import math
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import SensorError
from zebrat_bullet.files import shown
from zebrat_bullet.types import PointCloud

UINT16, FLOAT32, FLOAT64 = 4, 7, 8
"""The numbers of `sensor_msgs/PointField` that coordinates and channels come in."""
POINT = np.dtype({"names": ["xyz", "ring"], "formats": ["3f4", "u2"], "offsets": [0, 12], "itemsize": 16})
"""A point of the clouds that are published here."""
POINT_FIELDS = (("x", 0, FLOAT32, 1), ("y", 4, FLOAT32, 1), ("z", 8, FLOAT32, 1), ("ring", 12, UINT16, 1))
"""The same as name, offset, datatype and count of `sensor_msgs/PointField`."""
_TYPES = {FLOAT32: "f4", FLOAT64: "f8"}
_STANDSTILL_MPS = float(np.finfo(np.float32).eps)


def cloud_points(message: Any) -> NDArray[np.float32]:
    """Return the (N, 3) float32 points of a `sensor_msgs/PointCloud2`, in m in the frame of its header.

    Any layout: coordinates anywhere in a point, other fields and padding between, rows of an organised cloud with
    padding, either byte order, float64 too. Where x, y and z are float32 of this machine's order and lie side by side,
    as every lidar driver has them, the array is a view of the message. A ray without a return is nan, or the origin, as
    the lidar's driver has it.

    Raises:
        SensorError: the message contradicts itself, or has no coordinates.
    """
    order = ">" if message.is_bigendian else "<"
    axes = [_axis(message, name) for name in "xyz"]
    height, width = int(message.height), int(message.width)
    step, row = int(message.point_step), int(message.row_step)
    buffer = np.frombuffer(message.data, np.uint8)
    if height < 1 or width < 0 or step < 1:
        raise SensorError(f"a cloud of {height} x {width} points of {step} bytes; all must be above 0")
    if height == 1:
        row = step * width  # many drivers leave row_step at 0 in a cloud of one row
    if row < step * width or len(buffer) < row * (height - 1) + step * width:
        raise SensorError(
            f"a cloud of {height} x {width} points of {step} bytes in rows of {row} needs "
            f"{max(row, step * width) * height} bytes, got {len(buffer)}"
        )
    if width == 0:
        return np.empty((0, 3), np.float32)
    kinds, offsets = [kind for kind, _ in axes], [offset for _, offset in axes]
    if max(offset + np.dtype(kind).itemsize for kind, offset in axes) > step:
        raise SensorError(f"x, y and z at the bytes {offsets} do not lie within a point of {step} bytes")
    x = offsets[0]
    if kinds == ["f4"] * 3 and offsets == [x, x + 4, x + 8]:
        points = np.ndarray((height, width, 3), f"{order}f4", buffer, x, (row, step, 4))
    else:
        points = np.stack(
            [np.ndarray((height, width), order + kind, buffer, offset, (row, step)) for kind, offset in axes], axis=-1
        )
    return points.reshape(-1, 3).astype(np.float32, copy=False)


def _axis(message: Any, name: str) -> tuple[str, int]:
    """Return numpy's name of the type and the offset of a coordinate in a point."""
    for field in message.fields:
        if field.name == name:
            if field.datatype not in _TYPES or field.count not in (0, 1):
                raise SensorError(
                    f"{name} of a cloud must be one float32 ({FLOAT32}) or float64 ({FLOAT64}), got {field.count} of "
                    f"the type {field.datatype}"
                )
            return _TYPES[field.datatype], int(field.offset)
    names = [shown(field.name, 30) for field in message.fields][:20]
    raise SensorError(f"a cloud must have the fields x, y and z, got {', '.join(names) or 'none'}")


def packed_cloud(cloud: PointCloud, n_channels: int) -> NDArray[np.void]:
    """Return the (N,) `POINT`s of a cloud, channel-major; nan where a ray had no return."""
    n = len(cloud.points_lidar)
    points = np.zeros(n, POINT)
    points["xyz"] = cloud.points_lidar
    points["xyz"][~cloud.valid] = np.nan
    points["ring"] = np.repeat(np.arange(n_channels), n // n_channels)
    return points


def scan_ranges(message: Any) -> NDArray[np.float32]:
    """Return the (n,) float32 ranges of a `sensor_msgs/LaserScan` in m.

    ROS has a range outside of `range_min` to `range_max` discarded: beyond, it is inf here, the way is free; before, it
    is nan, the ray was lost. As REP 117 has it, inf, nan and -inf (too near to be measured) are kept.

    Raises:
        SensorError: the message contradicts itself.
    """
    least, most = float(message.range_min), float(message.range_max)
    if not 0.0 <= least < most:
        raise SensorError(f"a scan's range_min must be at least 0 and below range_max, got {least} and {most}")
    ranges = np.array(message.ranges, np.float32)
    ranges[ranges > most] = np.inf
    ranges[np.isfinite(ranges) & (ranges < least)] = np.nan
    return ranges


def seconds(stamp: Any) -> float:
    """Return a `builtin_interfaces/Time` in s."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def yaw_rate(speed_mps: float, steering_rad: float, wheelbase_m: float) -> float:
    """Return the turning speed in rad/s of a car whose rear axle has that speed: what a Twist can say of steering."""
    return speed_mps * math.tan(steering_rad) / wheelbase_m


def steering_of(speed_mps: float, yaw_rate_radps: float, wheelbase_m: float) -> float:
    """Return the steering in rad that ackermann_steering_controller makes of a Twist: 0 at standstill."""
    if abs(speed_mps) < _STANDSTILL_MPS:
        return 0.0
    return math.atan(yaw_rate_radps * wheelbase_m / speed_mps)


def native_big_endian() -> bool:
    """Return what `is_bigendian` of a message made here is."""
    return sys.byteorder == "big"
