"""A person as an agent: shown where the car is, asked for a command every control step of real time."""

import json
import time
from collections.abc import Set

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.teleop.hub import Hub
from zebrat_bullet.teleop.scene import view_of
from zebrat_bullet.types import Command, Reading

STEERING_STEPS = 3
SPEED_STEPS = 2


class RestartError(Exception):
    """The person gave this attempt up."""


def key_command(last: Command, keys: Set[str], limits: PhysicsConfig) -> Command:
    """Return the command of the keys that are down.

    A held key turns the wheel to full lock in three control steps and reaches full speed in two; a key that is let go
    lets both return to zero at the same rate. "stop" asks for speed zero at once.
    """
    speed = limits.max_speed_mps * (("forward" in keys) - ("reverse" in keys))
    steering = limits.max_steering_rad * (("left" in keys) - ("right" in keys))
    return Command(
        0.0 if "stop" in keys else _towards(last.speed_mps, speed, limits.max_speed_mps / SPEED_STEPS),
        _towards(last.steering_rad, steering, limits.max_steering_rad / STEERING_STEPS),
    )


def _towards(value: float, target: float, change: float) -> float:
    return max(value - change, min(value + change, target))


class PersonAgent:
    """Whoever holds the driver's seat of the hub. The clock starts with the first key and stands while nobody sits."""

    name = "person"
    privileged = frozenset({"pose", "map"})  # the top view shows both

    def __init__(self, hub: Hub, limits: PhysicsConfig) -> None:
        self._hub, self._limits = hub, limits

    def reset(self, seed: int) -> None:
        """Begin an episode; a person needs no seed."""
        self._hub.take_restart()
        self._tick = time.monotonic()

    def act(self, reading: Reading) -> Command:
        """Show the reading, wait for the next tick of the control clock and return what the keys say then.

        Raises:
            RestartError: R was struck.
        """
        assert reading.state is not None
        pose = reading.state.pose
        ready = reading.time_s == 0.0
        here, steering = (pose.x, pose.y, pose.yaw), reading.state.steering_rad
        view = view_of(here, reading.scan.ranges_m, reading.time_s, reading.speed_mps, steering)
        self._hub.show(show_view("ready" if ready else "driving", view))
        if ready:
            self._hub.wait(lambda: bool(self._hub.keys() - {"stop"}))
        self._wait_for_tick()
        return key_command(reading.last_command, self._hub.keys(), self._limits)

    def _wait_for_tick(self) -> None:
        # A late step is not caught up: the car would jump.
        self._tick = max(self._tick + self._limits.control_step_s, time.monotonic())
        self._hub.wait(self._hub.restart_struck, self._tick - time.monotonic())
        if not self._hub.occupied():
            self._hub.wait(self._hub.occupied)
            self._tick = time.monotonic()
        if self._hub.take_restart():
            raise RestartError


def show_view(phase: str, view: dict[str, object], **more: object) -> str:
    """Return what the page draws as JSON."""
    return json.dumps({"phase": phase} | view | more)
