"""A data set of driving to imitate: a folder (or a zip archive of one) of episode records, from any driver.

Every `.npz` below the folder is one episode (`evaluation/records.py` documents each array). Row t pairs what the driver
saw with what it did: `obs_m[t]` (and `command[t - 1]`, the last command, zero at t = 0) with `command[t]`. Beside a
record may lie `NAME.labels.npy`, (T, 2) float64, m/s and rad: what an expert would have done at each step of it. A
`NAME.planar.npz` holds many episodes on generated tracks (`demonstration.py`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.agents import Agent, code_or_weights
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_json
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.claim import claim_data_set, digests
from zebrat_bullet.evaluation.judge import record_path, require_each_once
from zebrat_bullet.evaluation.records import EpisodeRecord, load_record, save_record
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.files import is_file, read_npy
from zebrat_bullet.imitation.demonstration import SUFFIX, Demonstration, read_demonstrations
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.observation import ObservationSpec
from zebrat_bullet.training.archive import as_folder
from zebrat_bullet.training.places import judging_worlds

MAX_FAILURES_IN_A_ROW = 20


@dataclass(frozen=True, slots=True)
class Pairs:
    """Encoded training data.

    Attributes:
        observations: (N, size) float32, as `ObservationSpec.encode` makes them.
        actions: (N, 2) float32 in [-1, 1].
        episode: (N,) int64, which episode each pair is from.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    episode: NDArray[np.int64]


def demonstrate(
    agent: Agent,
    worlds: Sequence[str],
    n_pairs: int,
    folder: Path,
    task: TaskConfig,
    seed: int = 0,
    compact: bool = False,
    on_pairs: Callable[[int], None] = lambda n_pairs: None,
) -> dict[str, int]:
    """Let an agent drive, world after world, until its successful episodes hold enough pairs; keep every record.

    What a kill has left, and what a call for fewer pairs has made, is gone on with.

    Args:
        agent: the driver.
        worlds: world names or files, one episode in each, then the next in each.
        n_pairs: steps to reach; the last episode is driven to its end.
        folder: where the records go; empty, absent, or with the same agent's in the same worlds.
        task: the task driven.
        seed: of the start poses and the agent.
        compact: leave the scans out (`scan_m` then has no columns), which are five sixths of a record; imitation needs
            `obs_m` alone, and a replay drives the scans again.
        on_pairs: told after each episode how many pairs there are.

    Returns:
        "pairs", "episodes" and "successes".

    Raises:
        ConfigError: the folder holds something else, or nothing was asked for, or a world twice.
        ZebratError: the agent does not succeed in 20 episodes in a row.
    """
    if n_pairs < 1 or not worlds:
        raise ConfigError(
            f"demonstrate at least 1 pair in at least one world, got {n_pairs} pairs, {len(worlds)} worlds"
        )
    require_each_once(worlds)
    loaded = judging_worlds(worlds, task)
    places = dict(zip(worlds, loaded, strict=True))
    claim_data_set(
        folder, task, places, agent=[agent.name, code_or_weights(agent)], order=list(worlds), seed=seed, compact=compact
    )
    drive = Drive(task, loaded[0])
    done = {"pairs": 0, "episodes": 0, "successes": 0}
    failures = 0
    while done["pairs"] < n_pairs:
        round_, i = divmod(done["episodes"], len(worlds))
        path = record_path(folder, worlds[i], round_, worlds)
        if is_file(path):
            record = load_record(path)
        else:
            record = run_episode(drive, agent, seed, round_, loaded[i])
            save_record(replace(record, scan_m=record.scan_m[:, :0]) if compact else record, path)
        success = record.outcome == "success"
        failures = 0 if success else failures + 1
        done["episodes"] += 1
        done["successes"] += success
        done["pairs"] += success * len(record.command)
        on_pairs(done["pairs"])
        if failures == MAX_FAILURES_IN_A_ROW:
            raise ZebratError(
                f"{agent.name} failed in {failures} episodes in a row, the last in {record.world} by {record.outcome}; "
                f"name another agent or easier worlds (the records are in {folder})"
            )
    drive.close()
    return done


