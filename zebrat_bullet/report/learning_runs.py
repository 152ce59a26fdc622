"""Training runs as their folders tell of them, grouped by algorithm, reward and settings.

Settings are read as plain JSON, not as a `TrainConfig`, so that the runs of older versions stay readable.
"""

import json
import math
import os
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import REWARD_PRESETS, ObservationConfig, RewardConfig, TaskConfig, with_reward
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.csv_log import read_rows
from zebrat_bullet.files import read_json, refusing
from zebrat_bullet.training.archive import as_folder
from zebrat_bullet.training.run_folder import is_finished

Table = dict[str, NDArray]
"""A CSV file by column: (N,) float64 and NaN where a cell is empty, or (N,) str for outcomes."""

_WHERE = ("episode", "total_steps", "wall_s")
_EPISODE_NUMBERS = (*_WHERE, "return", "steps")
_EVALUATION_NUMBERS = (*_WHERE, "success", "collision", "fail", "time_s", "best")
_LONGEST_VARIANT = 40
# What differs between the runs of a group, or cannot change what is learned.
_NO_SETTING = ("seed", "threads", "overlap", "checkpoint_every")


@dataclass(frozen=True, slots=True)
class TrainingRun:
    """One seed's run.

    Attributes:
        folder: where it is; of one in a zip archive, where it would be if that were a folder.
        seed: of the run.
        budget: how long it was to last: in episodes, of planar cars in steps; None where only its minutes are limited.
        unit: of the budget, "episodes" or "steps".
        finished: it came to its end.
        episodes: columns episode, total_steps, wall_s, return, steps, and outcome (str), a row an episode.
        evaluations: columns episode, total_steps, wall_s, success, collision, fail, time_s, best, a row a noise-free
            evaluation; time_s is NaN where nothing succeeded.
    """

    folder: Path
    seed: int
    budget: int | None
    unit: str
    finished: bool
    episodes: Table
    evaluations: Table


@dataclass(frozen=True, slots=True)
class RunGroup:
    """The runs that differ in nothing but the seed.

    Attributes:
        algo, reward: names, as in `zebrat train`; a reward of no preset is named by its weights.
        variant: what tells the group from others of the same algorithm and reward; empty where there are none.
        exit_reward: R_r, paid for reaching open space.
        runs: in the order of their seeds.
    """

    algo: str
    reward: str
    variant: str
    exit_reward: float
    runs: tuple[TrainingRun, ...]

    @property
    def label(self) -> str:
        """Its name among the groups of its reward."""
        return f"{self.algo} ({self.variant})" if self.variant else self.algo


def read_groups(folders: Iterable[Path]) -> list[RunGroup]:
    """Return every run in or below the folders or zip archives, grouped; sorted by reward, then algorithm.

    Raises:
        ConfigError: there is no run, a file is not what it should be, or two folders hold the same settings and seed.
    """
    settings: dict[Path, dict[str, Any]] = {}
    read: dict[Path, TrainingRun] = {}
    with ExitStack() as opened:
        for path, place in sorted(_find(folders, opened).items()):
            settings[path] = _read_settings(place / "config.json")
            read[path] = _read_run(path, place, settings[path])
    alike: dict[tuple[str, str], dict[str, list[Path]]] = defaultdict(lambda: defaultdict(list))
    for path, config in settings.items():
        names = reward_name(config["task"]), config.get("learner", {}).get("algo", "ddpg")  # once there was DDPG alone
        alike[names][json.dumps(_compared(config), sort_keys=True)].append(path)
    groups = []
    for (reward, algo), members in sorted(alike.items()):
        variants = _variants([(settings[paths[0]], paths) for paths in members.values()])
        for variant, paths in sorted(zip(variants, members.values(), strict=True)):
            runs = sorted((read[path] for path in paths), key=lambda run: run.seed)
            _refuse_twins(runs)
            exit_reward = float(settings[paths[0]]["task"]["reward"]["success"])
            groups.append(RunGroup(algo, reward, variant, exit_reward, tuple(runs)))
    return groups


def reward_name(task: dict[str, Any]) -> str:
    """Return the preset that a task's reward is, with what else was changed of it; or its weights, such as "1F+2T"."""
    reward = task["reward"]
    weights = {name: weight for name, weight in reward["weights"].items() if weight}
    presets = [name for name, preset in REWARD_PRESETS.items() if weights == preset.weights]
    # Presets of the same reward differ in what is observed.
    seen = ObservationConfig(**task.get("observation", {}))
    presets.sort(key=lambda name: with_reward(TaskConfig(), name).observation != seen)
    name = presets[0] if presets else "+".join(f"{weight:g}{term}" for term, weight in sorted(weights.items()))
    plain = RewardConfig()
    others = [field.name for field in fields(RewardConfig) if field.name != "weights"]
    changed = [f" {at}={reward[at]:g}" for at in others if reward.get(at, getattr(plain, at)) != getattr(plain, at)]
    return name + "".join(changed)


