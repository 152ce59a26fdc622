"""What a bag says of the car: the commands that it was given, and how fast it went."""

import math
from dataclasses import dataclass, field
from typing import Any

from zebrat_bullet.errors import SensorError
from zebrat_bullet.recording.bag import ACKERMANN, ACKERMANN_STAMPED, ODOMETRY, TWIST_STAMPED, Bag, Topic
from zebrat_bullet.ros.messages import steering_of
from zebrat_bullet.types import Command

STANDSTILL_MPS = 1e-3
"""Below this speed a Twist says nothing of the steering."""


@dataclass
class Heard:
    """What was heard so far.

    Attributes:
        wheelbase_m: of the car that the commands were meant for.
        twist_steers: `angular.z` of a Twist is the steering angle, not the yaw rate.
        last: the command that the car is under now; where a Twist does not say the steering, as it was before.
        measured_mps: speed of the last odometry, None before the first.
        times_ns, commands: all commands; the steering of one is nan where a Twist does not say it.
        n_unusable: messages whose bytes are none of their type, or whose numbers are not finite.
    """

    wheelbase_m: float
    twist_steers: bool = False
    last: Command = field(default_factory=lambda: Command(0.0, 0.0))
    measured_mps: float | None = None
    times_ns: list[int] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)
    n_unusable: int = 0

    @property
    def speed_mps(self) -> float:
        """Return how fast the car goes: as measured, or as it was told."""
        return self.last.speed_mps if self.measured_mps is None else self.measured_mps

    def take(self, bag: Bag, topic: Topic, time_ns: int, data: bytes) -> None:
        """Take in a command or an odometry; one that cannot be used is counted and passed over."""
        try:
            message = bag.decode(topic, data)
            if topic.kind == ODOMETRY:
                (self.measured_mps,) = _finite(message.twist.twist.linear.x)
                return
            command = self._command(message, topic.kind)
        except SensorError:
            self.n_unusable += 1
            return
        self.times_ns.append(time_ns)
        self.commands.append(command)
        steering = self.last.steering_rad if math.isnan(command.steering_rad) else command.steering_rad
        self.last = Command(command.speed_mps, steering)

    def _command(self, message: Any, kind: str) -> Command:
        if kind in (ACKERMANN, ACKERMANN_STAMPED):
            drive = message.drive if kind == ACKERMANN_STAMPED else message
            return Command(*_finite(drive.speed, drive.steering_angle))
        twist = message.twist if kind == TWIST_STAMPED else message
        speed, turning = _finite(twist.linear.x, twist.angular.z)
        if self.twist_steers:
            return Command(speed, turning)
        if abs(speed) < STANDSTILL_MPS:
            return Command(speed, math.nan)
        return Command(speed, steering_of(speed, turning, self.wheelbase_m))


def _finite(*numbers: float) -> list[float]:
    if not all(map(math.isfinite, numbers)):
        raise SensorError(f"numbers that are not finite: {numbers}")
    return [float(number) for number in numbers]
