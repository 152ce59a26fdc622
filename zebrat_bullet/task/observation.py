"""The only encoder of observations and decoder of actions; needs numpy alone, so the real car uses it too."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ActionError, ConfigError
from zebrat_bullet.types import Command, Reading

DISCRETE_COMMANDS = tuple((speed, steering) for speed in (-1.0, 1.0) for steering in (-1.0, 0.0, 1.0))
"""The six discrete actions as fractions of the speed and steering limits (paper: {-0.6, 0.6} x {-0.6, 0, 0.6})."""


@dataclass(frozen=True, kw_only=True)
class ObservationSpec:
    """The observation: V_obs in each bearing, then the last command, then the next waypoint.

    The paper's is 32 + 2 numbers, the default; under waypoint guidance 32 + 2 + 2, or 32 + 2 without the last command.
    Numbers are scaled to [-1, 1]: ranges and the waypoint's distance, cut off at the lidar's reach, linearly from 0 to
    that reach; the command by its limits; the waypoint's bearing by pi.

    Attributes:
        n_rays: bearings of the safety region.
        range_max_m: the lidar's reach.
        max_speed_mps, max_steering_rad: limits of a command.
        raw: True for SI values (m, m/s, rad) as in the paper, False for the same scaled to [-1, 1].
        last_command: the last speed and steering are part of it.
        waypoint: distance and bearing of the next waypoint are part of it.
    """

    n_rays: int
    range_max_m: float
    max_speed_mps: float
    max_steering_rad: float
    raw: bool = False
    last_command: bool = True
    waypoint: bool = False

    @property
    def size(self) -> int:
        """Numbers in an observation."""
        return self.n_rays + 2 * self.last_command + 2 * self.waypoint

    @property
    def limits(self) -> NDArray[np.float32]:
        """Return the (2,) limits of a command: speed in m/s and steering in rad."""
        return np.array([self.max_speed_mps, self.max_steering_rad], dtype=np.float32)

    @property
    def bounds(self) -> NDArray[np.float32]:
        """Return the (2, size) least and greatest observation."""
        reach, (speed, steering) = self.range_max_m, self.limits
        least, most = [0.0] * self.n_rays, [reach] * self.n_rays
        if self.last_command:
            least, most = [*least, -speed, -steering], [*most, speed, steering]
        if self.waypoint:
            least, most = [*least, 0.0, -np.pi], [*most, reach, np.pi]
        si = np.array([least, most], dtype=np.float32)
        return si if self.raw else np.stack([np.full_like(si[0], -1.0), np.ones_like(si[0])])

    def encode(self, reading: Reading) -> NDArray[np.float32]:
        """Return the (size,) float32 observation of a reading.

        Raises:
            ConfigError: the waypoint is part of it and the reading names none.
        """
        n = self.n_rays
        observation = np.empty(self.size, dtype=np.float32)
        observation[:n] = reading.clearance.obs_m
        if not self.raw:
            observation[:n] *= 2.0 / self.range_max_m
            observation[:n] -= 1.0
        if self.last_command:
            command = reading.last_command
            observation[n : n + 2] = command.speed_mps, command.steering_rad
            if not self.raw:
                observation[n : n + 2] /= self.limits
        if self.waypoint:
            observation[-2:] = self._waypoint(reading)
        return observation

    def _waypoint(self, reading: Reading) -> tuple[float, float]:
        if reading.waypoint is None:
            raise ConfigError(
                "the observation holds the next waypoint and the reading names none; declare the privilege 'waypoint'"
            )
        distance_m = min(reading.waypoint.distance_m, self.range_max_m)
        if self.raw:
            return distance_m, reading.waypoint.bearing_rad
        return 2.0 * distance_m / self.range_max_m - 1.0, reading.waypoint.bearing_rad / np.pi

    def decode(self, action: NDArray[np.float32] | Sequence[float]) -> Command:
        """Turn a (2,) action, in [-1, 1] (or SI where raw), into a command; beyond the limits it is clipped.

        Raises:
            ActionError: the action is not two finite numbers.
        """
        values = np.asarray(action, dtype=np.float64)
        if values.shape != (2,) or not np.isfinite(values).all():
            raise ActionError(f"an action is two finite numbers (speed, steering), got {action!r}")
        limits = self.max_speed_mps, self.max_steering_rad
        scaled = values.tolist() if self.raw else [values[0] * limits[0], values[1] * limits[1]]
        speed, steering = (max(-limit, min(limit, float(value))) for value, limit in zip(scaled, limits, strict=True))
        return Command(speed, steering)

    def decode_discrete(self, action: int) -> Command:
        """Turn an index into DISCRETE_COMMANDS into a command.

        Raises:
            ActionError: the index is out of range.
        """
        if not 0 <= int(action) < len(DISCRETE_COMMANDS):
            raise ActionError(f"a discrete action is 0..{len(DISCRETE_COMMANDS) - 1}, got {action!r}")
        speed, steering = DISCRETE_COMMANDS[int(action)]
        return Command(speed * self.max_speed_mps, steering * self.max_steering_rad)
