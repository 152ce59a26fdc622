"""Drivers behind one protocol, and the way to get one by name or file."""

import json
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zebrat_bullet.agents.agent import PRIVILEGES, Agent, NoisyAgent, RandomAgent
from zebrat_bullet.agents.own import load_own
from zebrat_bullet.agents.policy import PolicyAgent, load_policy
from zebrat_bullet.assets import list_assets
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_json, with_overrides
from zebrat_bullet.errors import AssetError, ConfigError, PolicyError
from zebrat_bullet.files import is_file, shown
from zebrat_bullet.notes import Note
from zebrat_bullet.robot import fitted, load_robot
from zebrat_bullet.sensing.safety_region import make_region

__all__ = ["PRIVILEGES", "Agent", "PolicyNote", "code_or_weights", "load_agent", "trained_task"]

_CODE = ".py"
_CLOSE = 1e-3
"""m, m/s and rad by which a car may differ from that of a training."""
_LIMITS = ("max_speed_mps", "max_steering_rad")
Factory = Callable[[TaskConfig, Sequence[str]], Agent]
"""Makes an agent for a task, its config varied by "key=value" texts; imports what it needs only then."""


class PolicyNote(Note):
    """Says how the car that a policy is to drive is not that of its training."""


def load_agent(name_or_path: str, task: TaskConfig, noise_sigma: float = 0.0) -> Agent:
    """Return an agent by name ("random", "shipped", ...), policy file, training run folder (its best policy), or code.

    Args:
        name_or_path: which agent; those of `FACTORIES` may carry settings: "dwa:inflation_radius_m=0.5,vx_samples=10".
            "my_driver.py:HalfSpeed" runs that file and takes HalfSpeed(task).
        task: the task it will drive in: the robot, the limits of its commands.
        noise_sigma: Gaussian noise on its commands, as a fraction of the limits.

    Raises:
        AssetError: there is no such agent; the message lists those there are.
        ConfigError: the agent has no such setting, or its own code fails; or the noise is not 0 to 100.
        PolicyError: the file is not a policy of this package, or its car watched its outline in another order.
    """
    task = fitted(task)
    agent = _load(name_or_path, task)
    if isinstance(agent, PolicyAgent):
        _check_car(agent, task)
    if noise_sigma == 0.0:
        return agent
    return NoisyAgent(agent, noise_sigma, task.physics.max_speed_mps, task.physics.max_steering_rad)


def trained_task(name_or_path: str) -> TaskConfig | None:
    """Return the task that a policy was trained on, None of an agent that does not say one.

    Raises:
        AssetError, PolicyError: as `load_agent`.
        ConfigError: what it says is no valid task.
    """
    name = name_or_path.partition(":")[0]
    if name in FACTORIES or name.endswith(_CODE):
        return None
    task = _load_policy(name_or_path).provenance.get("config", {})
    task = task.get("task") if isinstance(task, dict) else None
    return None if task is None else from_json(TaskConfig, json.dumps(task))


def code_or_weights(agent: Agent) -> str:
    """Return what tells an agent from another of its name: the first 8 digits of a SHA-256, "" where the name says all.

    Of a policy's weights, of the file of one's own driver; that of an agent within another is the other's too.
    """
    return getattr(agent, "digest", "")


def _load(name_or_path: str, task: TaskConfig) -> Agent:
    name, colon, settings = name_or_path.partition(":")
    if name in FACTORIES:
        if colon and not settings:
            raise ConfigError(f"no setting stands behind {shown(name_or_path)}; write {name}, or {name}:KEY=VALUE")
        agent = FACTORIES[name](task, settings.split(",") if settings else [])
        agent.name = name_or_path
        return agent
    if name.endswith(_CODE):
        return load_own(name_or_path, task)
    return _load_policy(name_or_path)


def _load_policy(name_or_path: str) -> PolicyAgent:
    if is_file(Path(name_or_path) / "best.safetensors"):
        return load_policy(str(Path(name_or_path) / "best.safetensors"))
    try:
        return load_policy(name_or_path)
    except AssetError as error:
        shipped = list_assets("policies", ".safetensors")
        name = name_or_path.partition(":")[0]
        if name in shipped:
            raise ConfigError(
                f"the policy {name!r} has no settings, got {shown(name_or_path)}; write {name}"
            ) from error
        known = ", ".join([*FACTORIES, *shipped])
        raise AssetError(
            f"no agent {shown(name_or_path)!r}: name one of {known}, a .safetensors policy, a training run folder, or "
            "a driver of your own, FILE.py:NAME"
        ) from error


