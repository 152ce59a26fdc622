"""The reward, a pure function a term (paper, eq. 3-9). To add a term: write one function and name it in TERMS.

Every term is computed for N cars at once, in the planar simulation for thousands, in PyBullet for one. Which terms
count, and how much, is `RewardConfig.weights`; every term, weighted, appears in the environment's `info`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.arrays import Array, clamp, is_refused_write, like, namespace, on_host, read_only
from zebrat_bullet.config import RewardConfig
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.files import shown
from zebrat_bullet.sensing.safety_region import SafetyRegion
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.types import Clearances, Commands

N_FORWARD_RAYS = 6
N_OBSTACLE_RAYS = 13
N_MIDDLE_RAYS = 6
MIN_GAP_M = 1e-3


@dataclass(frozen=True, slots=True)
class RewardInput:
    """What a term may look at: the clearances of N cars, the region's named bearings, measured speeds and commands.

    A term gets what cannot be written to (of torch's arrays a copy): what it sees is the car's own state.

    Attributes:
        clearance: V_obs (N, R) and V_range (R,).
        region: whose bearings these are.
        speed_mps: (N,) measured forward speed.
        command: what was asked of the cars in this step.
        config: weights and settings.
        nearer_m: (N,), by how much the step brought each car nearer to the waypoint that was next; 0 where unguided.
    """

    clearance: Clearances
    region: SafetyRegion
    speed_mps: Array
    command: Commands
    config: RewardConfig
    nearer_m: Array


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


@lru_cache
def _forward_weights(front: int, n_rays: int, discount: float) -> NDArray[np.float64]:
    """Return (R,) how often, discounted, each ray counts in F; straight ahead counts twice."""
    n = min(N_FORWARD_RAYS, _n_to_the_back(front, front, n_rays))
    weights = np.zeros(n_rays)
    for step in (1, -1):
        np.add.at(weights, _rays(front, step, n, n_rays), _discounts(n, discount))
    return weights


def forward_term(step: RewardInput) -> Array:
    """F: forward speed times the free ranges ahead (eq. 4); v is measured, so pushing a wall earns nothing."""
    obs = step.clearance.obs_m
    return step.speed_mps * (obs @ like(_forward_weights(step.region.front, obs.shape[1], step.config.discount), obs))


def obstacle_term(step: RewardInput) -> Array:
    """O: logarithm of the 13 smallest gaps between outline and obstacles, the smallest weighted most (eq. 5, 6)."""
    obs = step.clearance.obs_m
    xp = namespace(obs)
    # Equal gaps are alike, so the order among them does not matter; a stable sort takes seven times as long.
    gaps = xp.sort(obs - step.clearance.range_m, axis=-1, stable=False)[:, :N_OBSTACLE_RAYS]
    logs = xp.log(clamp(gaps, MIN_GAP_M))
    return logs @ like(_discounts(logs.shape[1], step.config.discount) / np.log(step.config.log_base), obs)


def middle_term(step: RewardInput) -> Array:
    """M: minus the difference between the left and right ranges, from abeam backwards (eq. 7).

    It keeps the lidar in the middle: where that is mounted off the centre line, the car drives off the middle as far.
    """
    obs, region = step.clearance.obs_m, step.region
    xp, n_rays = namespace(obs), obs.shape[1]
    n = min(N_MIDDLE_RAYS, _n_to_the_back(region.right, region.left, n_rays))
    right = xp.take(obs, like(_rays(region.right, -1, n, n_rays), obs), axis=1)
    left = xp.take(obs, like(_rays(region.left, 1, n, n_rays), obs), axis=1)
    return -(xp.abs(right - left) @ like(_discounts(n, step.config.discount), obs))


def time_term(step: RewardInput) -> Array:
    """T: minus one for every step (eq. 8)."""
    return namespace(step.speed_mps).ones_like(step.speed_mps) * -1.0


def waypoint_term(step: RewardInput) -> Array:
    """W: how much nearer the car came to the next waypoint, in m, both distances to the same one (eq. 9)."""
    return step.nearer_m


TERMS: dict[str, Callable[[RewardInput], Array]] = {
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


def weighted_terms(step: RewardInput) -> dict[str, Array]:
    """Return each weighted term of this step, (N,), by name; a term that is switched off is 0.

    Raises:
        ConfigError: a term returned something else than one finite number a car; the message names it.
    """
    weights, xp = step.config.weights, namespace(step.speed_mps)
    none, seen = xp.zeros_like(step.speed_mps), _to_read(step)
    terms = {name: _one_a_car(name, term, seen) if weights.get(name) else none for name, term in TERMS.items()}
    if not bool(xp.isfinite(sum(terms.values())).all()):
        _refuse_non_finite(terms)
    return terms


def _to_read(step: RewardInput) -> RewardInput:
    """Return the same numbers in arrays that cannot be written to, or in copies."""
    clearance, command = step.clearance, step.command
    return replace(
        step,
        clearance=Clearances(*map(read_only, (clearance.obs_m, clearance.range_m, clearance.collision))),
        command=Commands(read_only(command.speed_mps), read_only(command.steering_rad)),
        speed_mps=read_only(step.speed_mps),
        nearer_m=read_only(step.nearer_m),
    )


def _one_a_car(name: str, term: Callable[[RewardInput], Array], step: RewardInput) -> Array:
    """Return what a term pays, weighted, in the precision of the speeds."""
    try:
        paid = term(step)
    except ZebratError:
        raise
    except Exception as error:
        if is_refused_write(error):
            said = f"writes to what it sees ({error}); let it compute on a copy"
        else:
            said = f"fails: {type(error).__name__}: {shown(error, 300)}; it is a function of a RewardInput: mend it"
        raise ConfigError(f"reward term {name!r} {said}") from error
    speed = step.speed_mps
    alike = isinstance(paid, np.ndarray) == isinstance(speed, np.ndarray)
    if getattr(paid, "shape", None) != speed.shape or not alike or not (paid.dtype == speed.dtype or _is_real(paid)):
        got = f"a {type(paid).__name__}"
        got += f" of shape {tuple(paid.shape)} and type {paid.dtype}" if hasattr(paid, "dtype") else ""
        raise ConfigError(
            f"reward term {name!r} returned {got}; a term returns one number a car, here an array of shape "
            f"{tuple(speed.shape)}, computed from those of its RewardInput"
        )
    return namespace(paid).astype(step.config.weights[name] * paid, speed.dtype, copy=False)


def _is_real(paid: Array) -> bool:
    return bool(namespace(paid).isdtype(paid.dtype, ("real floating", "integral", "bool")))


def _refuse_non_finite(terms: Mapping[str, Array]) -> None:
    for name, term in terms.items():
        wrong = np.flatnonzero(~np.isfinite(on_host(term)))
        if len(wrong):
            raise ConfigError(
                f"reward term {name!r} is {on_host(term)[wrong[0]]} for car {wrong[0]}; a term returns one finite "
                "number a car, whatever it sees: bound what it takes a root or a logarithm of, or divides by"
            )
    raise ConfigError(f"the reward terms {', '.join(terms)} are finite, but not their sum; give them smaller weights")


def terminal_codes(config: RewardConfig) -> NDArray[np.bool_]:
    """Return by code of an outcome, 0 while the episode goes on, whether the task ended rather than was cut off.

    Gymnasium calls the one terminated, the other truncated. A stall ends the task where it is paid for.
    """
    cut_off = {Outcome.TIMEOUT} if config.stall is not None else {Outcome.TIMEOUT, Outcome.STALL}
    return np.array([False, *(outcome not in cut_off for outcome in Outcome)])


def rewards(terms: Mapping[str, Array], outcome: Array, config: RewardConfig) -> Array:
    """Return the (N,) rewards of a step (eq. 3): the sum of the terms, and on a terminal step R_c or R_r alone.

    Args:
        terms: what `weighted_terms` returned.
        outcome: (N,) codes of `Outcome`, 0 where the episode goes on.
        config: says what the ends pay.
    """
    xp = namespace(outcome)
    false_exit = config.success if config.false_exit is None else config.false_exit
    paid = {Outcome.COLLISION: config.collision, Outcome.SUCCESS: config.success, Outcome.FALSE_EXIT: false_exit}
    if config.stall is not None:
        paid[Outcome.STALL] = config.stall
    total = sum(terms.values())
    for end, worth in paid.items():
        total = xp.where(outcome == end.code, worth, total)
    return total
