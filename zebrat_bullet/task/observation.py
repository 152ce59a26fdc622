"""The only encoder of observations and decoder of actions; needs numpy alone, so the real car uses it too."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ActionError
from zebrat_bullet.types import Command, Reading

DISCRETE_COMMANDS = tuple((speed, steering) for speed in (-1.0, 1.0) for steering in (-1.0, 0.0, 1.0))
"""The six discrete actions as fractions of the speed and steering limits (paper: {-0.6, 0.6} x {-0.6, 0, 0.6})."""


@dataclass(frozen=True, kw_only=True)
class ObservationSpec:
    """The observation of the paper: V_obs in each bearing and the last command, 32 + 2 numbers.

    Attributes:
        n_rays: bearings of the safety region.
        range_max_m: the lidar's reach.
        max_speed_mps, max_steering_rad: limits of a command.
        raw: True for SI values (m, m/s, rad) as in the paper, False for the same scaled to [-1, 1].
    """

    n_rays: int
    range_max_m: float
    max_speed_mps: float
    max_steering_rad: float
    raw: bool = False

    @property
    def size(self) -> int:
        """Numbers in an observation."""
        return self.n_rays + 2

    @property
    def limits(self) -> NDArray[np.float32]:
        """Return the (2,) limits of a command: speed in m/s and steering in rad."""
        return np.array([self.max_speed_mps, self.max_steering_rad], dtype=np.float32)

    def encode(self, reading: Reading) -> NDArray[np.float32]:
        """Return the (n_rays + 2,) float32 observation of a reading."""
        command = reading.last_command
        observation = np.empty(self.size, dtype=np.float32)
        observation[:-2] = reading.clearance.obs_m
        observation[-2:] = command.speed_mps, command.steering_rad
        if not self.raw:
            observation[:-2] *= 2.0 / self.range_max_m
            observation[:-2] -= 1.0
            observation[-2:] /= self.limits
        return observation

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

    def mirror(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (..., size) observations as seen by the left-right mirrored car."""
        rays = np.roll(observation[..., -3::-1], 1, axis=-1)
        command = observation[..., -2:] * np.array([1.0, -1.0], dtype=observation.dtype)
        return np.concatenate([rays, command], axis=-1)