def _check_car(policy: PolicyAgent, task: TaskConfig) -> None:
    """Refuse a policy whose inputs would mean something else on this car, though there be as many of them.

    Of the very car of its training note what has changed since, of another where it is not as fast or agile.
    """
    trained_on: Any = policy.provenance
    for key in ("config", "task", "robot"):
        trained_on = trained_on.get(key) if isinstance(trained_on, dict) else None
    if trained_on == task.robot:
        _note_changes(policy, task)
        return
    if trained_on is not None:
        _check_bearings(policy, str(trained_on), task)
    if limits := [f"{name} {seen:g} for {now:g}" for name, seen, now in _limits_differing(policy, task)]:
        said = (
            f"policy {policy.name!r} observes something else than this car: {', '.join(limits)}; use the robot and the "
            "senses that it was trained with"
        )
        warnings.warn(PolicyNote(said), stacklevel=3)


def _check_bearings(policy: PolicyAgent, trained_on: str, task: TaskConfig) -> None:
    try:
        cars = load_robot(trained_on), load_robot(task.robot)
    except AssetError:  # its car is not on this machine: the number of its inputs is all there is to compare
        return
    then, now = (make_region(car, task.region, task.lidar.n_bearings) for car in cars)
    if (then.back, then.right, then.front, then.left) != (now.back, now.right, now.front, now.left):
        raise PolicyError(
            f"policy {policy.name!r} was trained on the robot {trained_on!r}, whose bearings lie otherwise than "
            f"those of {task.robot!r}; let it drive its own car, --robot {trained_on}, or train one for this: zebrat "
            f"train --robot {task.robot}"
        )


def _note_changes(policy: PolicyAgent, task: TaskConfig) -> None:
    watched = make_region(load_robot(task.robot), task.region, task.lidar.n_bearings).range_m
    changed = [f"{name} {now:g} instead of {then:g}" for name, then, now in _limits_differing(policy, task)]
    gaps = policy.observation.gap_ranges_m
    if len(gaps) == len(watched) and not np.allclose(watched, gaps, rtol=0.0, atol=_CLOSE):
        changed.append("another safety region")
    if changed:
        said = f"since the policy {policy.name!r} was trained, its car or task has changed: now {', '.join(changed)}"
        warnings.warn(PolicyNote(said), stacklevel=3)


def _limits_differing(policy: PolicyAgent, task: TaskConfig) -> list[tuple[str, float, float]]:
    """Return name, limit in training and limit here of those that differ."""
    limits = ((name, getattr(policy.observation, name), getattr(task.physics, name)) for name in _LIMITS)
    return [limit for limit in limits if abs(limit[1] - limit[2]) > _CLOSE]


def _random(task: TaskConfig, settings: Sequence[str]) -> Agent:
    if settings:
        raise ConfigError(f"the agent 'random' has no settings, got {', '.join(settings)}; leave them out")
    return RandomAgent(task.physics.max_speed_mps, task.physics.max_steering_rad)


def _oracle(task: TaskConfig, settings: Sequence[str]) -> Agent:
    from zebrat_bullet.agents.oracle import OracleAgent
    from zebrat_bullet.planning.hybrid_a_star import HybridAStarConfig

    return OracleAgent(with_overrides(HybridAStarConfig(), settings), task)


def _dwa(task: TaskConfig, settings: Sequence[str]) -> Agent:
    from zebrat_bullet.agents.dwa import DwaAgent
    from zebrat_bullet.planning.dwa import DwaConfig

    return DwaAgent(with_overrides(DwaConfig(), settings), task)


def _dwa_tuned(task: TaskConfig, settings: Sequence[str]) -> Agent:
    from zebrat_bullet.agents.dwa import DwaAgent
    from zebrat_bullet.planning.dwa import TUNED

    return DwaAgent(with_overrides(TUNED, settings), task)


def _teb(task: TaskConfig, settings: Sequence[str]) -> Agent:
    from zebrat_bullet.agents.teb import TebAgent
    from zebrat_bullet.planning.teb.config import TebConfig

    return TebAgent(with_overrides(TebConfig(), settings), task)


def _teb_tuned(task: TaskConfig, settings: Sequence[str]) -> Agent:
    from zebrat_bullet.agents.teb import TebAgent
    from zebrat_bullet.planning.teb.config import TUNED

    return TebAgent(with_overrides(TUNED, settings), task)


FACTORIES: dict[str, Factory] = {
    "random": _random,
    "dwa": _dwa,
    "dwa_tuned": _dwa_tuned,
    "teb": _teb,
    "teb_tuned": _teb_tuned,
    "oracle": _oracle,
}
