"""Recovery from oscillation: a car that goes nowhere while it turns to and fro is made to keep on turning one way."""

import math
from collections import deque

import numpy as np

from zebrat_bullet.planning.teb.config import TebConfig


class Oscillation:
    """Finds a car that turns left and right on the spot, and then holds it to one direction for a while.

    Args:
        config: over how long it looks, what it calls the spot, and how long it holds.
        control_step_s: time between two commands.
    """

    def __init__(self, config: TebConfig, control_step_s: float) -> None:
        self._config = config
        self._recent: deque[tuple[float, float]] = deque(
            maxlen=max(2, round(config.oscillation_filter_duration_s / control_step_s))
        )
        self._until_s, self._turn = -math.inf, 0.0

    def update(self, speed: float, turning: float, yaw_rate_radps: float, time_s: float) -> None:
        """Take in the last command.

        Args:
            speed, turning: as fractions of their limits.
            yaw_rate_radps: measured; the direction to hold if this begins an oscillation.
            time_s: now.
        """
        self._recent.append((speed, turning))
        assert self._recent.maxlen is not None
        if len(self._recent) < self._recent.maxlen // 2:
            return
        speeds, turnings = np.array(self._recent).T
        eps = self._config.oscillation_eps
        crossings = np.count_nonzero(np.diff(np.sign(turnings)))
        if abs(speeds.mean()) < eps and abs(turnings.mean()) < eps and crossings > 1:
            if time_s >= self._until_s:
                self._turn = 1.0 if yaw_rate_radps > 0.0 else -1.0
            self._until_s = time_s + self._config.oscillation_recovery_min_duration_s

    def preferred_turn(self, time_s: float) -> float:
        """Return +1 to hold on turning left, -1 right, 0 for no preference."""
        return self._turn if time_s < self._until_s else 0.0
