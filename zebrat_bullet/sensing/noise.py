"""What a real lidar adds to the truth: noisy returns and lost ones."""

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import NoiseConfig


class NoiseModel:
    """Disturbs the ranges of a sweep; with the default settings it does nothing and draws nothing.

    The mount error of `NoiseConfig` is applied where the beams start (see `Lidar`), not here.
    """

    def __init__(self, config: NoiseConfig) -> None:
        self._config = config

    @property
    def draws(self) -> bool:
        """Whether `apply` draws anything."""
        return self._config.range_sigma_m > 0.0 or self._config.dropout > 0.0

    def apply(self, ranges_m: NDArray[np.float32], range_max_m: float, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the (N,) ranges in m as the sensor reports them; `range_max_m` stands for no return, in and out.

        Every ray draws, seen or not, so that the draws of later sweeps do not depend on what this one saw.
        """
        config = self._config
        if config.range_sigma_m > 0.0:
            noise = rng.standard_normal(len(ranges_m), dtype=np.float32) * np.float32(config.range_sigma_m)
            noisy = np.clip(ranges_m + noise, 0.0, range_max_m)
            ranges_m = np.where(ranges_m < range_max_m, noisy, ranges_m)
        if config.dropout > 0.0:
            lost = rng.random(len(ranges_m), dtype=np.float32) < config.dropout
            ranges_m = np.where(lost, np.float32(range_max_m), ranges_m)
        return ranges_m
