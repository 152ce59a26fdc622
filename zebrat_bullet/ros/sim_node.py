"""The node `zebrat_sim`: our PyBullet car as a robot that publishes what it senses and obeys commands."""

import math
import time
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan, PointCloud2

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.ros.latency import percentiles_ms
from zebrat_bullet.ros.listen import create_publisher, create_subscription
from zebrat_bullet.ros.messages import seconds, steering_of
from zebrat_bullet.ros.parameters import SimSettings
from zebrat_bullet.ros.publish import ackermann_type, cloud_message, odometry_message, scan_message, time_of
from zebrat_bullet.task.drive import Drive, DriveStep
from zebrat_bullet.types import Command, Reading

_SEND_AGAIN_S = 2.0


class SimNode:
    """Drives one episode by what it hears.

    Each control step it publishes clock, odometry, cloud and scan, waits, and then drives the step by the newest
    command. Its clock begins with the first scan at this computer's time and goes at `rate`, or as the commands come.

    Args:
        node: the node, with its parameters declared.
        settings: they.
        drive: the car, its episode begun with whole scans.
        rate: simulated seconds in a second.
        lockstep_s: wait so long, in real seconds, for the command that answers a scan, and no longer than until it is
            there; None: as long as a control step takes at that rate.
    """

    def __init__(
        self, node: Node, settings: SimSettings, drive: Drive, rate: float = 1.0, lockstep_s: float | None = None
    ) -> None:
        self._node, self._settings, self._drive = node, settings, drive
        self._rate, self._lockstep_s = rate, lockstep_s
        self._period_s = drive.config.physics.control_step_s
        self._mount = rotation_from_rpy(*drive.robot.lidar_rpy)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._clocks = create_publisher(node, Clock, "/clock", "reliable")
        self._odometries = create_publisher(node, Odometry, settings.odometry_topic, "reliable")
        self._clouds = create_publisher(node, PointCloud2, settings.cloud_topic, settings.reliability)
        self._scans = create_publisher(node, LaserScan, settings.scan_topic, settings.reliability)
        kind = TwistStamped if settings.stamped else Twist
        self._twists = create_subscription(node, kind, settings.command_topic, "best_effort", self._on_twist)
        if ackermann_type():
            topic = settings.ackermann_topic
            create_subscription(node, ackermann_type(), topic, "best_effort", self._on_ackermann)
        self._epoch_s, self._n = time.time(), 0
        self._published_s = self._stamp_s = math.inf
        self._command, self._command_step = Command(0.0, 0.0), -math.inf
        self._answered = self._steers_itself = False
        self._latencies_s: list[float] = []
        self.n_braked = self.n_unanswered = 0

    def run(self, reading: Reading, wait_s: float) -> dict[str, Any]:
        """Drive to the end of the episode and return what came of it.

        Args:
            reading: that of the episode's begin.
            wait_s: for the first command; the episode begins with it.

        Raises:
            ConfigError: no command came.
        """
        self._wait_for_a_driver(reading, wait_s)
        step: DriveStep | None = None
        deadline_s = min(self._published_s, time.monotonic())
        while step is None or step.outcome is None:
            if step is not None:
                self._publish(step.reading)
            deadline_s = self._wait(deadline_s)
            self.n_unanswered += not self._answered
            step = self._drive.step(self._fresh_command())
            self._n += 1
        self._publish(step.reading)
        return {
            "outcome": str(step.outcome),
            "world": self._drive.world.name,
            "steps": self._n,
            "time_s": round(self._n * self._period_s, 3),
            "braked": self.n_braked,
            "unanswered": self.n_unanswered,
            "latency_ms": percentiles_ms(self._latencies_s),
        }

    def _wait_for_a_driver(self, reading: Reading, wait_s: float) -> None:
        """Publish the first scan until a command answers it; simulated time goes on, the episode does not."""
        end_s = time.monotonic() + wait_s
        self._spin(end_s, lambda: self._answered or self._someone_listens())
        while not self._answered:
            if time.monotonic() >= end_s:
                raise ConfigError(
                    f"no command on {self._twists.topic_name} within {wait_s:g} s; does a driver run, with the same "
                    "ROS_DOMAIN_ID? zebrat ros drive --policy shipped"
                )
            self._epoch_s = time.time()
            self._publish(reading)
            again_s = time.monotonic() + (self._period_s / self._rate if self._lockstep_s is None else _SEND_AGAIN_S)
            self._spin(min(end_s, again_s), lambda: self._answered)

    def _someone_listens(self) -> bool:
        listened = self._clouds.get_subscription_count() + self._scans.get_subscription_count()
        return listened > 0 and self._node.count_publishers(self._settings.command_topic) > 0

    def _publish(self, reading: Reading) -> None:
        settings, drive = self._settings, self._drive
        self._stamp_s = self._epoch_s + self._n * self._period_s
        stamp = time_of(self._stamp_s)
        self._stamp_s = seconds(stamp)
        cloud = cloud_message(
            drive.lidar.cloud(drive.sweep), drive.config.lidar.n_channels, stamp, settings.lidar_frame
        )
        scan = scan_message(reading.scan, self._mount, stamp, settings.lidar_frame, self._period_s)
        odometry = odometry_message(drive.state, stamp, settings.odometry_frame, settings.base_frame)
        self._answered, self._published_s = False, time.monotonic()
        self._clocks.publish(Clock(clock=stamp))
        self._odometries.publish(odometry)
        self._clouds.publish(cloud)
        self._scans.publish(scan)

    def _wait(self, deadline_s: float) -> float:
        """Spin until the step is to be driven, and return when that was to be."""
        now_s = time.monotonic()
        if self._lockstep_s is not None:
            self._spin(now_s + self._lockstep_s, lambda: self._answered)
            return time.monotonic()
        deadline_s += self._period_s / self._rate
        if deadline_s < now_s:  # this computer did not keep up: the clock goes on by what was lost
            self._epoch_s += (now_s - deadline_s) * self._rate
            deadline_s = now_s
        self._spin(deadline_s, lambda: False)
        return deadline_s

    def _spin(self, until_s: float, done: Callable[[], bool]) -> None:
        while not done():
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                return
            self._executor.spin_once(timeout_sec=min(left_s, 0.1))

    def _fresh_command(self) -> Command:
        """Return the last command, or a brake where it is too old."""
        age_s = (self._n - self._command_step) * self._period_s
        if age_s > self._settings.timeout_s - 1e-6:
            self.n_braked += 1
            return Command(0.0, self._command.steering_rad)
        return self._command

    def _on_twist(self, message: Any) -> None:
        if self._steers_itself:
            return
        header, twist = (message.header, message.twist) if self._settings.stamped else (None, message)
        speed = float(twist.linear.x)
        steering = steering_of(speed, float(twist.angular.z), self._drive.robot.wheelbase_m)
        self._take(Command(speed, steering), header)

    def _on_ackermann(self, message: Any) -> None:
        self._steers_itself = True  # and a Twist of the same driver says less
        self._take(Command(float(message.drive.speed), float(message.drive.steering_angle)), message.header)

    def _take(self, command: Command, header: Any) -> None:
        if not math.isfinite(command.speed_mps + command.steering_rad):
            self._node.get_logger().warning(f"a command that is not finite is not obeyed: {command}")
            return
        stamp_s = math.inf if header is None else seconds(header.stamp)
        if self._lockstep_s is not None and stamp_s < self._stamp_s:
            return  # answers an earlier scan
        if not self._answered and stamp_s >= self._stamp_s:
            self._answered = True
            self._latencies_s.append(time.monotonic() - self._published_s)
        self._command, self._command_step = command, self._n
