"""What the tests of the ROS nodes share: processes that run them, and a node that listens in."""

import os
import random
import socket
import subprocess
import sys
import time
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import PointCloud2, PointField

from zebrat_bullet.ros.messages import seconds
from zebrat_bullet.ros.publish import time_of

# As on a car that has neither simulator nor torch: to import one of them fails.
WITHOUT_SIMULATOR = (
    "import sys; sys.modules.update(dict.fromkeys("
    "('torch', 'pybullet', 'gymnasium', 'open3d', 'stable_baselines3', 'warp', 'scipy', 'rich', 'shapely', 'pydantic')"
    ")); "
)
RUN = "import sys; from zebrat_bullet.cli import main; sys.exit(main())"
PATIENCE_S = 120.0
FIRST_PORT = 27_400  # of the 100 that say which domains are taken: below the system's own, beside those of ROS


class Domain:
    """A ROS_DOMAIN_ID that no other test of this computer has until it is given back.

    Nodes of two tests in one domain would drive each other's cars: the suite runs in several processes.
    """

    def __init__(self) -> None:
        self.id = 0
        for self.id in random.sample(range(1, 101), 100):
            self._held = socket.socket()
            try:
                self._held.bind(("127.0.0.1", FIRST_PORT + self.id))  # freed by the system too, should we be killed
                return
            except OSError:
                self._held.close()
        raise RuntimeError("no ROS_DOMAIN_ID from 1 to 100 is free")

    def close(self) -> None:
        self._held.close()


class Processes:
    """Starts `zebrat ros ...` in one domain on this computer alone, and ends whatever still runs."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._held = folder, Domain()
        self.domain = self._held.id
        self._running: list[subprocess.Popen] = []
        self.environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(self.domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONPATH": str(Path(__file__).parent.parent),
        }

    def start(self, *command: str) -> subprocess.Popen:
        name = self._folder / f"{len(self._running)}"
        with open(f"{name}.out", "w", encoding="utf-8") as out, open(f"{name}.err", "w", encoding="utf-8") as err:
            made = subprocess.Popen([sys.executable, *command], env=self.environment, stdout=out, stderr=err)
        made.name = name  # type: ignore[attr-defined]
        self._running.append(made)
        return made

    def drive(self, policy: Path, *parameters: str, sim_time: bool = True) -> subprocess.Popen:
        given = [f"use_sim_time:={str(sim_time).lower()}", *parameters]
        ros_args = [word for each in given for word in ("-p", each)]
        return self.start(
            "-c", WITHOUT_SIMULATOR + RUN, "ros", "drive", "--json", "--policy", str(policy), "--ros-args", *ros_args
        )

    def sim(self, *options: str, parameters: tuple[str, ...] = ()) -> subprocess.Popen:
        ros_args = [word for each in parameters for word in ("-p", each)]
        return self.start("-c", RUN, "ros", "sim", "--json", *options, "--ros-args", *ros_args)

    def check(self) -> None:
        """Fail if one of them ended by itself with an error."""
        for process in self._running:
            assert process.poll() not in (1, 2, 3), said(process)

    def told(self) -> str:
        """Return how each stands and what it said, for a test that waited in vain."""
        return "".join(f"\n{process.args[-8:]}: {process.poll()}\n{said(process)}" for process in self._running)

    def close(self) -> None:
        for process in self._running:
            process.kill()
            process.wait()
        self._held.close()


def said(process: subprocess.Popen) -> str:
    """Return what a process wrote on standard error so far."""
    return Path(f"{process.name}.err").read_text(encoding="utf-8")  # type: ignore[attr-defined]


def answered(process: subprocess.Popen) -> str:
    """Wait for a process to end well, and return its standard output."""
    assert process.wait(PATIENCE_S) == 0, said(process)
    return Path(f"{process.name}.out").read_text(encoding="utf-8")  # type: ignore[attr-defined]


class Probe:
    """A node of the test: hears commands and odometry, and may publish."""

    def __init__(self, processes: Processes) -> None:
        self._processes, self._context = processes, Context()
        rclpy.init(context=self._context, domain_id=processes.domain)
        self.node = rclpy.create_node("probe", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.commands: list[tuple[float, float]] = []  # stamp, speed
        self.yaw_rates: list[float] = []  # of the commands
        self.speeds: list[tuple[float, float]] = []  # stamp, speed
        self.node.create_subscription(TwistStamped, "cmd_vel", self._on_command, 100)
        self.node.create_subscription(Odometry, "odom", self._on_odometry, 100)

    def _on_command(self, message: Any) -> None:
        self.commands.append((seconds(message.header.stamp), message.twist.linear.x))
        self.yaw_rates.append(message.twist.angular.z)

    def _on_odometry(self, message: Any) -> None:
        self.speeds.append((seconds(message.header.stamp), message.twist.twist.linear.x))

    def publisher(self, kind: type, topic: str, *, reliable: bool = True) -> Any:
        reliability = QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT
        return self.node.create_publisher(kind, topic, QoSProfile(depth=5, reliability=reliability))

    def hears(self, topic: str) -> bool:
        """Return whether somebody who publishes a topic has been found: on a busy computer that takes a while."""
        return self.node.count_publishers(topic) > 0

    def until(self, done: Callable[[], bool]) -> None:
        """Spin until something is so; fail if that takes very long."""
        end_s = time.monotonic() + PATIENCE_S
        while not done():
            self._processes.check()
            if time.monotonic() >= end_s:
                heard = f"commands {self.commands[-5:]}, speeds {self.speeds[-5:]} of {len(self.speeds)}"
                raise AssertionError(f"it did not come to pass; heard {heard}{self._processes.told()}")
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self.node.destroy_node()
        self._context.try_shutdown()


def fields_of(dtype: np.dtype) -> list[PointField]:
    """Return the fields of a structured dtype as PointFields."""
    codes = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
    return [
        PointField(name=name, offset=offset, datatype=codes[kind.str[1:]], count=1)
        for name, (kind, offset, *_) in dtype.fields.items()
    ]


def cloud(
    points: np.ndarray, dtype: np.dtype | None = None, *, stamp_s: float | None = None, frame: str = "lidar"
) -> Any:
    """Return (N, 3) points as a PointCloud2, its points laid out as a dtype with the fields x, y and z."""
    dtype = dtype or np.dtype({"names": list("xyz"), "formats": ["f4"] * 3, "offsets": [0, 4, 8], "itemsize": 16})
    laid = np.zeros(len(points), dtype)
    for axis, values in zip("xyz", points.T, strict=True):
        laid[axis] = values
    message = PointCloud2(height=1, width=len(points), point_step=dtype.itemsize, row_step=dtype.itemsize * len(points))
    message.header.stamp, message.header.frame_id = time_of(time.time() if stamp_s is None else stamp_s), frame
    message.fields, message.is_dense = fields_of(dtype), True
    message.is_bigendian = dtype["x"].str[0] == ">"
    message.data = array("B", laid.tobytes())
    return message


def corridor(width_m: float = 1.6, height_m: float = 0.75) -> np.ndarray:
    """Return the (N, 3) float32 points of a straight corridor's walls, closed 5 m behind, lidar frame."""
    x = np.arange(-5.0, 5.5, 0.02)
    sides = [
        np.stack([x, np.full_like(x, y), np.full_like(x, 0.4 - height_m)], axis=1) for y in (-width_m / 2, width_m / 2)
    ]
    return np.concatenate(sides).astype(np.float32)
