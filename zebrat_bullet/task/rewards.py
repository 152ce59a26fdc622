"""The reward, a pure function a term (paper, eq. 3-9). To add a term: write one function and name it in TERMS.

Which terms count, and how much, is `RewardConfig.weights`; every term, weighted, appears in the environment's `info`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import RewardConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.sensing.safety_region import SafetyRegion
from zebrat_bullet.types import Clearance, Command

N_FORWARD_RAYS = 6
N_OBSTACLE_RAYS = 13
N_MIDDLE_RAYS = 6
MIN_GAP_M = 1e-3


@dataclass(frozen=True, slots=True)
class RewardInput:
    """What a term may look at: the step's clearance, the region's named bearings, measured speed and the command.

    `nearer_m` is by how much the step brought the car nearer to the waypoint that was next; 0 in an unguided task.
    """

    clearance: Clearance
    region: SafetyRegion
    speed_mps: float
    command: Command
    config: RewardConfig
    nearer_m: float = 0.0


@lru_cache
def _discounts(n: int, discount: float) -> NDArray[np.float64]:
    return np.power(discount, np.arange(n, dtype=np.float64))


@lru_cache
def _rays(first: int, step: int, n: int, n_rays: int) -> NDArray[np.intp]:
    """Return n indices among the region's rays, from `first` on; straight back is both the first and the last."""
    return (first + step * np.arange(n)) % n_rays


def _n_to_the_back(right: int, left: int, n_rays: int) -> int:
    """Return how many rays there are on both sides, from these two to straight back: a sum never comes round it."""
    return min(right, n_rays - left) + 1


def forward_term(step: RewardInput) -> float:
    """F: forward speed times the free ranges ahead (eq. 4); v is measured, so pushing a wall earns nothing."""
    obs, front = step.clearance.obs_m, step.region.front
    n = min(N_FORWARD_RAYS, _n_to_the_back(front, front, len(obs)))
    ahead = obs[_rays(front, 1, n, len(obs))] + obs[_rays(front, -1, n, len(obs))]
    return float(step.speed_mps * (_discounts(n, step.config.discount) @ ahead))


def obstacle_term(step: RewardInput) -> float:
    """O: logarithm of the 13 smallest gaps between outline and obstacles, the smallest weighted most (eq. 5)."""
    gaps = np.sort(step.clearance.obs_m - step.clearance.range_m)[:N_OBSTACLE_RAYS]
    logs = np.log(np.maximum(gaps, MIN_GAP_M)) / np.log(step.config.log_base)
    return float(_discounts(len(logs), step.config.discount) @ logs)


def middle_term(step: RewardInput) -> float:
    """M: minus the difference between the left and right ranges, from abeam backwards (eq. 6).

    It keeps the lidar in the middle: where that is mounted off the centre line, the car drives off the middle as far.
    """
    obs = step.clearance.obs_m
    n = min(N_MIDDLE_RAYS, _n_to_the_back(step.region.right, step.region.left, len(obs)))
    right = obs[_rays(step.region.right, -1, n, len(obs))]
    left = obs[_rays(step.region.left, 1, n, len(obs))]
    return float(-_discounts(n, step.config.discount) @ np.abs(right - left))


def time_term(step: RewardInput) -> float:
    """T: minus one for every step (eq. 7)."""
    return -1.0


def waypoint_term(step: RewardInput) -> float:
    """W: how much nearer the car came to the next waypoint, in m, both distances to the same one (eq. 9)."""
    return step.nearer_m


TERMS: dict[str, Callable[[RewardInput], float]] = {
    "F": forward_term,
    "O": obstacle_term,
    "M": middle_term,
    "T": time_term,
    "W": waypoint_term,
}


def check_weights(config: RewardConfig) -> None:
    """Refuse weights of terms that do not exist.

    Raises:
        ConfigError: names the unknown term and lists the valid ones.
    """
    unknown = sorted(set(config.weights) - set(TERMS))
    if unknown:
        raise ConfigError(f"unknown reward term {unknown[0]!r}; valid terms are: {', '.join(TERMS)}")


def weighted_terms(step: RewardInput) -> dict[str, float]:
    """Return each weighted term of this step by name; a term that is switched off is 0."""
    weights = step.config.weights
    return {name: weights[name] * term(step) if weights.get(name) else 0.0 for name, term in TERMS.items()}
