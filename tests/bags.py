"""Bags as a user's own car would record them, written by rosbags."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from zebrat_bullet.recording.schemas import schema_text

CLOUD, SCAN, ODOMETRY = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
ACKERMANN = "ackermann_msgs/msg/AckermannDriveStamped"
BEGIN_NS = 1_750_000_000 * 10**9
RELIABLE = Qos(
    QosHistory.KEEP_LAST,
    5,
    QosReliability.RELIABLE,
    QosDurability.VOLATILE,
    QosTime(0, 0),
    QosTime(0, 0),
    QosLiveliness.AUTOMATIC,
    QosTime(0, 0),
    False,
)


class Messages:
    """Makes and serialises ROS messages of one distribution."""

    def __init__(self, store: Stores = Stores.ROS2_HUMBLE) -> None:
        self.store = get_typestore(store)
        self.is_ros1 = store is Stores.ROS1_NOETIC
        new = get_types_from_msg(schema_text(ACKERMANN), ACKERMANN)
        self.store.register({kind: what for kind, what in new.items() if kind.startswith("ackermann")})

    def of(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def packed(self, kind: str, message: Any) -> bytes:
        return bytes((self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr)(message, kind))

    def header(self, time_s: float, frame: str) -> Any:
        stamp = self.of("builtin_interfaces/msg/Time", sec=1_750_000_000 + int(time_s), nanosec=int(time_s % 1 * 1e9))
        return self.of("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if self.is_ros1 else {}))

    def cloud(self, points: np.ndarray, time_s: float = 0.0, frame: str = "velodyne", **instead: Any) -> Any:
        """A Velodyne's cloud: x, y, z, intensity, ring and time in 22 bytes, without rows."""
        kind = np.dtype([("xyz", "<f4", 3), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])
        packed = np.zeros(len(points), kind)
        packed["xyz"] = points
        layout = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("ring", 16, 4), ("time", 18, 7)]
        fields = [
            self.of("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=1)
            for name, offset, datatype in layout
        ]
        values = {
            "header": self.header(time_s, frame),
            "height": 1,
            "width": len(points),
            "fields": fields,
            "is_bigendian": False,
            "point_step": kind.itemsize,
            "row_step": kind.itemsize * len(points),
            "data": np.frombuffer(packed.tobytes(), np.uint8),
            "is_dense": True,
        }
        return self.of(CLOUD, **values | instead)

    def scan(self, ranges: np.ndarray, time_s: float = 0.0, frame: str = "laser", **instead: Any) -> Any:
        """A scan from straight ahead all around, 0 to 2 pi."""
        step = 2.0 * np.pi / max(len(ranges), 1)
        values = {
            "header": self.header(time_s, frame),
            "angle_min": 0.0,
            "angle_max": 2.0 * np.pi - step,
            "angle_increment": step,
            "time_increment": 0.0,
            "scan_time": 0.2,
            "range_min": 0.1,
            "range_max": 30.0,
            "ranges": np.asarray(ranges, np.float32),
            "intensities": np.zeros(0, np.float32),
        }
        return self.of(SCAN, **values | instead)

    def twist(self, speed: float, turning: float) -> Any:
        def vector(x: float, z: float) -> Any:
            return self.of("geometry_msgs/msg/Vector3", x=x, y=0.0, z=z)

        return self.of(TWIST, linear=vector(speed, 0.0), angular=vector(0.0, turning))

    def twist_stamped(self, speed: float, turning: float, time_s: float = 0.0) -> Any:
        return self.of(TWIST_STAMPED, header=self.header(time_s, "base_link"), twist=self.twist(speed, turning))

    def ackermann(self, speed: float, steering: float, time_s: float = 0.0) -> Any:
        names = ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")
        drive = self.of(
            "ackermann_msgs/msg/AckermannDrive", **dict(zip(names, (steering, 0.0, speed, 0.0, 0.0), strict=True))
        )
        return self.of(ACKERMANN, header=self.header(time_s, "base_link"), drive=drive)


Sent = tuple[str, str, float, Any]
"""Topic, type, time of arrival in s, and a message or the bytes to be written in its place."""


def write_bag(path: Path, messages: Messages, sent: Iterable[Sent], storage: str = "sqlite3", **how: Any) -> Path:
    """Write what was sent as a rosbag2 folder ("sqlite3", "mcap") or as a ROS 1 bag ("ros1")."""
    if storage == "ros1":
        with rosbag1.Writer(path) as writer:
            _write(writer, messages, sent, {})
        return path
    plugin = rosbag2.StoragePlugin[storage.upper()]
    writer = rosbag2.Writer(path, version=8, storage_plugin=plugin)
    if how:
        writer.set_compression(**how)
    with writer:
        _write(writer, messages, sent, {"offered_qos_profiles": [RELIABLE]})
    return path


def _write(writer: Any, messages: Messages, sent: Iterable[Sent], options: dict[str, Sequence[Qos]]) -> None:
    connections: dict[tuple[str, str], Any] = {}
    for topic, kind, time_s, message in sent:
        if (topic, kind) not in connections:
            connections[topic, kind] = writer.add_connection(topic, kind, typestore=messages.store, **options)
        data = message if isinstance(message, bytes) else messages.packed(kind, message)
        writer.write(connections[topic, kind], BEGIN_NS + round(time_s * 1e9), data)
