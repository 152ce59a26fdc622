"""One episode to imitate, and the file that keeps those of many generated tracks: `NAME.planar.npz`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_json, to_json
from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.npz import load_npz, save_npz
from zebrat_bullet.files import refusing
from zebrat_bullet.world import FAMILIES

SCHEMA = "zebrat-demonstrations-1"
SUFFIX = ".planar.npz"


@dataclass(frozen=True, slots=True)
class Demonstration:
    """One episode to imitate, T steps of it.

    Attributes:
        world: where: a name or file that can be loaded, or the name of a generated track.
        family: of the generated track; "" of a world that can be loaded.
        task: under which task.
        range_m: (R,) float32, V_range in m.
        obs_m: (T, R) float32, V_obs in m before each command.
        last_command: (T, 2) the command before, m/s and rad; zero at the start.
        labels: (T, 2) the commands that are right, m/s and rad.
    """

    world: str
    family: str
    task: TaskConfig
    range_m: NDArray[np.float32]
    obs_m: NDArray[np.float32]
    last_command: NDArray[np.floating]
    labels: NDArray[np.floating]


def save_demonstrations(demonstrations: Sequence[Demonstration], path: Path) -> None:
    """Write episodes of one task on generated tracks in one file, whole or not at all."""
    first = demonstrations[0]
    values: dict[str, object] = {
        "task": to_json(first.task),
        "worlds": [each.world for each in demonstrations],
        "families": [each.family for each in demonstrations],
        "n_steps": np.array([len(each.labels) for each in demonstrations], dtype=np.int64),
        "range_m": first.range_m,
    }
    rows = {
        name: np.concatenate([getattr(each, name) for each in demonstrations]).astype(np.float32)
        for name in ("obs_m", "last_command", "labels")
    }
    save_npz(path, SCHEMA, values | rows)


def read_demonstrations(path: Path) -> Iterator[Demonstration]:
    """Yield the episodes of a file that `save_demonstrations` wrote.

    Raises:
        ZebratError: it is no such file, or its arrays do not fit together.
    """
    with refusing(path, ZebratError, "is no file of demonstrations", "record them again with `zebrat demonstrate`"):
        values = load_npz(path, SCHEMA)
        task, n_steps, range_m = from_json(TaskConfig, values["task"]), values["n_steps"], values["range_m"]
        _check(values)
    ends = n_steps.cumsum()
    for i, (end, n) in enumerate(zip(ends.tolist(), n_steps.tolist(), strict=True)):
        rows = slice(end - n, end)
        arrays = (values[name][rows] for name in ("obs_m", "last_command", "labels"))
        yield Demonstration(values["worlds"][i], values["families"][i], task, range_m, *arrays)


def seed_of(track: str) -> int:
    """Return the seed in the name of a generated track."""
    return int(track.rpartition("-")[2])


def _check(values: dict[str, NDArray]) -> None:
    n_steps, worlds, families = values["n_steps"], values["worlds"], values["families"]
    if n_steps.ndim != 1 or n_steps.dtype != np.int64 or not len(n_steps) or n_steps.min() < 1:
        raise ValueError("n_steps must be the steps of each episode, at least 1")
    if not (isinstance(worlds, list) and isinstance(families, list) and set(families) <= set(FAMILIES)):
        raise ValueError(f"worlds must be names, families some of {', '.join(FAMILIES)}")
    if not len(worlds) == len(families) == len(n_steps) or min(seed_of(name) for name in worlds) < 0:
        raise ValueError(f"{len(n_steps)} episodes need as many generated tracks and families")
    n, n_rays = int(n_steps.sum()), len(values["range_m"])
    for name, shape in (("range_m", (n_rays,)), ("obs_m", (n, n_rays)), ("last_command", (n, 2)), ("labels", (n, 2))):
        array = values[name]
        if array.shape != shape or array.dtype != np.float32 or not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite float32 numbers of shape {shape}, got {array.dtype} {array.shape}")
