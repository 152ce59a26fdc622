"""The node `zebrat_drive`: scans in, commands out, a stop where it cannot rely on what it hears."""

import math
import re
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import LaserScan, PointCloud2

from zebrat_bullet.deploy.decision import Decision
from zebrat_bullet.deploy.driver import AHEAD_S, Driver
from zebrat_bullet.deploy.senses import EARLY, turned_rays
from zebrat_bullet.deploy.supervisor import Supervisor
from zebrat_bullet.errors import SensorError
from zebrat_bullet.ros.latency import percentiles_ms
from zebrat_bullet.ros.listen import Listener, create_publisher
from zebrat_bullet.ros.messages import cloud_points, scan_ranges, seconds
from zebrat_bullet.ros.parameters import DriveSettings
from zebrat_bullet.ros.publish import ackermann_drive, ackermann_type, time_of, twist, twist_stamped
from zebrat_bullet.types import Command

_SAY_AGAIN_S = 10.0
_FROZEN_CLOCK_S = 2.0
"""Simulated time may stand still for so long before it counts as dead."""
_ROUNDING_S = 1e-3
_NUMBER = re.compile(r"[0-9.]+")
_AS_DUE = 0.05
"""A scan that is off its time by less than this share of a control step is on it."""
_LAST_WORD_S = 1.0
"""So long the last command may take to be acknowledged before the node ends."""
_GAPS = 5
"""So many waits for a scan say how long the next may be."""