def _find(folders: Iterable[Path], opened: ExitStack) -> dict[Path, Path]:
    """Return where each run can be read, by where it is: another place if that is in an archive."""
    found: dict[Path, Path] = {}
    for folder in folders:
        place = opened.enter_context(as_folder(folder)).resolve()
        here = [path.parent for path in place.rglob("config.json") if (path.parent / "episodes.csv").is_file()]
        if not here:
            raise ConfigError(f"no training run in {folder}: a run's folder holds config.json and episodes.csv")
        found |= {folder.resolve() / path.relative_to(place): path for path in here}
    return found


def _read_settings(path: Path) -> dict[str, Any]:
    with refusing(path, ConfigError, "is not the settings of a training run", "leave its folder out"):
        config = read_json(path, ConfigError)
        reward_name(config["task"]), float(config["task"]["reward"]["success"])
        if not all(isinstance(config[name], int) for name in ("seed", "episodes")):
            raise ValueError("seed and episodes are whole numbers")
        if config.get("planar") and not isinstance(config["steps"], int | None):
            raise ValueError("steps of planar cars are a whole number, or null")
        return config


def _read_run(folder: Path, place: Path, config: dict[str, Any]) -> TrainingRun:
    episodes = _read_csv(place / "episodes.csv", _EPISODE_NUMBERS, ("outcome",))
    planar = bool(config.get("planar"))  # whose log holds the episodes of a few cars
    return TrainingRun(
        folder=folder,
        seed=config["seed"],
        budget=config["steps"] if planar else config["episodes"],
        unit="steps" if planar else "episodes",
        finished=is_finished(place) or (not planar and len(episodes["episode"]) >= config["episodes"]),
        episodes=episodes,
        evaluations=_read_csv(place / "evaluations.csv", _EVALUATION_NUMBERS, ()),
    )


def _read_csv(path: Path, numbers: Sequence[str], texts: Sequence[str]) -> Table:
    rows = read_rows(path)
    with refusing(path, ConfigError, "is not the log of a training run", "leave its folder out"):
        table: Table = {name: np.array([float(row[name] or math.nan) for row in rows], dtype=float) for name in numbers}
        return table | {name: np.array([row[name] for row in rows], dtype=str) for name in texts}


def _compared(config: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that make a group; each seed is fine-tuned from a model of its own."""
    return {name: at for name, at in config.items() if name not in _NO_SETTING} | {"init": bool(config.get("init"))}


def _variants(groups: Sequence[tuple[dict[str, Any], list[Path]]]) -> list[str]:
    """Return a name for each group of one algorithm and reward: what is set otherwise, or where it lies."""
    if len(groups) == 1:
        return [""]
    flat = [dict(_flatten(_compared(config))) for config, _ in groups]
    names = sorted({name for at in flat for name in at if len({other.get(name) for other in flat}) > 1})
    by_settings = [", ".join(f"{name.rsplit('.')[-1]}={at.get(name, '-')}" for name in names) for at in flat]
    firsts = [paths[0] for _, paths in groups]
    by_prefix = [re.sub(r"[-_]?seed[-_]?\d+$", "", path.name) or path.name for path in firsts]
    by_name = [
        prefix if by_prefix.count(prefix) == 1 else path.name for prefix, path in zip(by_prefix, firsts, strict=True)
    ]
    for variants in (by_settings, by_name):
        if len(set(variants)) == len(groups) and max(map(len, variants)) <= _LONGEST_VARIANT:
            return variants
    shared = os.path.commonpath(firsts)
    return [str(path.relative_to(shared)) for path in firsts]


def _flatten(settings: dict[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    for name, value in settings.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{name}.")
        else:
            yield prefix + name, "+".join(map(str, value)) if isinstance(value, list) else str(value)


def _refuse_twins(runs: Sequence[TrainingRun]) -> None:
    for one, two in pairwise(runs):
        if one.seed == two.seed:
            raise ConfigError(
                f"{one.folder} and {two.folder} are the same run, seed {one.seed}; name one of them, "
                "or it counts as two seeds"
            )
