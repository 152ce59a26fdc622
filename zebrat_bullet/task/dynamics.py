"""How the cars of some episodes differ from what their URDF says: drawn once an episode, used by both simulations."""

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import DynamicsConfig
from zebrat_bullet.types import Dynamics


def draw_dynamics(config: DynamicsConfig, rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Draw (n, 5) dynamics, columns as the fields of `Dynamics`, each uniform in its range."""
    ranges = np.array(
        [config.acceleration, config.steering_rate, config.steering_offset_rad, config.speed, config.delay_s]
    )
    least, most = ranges.T
    return rng.uniform(least, most, size=(n, len(ranges)))


def draw_one(config: DynamicsConfig, rng: np.random.Generator) -> Dynamics:
    """Draw the dynamics of one car."""
    return Dynamics(*draw_dynamics(config, rng, 1)[0].tolist())