def labels_path(record: Path) -> Path:
    """Return where the expert's labels of a record lie."""
    return record.with_suffix(".labels.npy")


def load_demonstrations(folder: Path) -> list[Demonstration]:
    """Read a data set, a folder or a zip archive of one, in the order of its file names.

    An episode without labels is copied only if it succeeded: what a driver did on its way into a wall is nothing to
    learn. With an expert's labels every episode counts, the failed ones most.

    Raises:
        ConfigError: there is nothing to imitate, or the episodes differ in car, observation or command.
        ZebratError: a file is not an episode record, or its labels do not fit it.
    """
    if not folder.exists():
        raise ConfigError(f"there is no {folder}; name the folder, or the .zip of one, that holds demonstrations")
    if folder.suffix == ".npz":
        raise ConfigError(f"{folder} is one record; name the folder that it lies in, {folder.parent}")
    with as_folder(folder) as place:
        found = list(_demonstrations(place))
    if not found:
        raise ConfigError(
            f"{folder} holds no successful episode; record some with `zebrat demonstrate` or `zebrat teleop`"
        )
    tasks = {demonstration.task.robot: demonstration.task for demonstration in found}
    if len(tasks) > 1 and len(set(map(_car_of, tasks.values()))) > 1:
        raise ConfigError(f"{folder}: the episodes are of several cars, {', '.join(tasks)}; keep those of one")
    specs = {observation_of(demonstration) for demonstration in found}
    if len(specs) > 1:
        raise ConfigError(f"{folder}: the episodes differ in bearings, reach or limits: {specs}; keep one kind of them")
    return found


def _car_of(task: TaskConfig) -> str:
    """Return what tells the car from another, whatever its file is called; its name where it is not on this machine."""
    try:
        return str(digests(task, {})["car"])
    except ZebratError:
        return task.robot


def _demonstrations(folder: Path) -> Iterator[Demonstration]:
    for path in sorted(folder.rglob("*.npz")):
        if path.name.endswith(SUFFIX):
            yield from read_demonstrations(path)
            continue
        record = load_record(path)
        if labels_path(path).exists():
            labels = read_npy(labels_path(path), ZebratError)
            if labels.shape != record.command.shape or labels.dtype.kind != "f" or not np.isfinite(labels).all():
                raise ZebratError(
                    f"{labels_path(path)} has shape {labels.shape}, its record {record.command.shape}, and labels are "
                    "finite numbers; label it again"
                )
            yield _of_record(record, labels)
        elif record.outcome == "success":
            yield _of_record(record, record.command)


def _of_record(record: EpisodeRecord, labels: NDArray[np.float64]) -> Demonstration:
    last = np.concatenate([np.zeros((1, 2)), record.command[:-1]])
    task = from_json(TaskConfig, record.task)
    return Demonstration(record.world, "", task, record.range_m, record.obs_m[:-1], last, labels)


def observation_of(demonstration: Demonstration, log_gaps: bool = False) -> ObservationSpec:
    """Return the observation of the task that an episode was driven in, with the logarithms of the gaps or without."""
    task, range_m = demonstration.task, demonstration.range_m
    return ObservationSpec(
        n_rays=len(range_m),
        range_max_m=task.lidar.range_max_m,
        max_speed_mps=task.physics.max_speed_mps,
        max_steering_rad=task.physics.max_steering_rad,
        gap_ranges_m=tuple(range_m.tolist()) if log_gaps else (),
    )


def encode_pairs(demonstrations: Sequence[Demonstration], observation: ObservationSpec) -> Pairs:
    """Return every step of the demonstrations as training data."""
    observations = [
        observation.encode_cars(each.obs_m, each.last_command.astype(np.float32)) for each in demonstrations
    ]
    labels = np.concatenate([demonstration.labels for demonstration in demonstrations])
    lengths = [len(demonstration.labels) for demonstration in demonstrations]
    return Pairs(
        np.concatenate(observations),
        np.clip(labels / observation.limits, -1.0, 1.0).astype(np.float32),
        np.repeat(np.arange(len(lengths)), lengths),
    )
