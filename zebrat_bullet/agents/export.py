"""A trained policy as a folder that drives a real car: network, definition and model card; see `deploy`."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from zebrat_bullet.agents import load_agent, trained_task
from zebrat_bullet.agents.model_card import model_card
from zebrat_bullet.agents.onnx_file import onnx_of
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.assets import asset_folder, list_assets
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.deploy.car import Car, car_of, differences
from zebrat_bullet.deploy.definition import DEFINITION_FILE, MODEL_FILE, Definition
from zebrat_bullet.errors import PolicyError, ZebratError
from zebrat_bullet.files import is_file, read_text, shown
from zebrat_bullet.robot import fitted, load_robot
from zebrat_bullet.sensing.safety_region import make_region

CARD_FILE = "README.md"
_CLOSE_M = 1e-4


def export_policy(name_or_path: str, folder: Path, robot: str | None = None) -> Definition:
    """Write a policy as `policy.onnx`, `policy.json` and `README.md`, and return its definition.

    Args:
        name_or_path: a shipped policy, a .safetensors file or a run folder.
        folder: what to write into; files of an earlier export in it are replaced.
        robot: the car, None for that of the training.

    Raises:
        AssetError, ConfigError: there is no such policy, or its task is none.
        PolicyError: it is no trained network, needs to be told its next waypoint, or was trained for another car; or
            the package `onnx` is not installed.
    """
    task = trained_task(name_or_path) or TaskConfig()
    task = fitted(replace(task, robot=robot) if robot else task)
    agent = load_agent(name_or_path, task)
    if not isinstance(agent, PolicyAgent):
        raise PolicyError(
            f"{shown(name_or_path)!r} is no trained network: only policies can be exported, by a shipped name, a "
            ".safetensors file or a run folder"
        )
    if agent.observation.waypoint:
        raise PolicyError(
            f"policy {agent.name!r} observes the next waypoint, which nobody tells a car on the road: export one that "
            "was trained without guidance (any reward but wg and wg_paper)"
        )
    named = Path(name_or_path).name.removesuffix(".safetensors")
    model = onnx_of(agent)
    definition = _definition(agent, task, named, hashlib.sha256(model).hexdigest())
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MODEL_FILE).write_bytes(model)
    (folder / DEFINITION_FILE).write_text(_json(definition), encoding="utf-8")
    others = not_as_trained(name_or_path, definition.car)
    (folder / CARD_FILE).write_text(model_card(agent, definition, _own_card(name_or_path), others), encoding="utf-8")
    return definition


def not_as_trained(name_or_path: str, car: Car) -> list[str]:
    """Return in what a car differs from that of a policy's training; nothing where that is not known."""
    try:
        task = trained_task(name_or_path)
        return [] if task is None else differences(car, car_of(load_robot(task.robot), fitted(task).physics))
    except ZebratError:  # the car's file is on another machine: it was named anew for that
        return []


def _json(definition: Definition) -> str:
    """Return `policy.json`, a list of numbers on one line."""
    text = json.dumps(definition.data(), indent=1)
    return re.sub(r"\[[^\[\]{}]+\]", lambda numbers: " ".join(numbers[0].split()), text) + "\n"


def _own_card(name_or_path: str) -> str:
    """Return the Markdown file beside a policy's, or nothing."""
    shipped = name_or_path in list_assets("policies", ".safetensors")
    path = asset_folder("policies") / f"{name_or_path}.md" if shipped else Path(name_or_path).with_suffix(".md")
    return read_text(path, PolicyError) if is_file(path) else ""


def _definition(agent: PolicyAgent, task: TaskConfig, name: str, sha256: str) -> Definition:
    """Return all of a policy but its network, as the task says it."""
    robot, seen = load_robot(task.robot), agent.observation
    region = make_region(robot, task.region, task.lidar.n_bearings)
    watched = region.range_m.tolist()
    limits = task.physics.max_speed_mps, task.physics.max_steering_rad, task.lidar.range_max_m
    gaps = seen.gap_ranges_m or watched
    if (
        len(watched) != seen.n_rays
        or not np.allclose(gaps, watched, rtol=0.0, atol=_CLOSE_M)
        or not np.allclose(limits, (seen.max_speed_mps, seen.max_steering_rad, seen.range_max_m))
    ):
        raise PolicyError(
            f"policy {agent.name!r} was trained with {seen.n_rays} bearings and limits of {seen.max_speed_mps:g} m/s, "
            f"{seen.max_steering_rad:g} rad and {seen.range_max_m:g} m, or with another outline; {robot.source!r} has "
            f"{len(watched)} bearings and {limits[0]:g} m/s, {limits[1]:g} rad and {limits[2]:g} m: name the car of "
            "the training with --robot"
        )
    return Definition(
        name=name,
        head=agent.head,
        model_sha256=sha256,
        # Of a car that is a file, the name alone: its folder is nobody else's.
        car=replace(car_of(robot, task.physics), name=robot.urdf_path.stem),
        control_step_s=task.physics.control_step_s,
        n_bearings=task.lidar.n_bearings,
        indices=tuple(region.indices.tolist()),
        range_m=tuple(gaps),
        observation=seen,
        flatten=task.flatten,
    )
