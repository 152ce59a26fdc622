"""What users hand over for many cars at once: actions, chances of worlds, a state; each is checked as a whole first."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zebrat_bullet.arrays import Array, namespace, on_host
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_plain, to_json
from zebrat_bullet.errors import ActionError, ConfigError
from zebrat_bullet.files import shown
from zebrat_bullet.world.fingerprint import joint_fingerprint


def require_actions(actions: Array, n_cars: int, step: int) -> None:
    """Refuse actions that are not two finite numbers for each car.

    Args:
        actions: what was given.
        n_cars: N.
        step: number of the control step that they are for.

    Raises:
        ActionError: the message names the car.
    """
    if actions.shape != (n_cars, 2):
        raise ActionError(f"actions must have the shape {(n_cars, 2)}, got {tuple(actions.shape)}")
    finite = namespace(actions).isfinite(actions).all(-1)
    if not bool(finite.all()):
        car = int(np.flatnonzero(~on_host(finite))[0])
        raise ActionError(
            f"an action is two finite numbers (speed, steering), got {actions[car]} for car {car} in step {step}; "
            "nothing was simulated"
        )


def chances_of(weights: ArrayLike, n_worlds: int) -> NDArray[np.float64]:
    """Return the chance of each world to be drawn, read-only, from weights in the same proportion.

    Raises:
        ConfigError: they are not one finite number for each world, none below 0 and one above.
    """
    try:
        values = np.array(weights, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    total = values.sum()
    if values.shape != (n_worlds,) or not (values >= 0.0).all() or not 0.0 < total < np.inf:
        raise ConfigError(
            f"weights must be {n_worlds} numbers, one for each world, none below 0 and one above, got "
            f"{shown(repr(weights))}; give these, or None for worlds that are all alike"
        )
    values /= total
    values.flags.writeable = False
    return values


def facts_of(task: TaskConfig, fingerprints: Sequence[str]) -> dict[str, Any]:
    """Return what a state says of the task and the worlds that it was taken under, as JSON has it."""
    worlds = joint_fingerprint(fingerprints)
    return {"task": json.loads(to_json(task)), "n_worlds": len(fingerprints), "worlds": worlds}


def require_state_of(plain: Mapping[str, Any], task: TaskConfig, fingerprints: Sequence[str]) -> None:
    """Refuse a state that was taken under another task or among other worlds; one of an earlier version does not say.

    Raises:
        ConfigError: it was; the message says what to do.
    """
    if "task" not in plain:
        return
    then = from_plain(TaskConfig, plain["task"])
    if replace(then, lidar=replace(then.lidar, caster=task.lidar.caster)) != task:
        raise ConfigError("the state is of another task; load it into cars of the task that it was taken under")
    n, here = plain["n_worlds"], len(fingerprints)
    if n != here:
        instead = "call add_worlds first" if n > here else "make cars with those alone"
        raise ConfigError(f"the state was taken among {n} worlds, here are {here}; {instead}")
    if plain["worlds"] != joint_fingerprint(fingerprints):
        raise ConfigError("the state was taken among other worlds; give the cars those, in the same order")


def require_arrays(given: Mapping[str, NDArray], now: Mapping[str, Array], n_of: Mapping[str, int]) -> None:
    """Refuse arrays of a state that are not of such cars: kernels would read beyond them.

    Args:
        given: by name; more than there are now count for nothing.
        now: what they are to be put into.
        n_of: by name of those that hold places, 0 to one less than this.

    Raises:
        ValueError, KeyError: one is of another shape or kind, beyond its bounds, or missing.
    """
    for name, array in now.items():
        values, here = given[name], on_host(array)
        least, most = (0, n_of[name] - 1) if name in n_of else (-(2**31), 2**31 - 1)
        if values.shape != here.shape or values.dtype != here.dtype:
            raise ValueError(f"{name} must be {here.dtype} of shape {here.shape}, got {values.dtype} {values.shape}")
        if values.size and not (least <= values.min() and values.max() <= most):
            raise ValueError(f"{name} must be {least} to {most}, got {values.min()} to {values.max()}")
