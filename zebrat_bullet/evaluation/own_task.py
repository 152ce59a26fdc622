"""The task that a policy was trained on, as far as it says how the car drives and senses."""

import json
from dataclasses import fields, is_dataclass, replace

from zebrat_bullet.agents import trained_task
from zebrat_bullet.config import TaskConfig

_PARTS = ("physics", "lidar", "flatten", "region")


def as_trained(task: TaskConfig, agent: str, *, own_robot: bool) -> tuple[TaskConfig, list[str]]:
    """Return a task with limits, lidar, height band and safety region as an agent was trained with, and what changed.

    Reward, episodes, noise, dynamics and engine stay: they say what is judged. So do ray caster and cast bearings,
    which do not change what is seen.

    Args:
        task: to be judged under.
        agent: as `load_agent` takes it; one that was not trained changes nothing.
        own_robot: the agent's own car too.

    Raises:
        ZebratError: the agent cannot be loaded, or does not say a valid task.
    """
    trained = trained_task(agent)
    if trained is None:
        return task, []
    lidar = replace(trained.lidar, caster=task.lidar.caster, bearings=task.lidar.bearings)
    own = replace(
        task,
        robot=trained.robot if own_robot else task.robot,
        physics=replace(trained.physics, engine=task.physics.engine),
        flatten=trained.flatten,
        region=trained.region,
        lidar=lidar,
    )
    return own, [f"{key}={now} (default {was})" for key, was, now in _differing(task, own)]


def _differing(was: object, now: object, at: str = "task") -> list[tuple[str, str, str]]:
    if not is_dataclass(was) or not is_dataclass(now):
        return [] if was == now else [(at, json.dumps(was), json.dumps(now))]
    named = [f.name for f in fields(was) if at != "task" or f.name in ("robot", *_PARTS)]
    return [row for name in named for row in _differing(getattr(was, name), getattr(now, name), f"{at}.{name}")]