class DriveNode:
    """Drives by each scan, once a control step, and stops the car where none comes.

    Args:
        node: the node, with its parameters declared.
        settings: they.
        driver: the policy.
        supervisor: what its commands must pass, None for nothing.
    """

    def __init__(self, node: Node, settings: DriveSettings, driver: Driver, supervisor: Supervisor | None) -> None:
        self._node, self._settings, self._driver, self._supervisor = node, settings, driver, supervisor
        self._sim_time = bool(node.get_parameter("use_sim_time").value)
        cos, sin = math.cos(settings.lidar_yaw_rad), math.sin(settings.lidar_yaw_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        self._rotation = turn @ np.array(driver.definition.car.lidar_rotation_base)
        self._speed: tuple[float, float] | None = None  # m/s, and when it was heard
        # When the last scan driven by came: on the node's clock, and on the steady one.
        self._heard: tuple[float, float] | None = None
        self._own_s = self._stamp_s = -math.inf  # stamp of the last scan: the lidar's own, and what counts as it
        self._driven = -math.inf, -math.inf  # of the last scan driven by: stamp, arrival
        self._gaps_s: deque[float] = deque(maxlen=_GAPS)  # from one such arrival to the next
        self._followed_s = -math.inf  # until when the policy's memory knows what the car was told
        self._slow_said_s = -math.inf
        self._repeats = False
        self._said, self._said_s = "", -math.inf
        self._stopped_s = -math.inf  # when the last command was sent, if it was a stop
        self.n_refused = self.n_silences = 0
        self.work_s: deque[float] = deque(maxlen=100_000)
        self.age_s: deque[float] = deque(maxlen=100_000)
        kind = TwistStamped if settings.stamped else Twist
        self._twists = create_publisher(node, kind, settings.command_topic, "reliable")
        self.command_topic = self._twists.topic_name
        self._ackermanns = None
        if ackermann_type() and settings.ackermann_topic:
            self._ackermanns = create_publisher(node, ackermann_type(), settings.ackermann_topic, "reliable")
        if settings.odometry_topic:  # before the scan: both ready, it is heard first
            Listener(node, Odometry, settings.odometry_topic, settings.reliability, self._on_odometry)
        sensor = PointCloud2 if settings.input == "cloud" else LaserScan
        self.listener = Listener(node, sensor, settings.sensor_topic, settings.reliability, self._on_scan)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(settings.watchdog_s / 10.0, self._watch, clock=steady)

    def _now_s(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def _on_odometry(self, message: Odometry) -> None:
        # Its age counts from arrival, unlike a scan's: a base may stamp by a clock of its own, and one that hangs falls
        # silent, after which the supervisor reckons from the commands. So odometry must come without much delay.
        self._speed = float(message.twist.twist.linear.x), time.monotonic()

    def _on_scan(self, message: Any) -> None:
        begin_s, now_s, own_s = time.monotonic(), self._now_s(), seconds(message.header.stamp)
        self._repeats = own_s == self._own_s
        if self._repeats:
            return  # the same scan again: a lidar that hangs is as good as none
        self._own_s = own_s
        stamp_s = own_s if self._settings.trust_stamps else now_s
        arrival_s, step_s = now_s if self._sim_time else begin_s, self._driver.definition.control_step_s
        back = stamp_s < self._stamp_s - 0.5 * step_s  # a clock that was set, a bag begun anew; less is jitter
        self._stamp_s = stamp_s
        early = stamp_s - self._driven[0] < EARLY * step_s
        if early and not back and arrival_s - self._driven[1] < (2.0 - EARLY) * step_s:  # jitter is no reason
            return
        self._gaps_s.append(arrival_s - self._driven[1])
        self._driven, age_s = (stamp_s, arrival_s), now_s - stamp_s
        since_s = self._since_s(arrival_s)
        decision = self._decide(message, age_s, since_s)
        # Stamps that creep tell nothing new: such a scan feeds the watchdog from when it was taken, not from now.
        late_s = max(0.0, age_s) if early and not decision.refusal else 0.0
        self._heard = now_s - late_s, begin_s - late_s
        self._send(self._checked(decision, age_s, since_s))
        self.work_s.append(time.monotonic() - begin_s)
        self.age_s.append(self._now_s() - stamp_s)

    def _decide(self, message: Any, age_s: float, since_s: float | None) -> Decision:
        is_cloud = self._settings.input == "cloud"
        try:
            self._check_origin(message.header.frame_id, age_s)
            seen = cloud_points(message) if is_cloud else scan_ranges(message)
        except SensorError as error:
            self._driver.follow(since_s)
            return Decision(self._stop(), f"{self.listener.topic}: {error}")
        age_s = max(0.0, age_s)  # how far from the future it may be was looked at
        if is_cloud:
            return self._driver.drive_cloud(seen, age_s, self._rotation, since_s=since_s)
        rays = turned_rays(self._rotation, float(message.angle_min), float(message.angle_increment))
        return self._driver.drive_scan(seen, *rays, age_s, since_s)

    def _since_s(self, now_s: float) -> float | None:
        """Return for how long the car has done what it was told last, None for a control step."""
        since_s, step_s = now_s - self._followed_s, self._driver.definition.control_step_s
        self._followed_s = now_s
        due = abs(since_s - step_s) <= _AS_DUE * step_s or not 0.0 <= since_s < math.inf
        return None if due else min(since_s, 2.0 * self._settings.watchdog_s)  # more: a clock was set

    def _hold_s(self) -> float | None:
        """Return how long a command may have to do until the next scan, None for a control step."""
        step_s = self._driver.definition.control_step_s
        longest_s = max((gap for gap in self._gaps_s if 0.0 < gap < math.inf), default=0.0)
        if longest_s <= (2.0 - EARLY) * step_s:
            return None
        if (now_s := time.monotonic()) - self._slow_said_s >= _SAY_AGAIN_S:
            self._slow_said_s = now_s
            self._node.get_logger().warning(
                f"the last scans driven by came up to {longest_s:.2f} s apart, the policy has learned to decide every "
                f"{step_s:g} s; the supervisor looks so far ahead, up to watchdog_s"
            )
        return min(longest_s, self._settings.watchdog_s)

    def _check_origin(self, frame: str, age_s: float) -> None:
        """Refuse a scan from another frame, and one whose age cannot be told."""
        if self._settings.lidar_frame and frame != self._settings.lidar_frame:
            raise SensorError(
                f"a scan in the frame {frame[:100]!r}, expected {self._settings.lidar_frame!r}; is it the right lidar? "
                "Then name its frame in the parameter lidar_frame"
            )
        if self._sim_time and self._now_s() == 0.0:
            raise SensorError("use_sim_time is true and nothing publishes /clock; set it to false on a real car")
        # In simulated time /clock may be heard after the scan of the same instant, by a whole control step.
        if -age_s > (self._settings.watchdog_s if self._sim_time else AHEAD_S):
            raise SensorError(
                f"a scan stamped {-age_s:.3f} s in the future: the lidar's clock is ahead of this computer's; "
                "synchronise the two (PTP, NTP), set use_sim_time for a simulated lidar, or trust_stamps to false"
            )
        if age_s > self._settings.watchdog_s:
            raise SensorError(
                f"a scan {age_s:.3f} s old by its stamp, at most {self._settings.watchdog_s:g} s are allowed; if the "
                "lidar is alive, its clock differs from this computer's: synchronise them, set use_sim_time for a "
                "simulated lidar, or trust_stamps to false"
            )

    def _stop(self) -> Command:
        return Command(0.0, self._driver.last_command.steering_rad)

    def _checked(self, decision: Decision, age_s: float, since_s: float | None) -> Decision:
        """Return what the limits and the supervisor leave of a decision."""
        speed, steering = self._settings.max_speed_mps, self._settings.max_steering_rad
        command = Command(
            max(-speed, min(speed, decision.command.speed_mps)),
            max(-steering, min(steering, decision.command.steering_rad)),
        )
        if self._supervisor is not None:
            scan = None if decision.refusal else self._driver.last_scan
            speed_mps = self._measured_speed()
            age_s = max(0.0, age_s)
            checked = self._supervisor.check(command, scan, speed_mps, None, age_s, self._hold_s(), since_s)
            decision = replace(checked, refusal=decision.refusal or checked.refusal)
            command = decision.command
        self._driver.last_command = command
        return replace(decision, command=command)

    def _measured_speed(self) -> float | None:
        """Return the last speed of the odometry, None where it is older than the watchdog allows."""
        if self._speed is None or time.monotonic() - self._speed[1] > self._settings.watchdog_s:
            return None
        return self._speed[0]

    def _watch(self) -> None:
        """Stop the car where no scan has come for too long, each control step anew."""
        self.listener.look()
        if self._heard is None:
            return
        silent_s, limit_s = time.monotonic() - self._heard[1], self._settings.watchdog_s
        if self._sim_time:
            frozen = silent_s >= max(_FROZEN_CLOCK_S, limit_s)
            silent_s = max(silent_s if frozen else 0.0, self._now_s() - self._heard[0])
        again = time.monotonic() - self._stopped_s >= self._driver.definition.control_step_s
        if silent_s > limit_s - _ROUNDING_S and again:
            self.n_silences += 1
            refusal = f"no scan on {self.listener.topic} for {silent_s:.2f} s"
            if self._repeats:
                refusal += ", but one stamp again and again; the lidar hangs, or does not stamp its scans"
            since_s = self._since_s(self._now_s() if self._sim_time else time.monotonic())
            self._driver.follow(since_s)
            self._send(self._checked(Decision(self._stop(), refusal), 0.0, since_s))

    def _send(self, decision: Decision) -> None:
        self._publish(decision.command)
        self._stopped_s = time.monotonic() if decision.command.speed_mps == 0.0 else -math.inf
        self.n_refused += bool(decision.refusal)
        said = _NUMBER.sub("#", decision.refusal)
        if said and (said != self._said or time.monotonic() - self._said_s >= _SAY_AGAIN_S):
            self._said_s = time.monotonic()
            self._node.get_logger().warning(f"stop: {decision.refusal}")
        elif self._said and not said:
            self._node.get_logger().info("drives on")
        self._said = said

    def _publish(self, command: Command) -> None:
        now_s = self._now_s()
        if self._sim_time:  # which may be told later than the scan that it belongs to
            now_s = max(now_s, self._stamp_s)
        stamp, frame = time_of(now_s), self._settings.base_frame
        car = self._driver.car
        stamped = self._settings.stamped
        self._twists.publish(twist_stamped(command, car, stamp, frame) if stamped else twist(command, car))
        if self._ackermanns is not None:
            self._ackermanns.publish(ackermann_drive(command, stamp, frame))

    def _wait_until_heard(self) -> None:
        """Wait for the last command: what is on its way when a publisher ends is not sent again, and the car would hold
        the one before.
        """
        end_s = time.monotonic() + _LAST_WORD_S
        for publisher in (self._twists, self._ackermanns):
            if publisher is None:
                continue
            left_s = max(0.0, end_s - time.monotonic())
            try:
                heard, why = publisher.wait_for_all_acked(Duration(seconds=left_s)), f"within {_LAST_WORD_S:g} s"
            except RuntimeError as error:  # RCLError: there is middleware that cannot tell
                heard, why = False, f"as far as ROS can tell ({' '.join(str(error).split())[:200]})"
            if not heard:
                self._node.get_logger().warning(
                    f"the last stop on {publisher.topic_name} was not acknowledged {why}: whoever listens may not have "
                    "heard it"
                )

    def end(self) -> dict[str, Any]:
        """Tell the car to stop, wait until it has heard, and return what came of the run."""
        self._publish(self._stop())
        with suppress(KeyboardInterrupt):  # a second one ends the wait
            self._wait_until_heard()
        return {
            "scans": self.listener.n_heard,
            "commands": len(self.work_s),
            "refused": self.n_refused,
            "silences": self.n_silences,
            "work_ms": percentiles_ms(self.work_s),
            "scan_age_ms": percentiles_ms(self.age_s),
        }
