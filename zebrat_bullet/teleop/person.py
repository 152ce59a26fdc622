"""A person as an agent: shown where the car is, asked for a command every control step of real time."""

import json
import time
from collections.abc import Set

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.teleop.hub import Hub
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
        view = show_view(
            "ready" if ready else "driving",
            (pose.x, pose.y, pose.yaw),
            reading.scan.ranges_m,
            reading.time_s,
            reading.speed_mps,
            reading.state.steering_rad,
        )
        self._hub.show(view)
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


def show_view(
    phase: str,
    pose: tuple[float, float, float],
    ranges_m: NDArray[np.float32],
    time_s: float,
    speed_mps: float,
    steering_rad: float,
    **more: object,
) -> str:
    """Return what the page draws as JSON; ranges are whole millimetres to keep it small."""
    view = {
        "phase": phase,
        "pose": [round(value, 4) for value in pose],
        "scan_mm": np.rint(ranges_m * 1000.0).astype(int).tolist(),
        "time_s": round(time_s, 3),
        "speed_mps": round(speed_mps, 3),
        "steering_rad": round(steering_rad, 3),
    }
    return json.dumps(view | more)
