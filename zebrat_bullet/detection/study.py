"""The study: drive until enough contacts, score every case on them, put the counts together. Resumable, parallel."""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.agents import code_or_weights
from zebrat_bullet.config import MOST_SEED, TaskConfig, within
from zebrat_bullet.config_text import to_json
from zebrat_bullet.detection.cases import Case
from zebrat_bullet.detection.places import load_place
from zebrat_bullet.detection.representations import Representation
from zebrat_bullet.detection.scoring import Event, Sensing, TraceScore, score_trace, take_readings
from zebrat_bullet.detection.traces import (
    DRIVERS,
    WALLS,
    DriveJob,
    Trace,
    load_trace,
    load_unguided,
    record_drives,
    save_trace,
)
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.claim import digests
from zebrat_bullet.evaluation.npz import load_npz, save_npz
from zebrat_bullet.evaluation.workers import worker_pool
from zebrat_bullet.files import read_json, refusing
from zebrat_bullet.outputs import written_whole

SCORE_SCHEMA = "zebrat-trace-score-1"
N_DRIVES = 10
_IDLE_ROUNDS = 3

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and how much there is."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """What is driven.

    Attributes:
        worlds: names as `places.load_place` takes them.
        drivers, walls: see `traces`.
        n_events: contacts to drive for, in all worlds together, with each kind of walls.
        seed: fixes every drive.
        policy: the agent behind the driver "policy".
        task: robot, physics, and the drivers' own senses.
    """

    worlds: tuple[str, ...]
    drivers: tuple[str, ...] = DRIVERS
    walls: tuple[str, ...] = WALLS
    n_events: int = 1000
    seed: int = 0
    policy: str = "shipped"
    task: TaskConfig = field(default_factory=TaskConfig)

    def __post_init__(self) -> None:
        if self.n_events < 1:
            raise ConfigError(f"n_events must be at least 1, got {self.n_events}")
        within(self, n_events=(1, 10**8), seed=(0, MOST_SEED))
        if not (self.worlds and self.drivers and self.walls):
            raise ConfigError("name at least one world, one driver and one kind of walls")
        names = [job.file_name for walls in self.walls for job in self.jobs(walls, 0)]
        if len(set(names)) < len(names):
            raise ConfigError(
                "worlds (by their files' names, up to the last dot), drivers and walls must differ, got "
                f"{', '.join(self.worlds)}; {', '.join(self.drivers)}; {', '.join(self.walls)}"
            )

    def jobs(self, walls: str, round_: int) -> list[DriveJob]:
        """Return what is driven in a round: every driver in every world.

        Raises:
            ConfigError: there is no such driver or kind of walls.
        """
        return [
            DriveJob(
                world=world,
                driver=driver,
                walls=walls,
                seed=self.seed,
                chunk=round_,
                n_drives=N_DRIVES,
                task=self.task,
                policy=self.policy,
            )
            for world in self.worlds
            for driver in self.drivers
        ]


@dataclass(frozen=True, kw_only=True)
class Tally:
    """What a case made of all events with one kind of walls; fields as in `TraceScore`, put end to end.

    Attributes:
        events: the E events.
        lead_s: (E,) NaN where an event was not reported.
        in_time: (E,) bool.
        overlap_sweeps, overlap_reports: (E,) int.
    """

    events: list[Event]
    lead_s: NDArray[np.float64]
    in_time: NDArray[np.bool_]
    false_alarms: int
    clear_s: float
    overlap_sweeps: NDArray[np.int64]
    overlap_reports: NDArray[np.int64]


def drive(study: Study, folder: Path, workers: int | None, progress: Progress) -> dict[str, list[Path]]:
    """Drive until there are enough contacts; what lies in the folder already is not driven again.

    Every round drives `N_DRIVES` times with each driver in each world, so the result does not depend on the workers.

    Returns:
        The trace files by the kind of walls.

    Raises:
        ConfigError: the folder holds drives of another study, or nobody meets a wall.
        ZebratError: a world, the robot or the policy cannot be loaded; nothing was driven then.
    """
    load_place.cache_clear()  # a file may have been edited since this process read it last
    files = digests(study.task, {world: load_place(world, study.task.robot) for world in study.worlds})
    if "policy" in study.drivers:
        files["policy"] = code_or_weights(load_unguided(study.policy, study.task))
    _claim(folder, study, files)
    with worker_pool(workers, len(study.worlds) * len(study.drivers)) as pool:
        return {walls: _drive_rounds(study, walls, folder / "traces", pool, progress) for walls in study.walls}


def _claim(folder: Path, study: Study, files: dict[str, Any]) -> None:
    """Refuse a folder with drives of another study; only the number of events and the kinds of walls may differ.

    Args:
        folder: of the study.
        study: what is to be driven.
        files: what tells car, worlds and policy from others of their names.
    """
    mine = json.loads(to_json(study)) | {"n_events": None, "walls": None, "files": files}
    path = folder / "study.json"
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"a study is kept in a folder, {folder} is a file; name another --out")
    if any(folder.rglob("*.npz")):  # traces, or scores of traces since deleted
        then = read_json(path, ConfigError) if path.is_file() else None
        if not isinstance(then, dict) or then | {"files": files} != mine:
            raise ConfigError(f"{folder} holds drives with other settings (see {path.name} there); name another --out")
        # One from before these were kept says nothing of them.
        if then.get("files", files) != files:
            raise ConfigError(
                f"{folder} holds drives from before the file of the car, a world or the policy changed; put it back as "
                "it was, or name another --out"
            )
    (folder / "traces").mkdir(parents=True, exist_ok=True)
    with written_whole(path) as part:
        part.write_text(json.dumps(mine, indent=2), encoding="utf-8")


def _drive_rounds(study: Study, walls: str, folder: Path, pool: Executor, progress: Progress) -> list[Path]:
    paths: list[Path] = []
    n_events = 0
    for round_ in count():
        jobs = study.jobs(walls, round_)
        todo = [job for job in jobs if not (folder / job.file_name).is_file()]
        for n, future in enumerate(as_completed([pool.submit(_drive_job, job, folder) for job in todo])):
            future.result()
            progress(f"driving, {walls} walls, round {round_ + 1}", n + 1, len(todo))
        paths += [folder / job.file_name for job in jobs]
        n_events += sum(_count_events(load_trace(folder / job.file_name)) for job in jobs)
        if n_events >= study.n_events:
            return paths
        if n_events == 0 and round_ + 1 == _IDLE_ROUNDS:
            raise ConfigError(
                f"no drive met a wall in {_IDLE_ROUNDS * len(jobs) * N_DRIVES}; choose other worlds or drivers"
            )
    raise AssertionError


def _drive_job(job: DriveJob, folder: Path) -> None:
    save_trace(record_drives(job), folder / job.file_name)


def _count_events(trace: Trace) -> int:
    return int(np.count_nonzero(np.add.reduceat(trace.hits, trace.first_row[:-1])))


def score(
    study: Study,
    paths: dict[str, list[Path]],
    cases: Sequence[Case],
    folder: Path,
    workers: int | None,
    progress: Progress,
) -> dict[tuple[str, Case], Tally]:
    """Score every case on the traces; what was scored before is read from the folder.

    Returns:
        By the kind of walls and the case, in the order given.
    """
    result: dict[tuple[str, Case], Tally] = {}
    sensings = list(dict.fromkeys(case.sensing for case in cases))
    todo = [(sensing, walls, path) for sensing in sensings for walls in paths for path in paths[walls]]
    with worker_pool(workers, len(todo)) as pool:
        for n_done, (sensing, walls) in enumerate((s, w) for s in sensings for w in paths):
            what = list(dict.fromkeys(case.representation for case in cases if case.sensing == sensing))
            jobs = [pool.submit(_score_job, path, sensing, what, study, folder) for path in paths[walls]]
            scores = []
            for n, job in enumerate(jobs):
                scores.append(job.result())
                progress("scoring", n_done * len(jobs) + n + 1, len(todo))
            tallies = dict(zip(what, _tallies(scores, len(what)), strict=True))
            result |= {(walls, case): tallies[case.representation] for case in cases if case.sensing == sensing}
    return {(walls, case): result[walls, case] for walls in paths for case in cases}


def run_study(
    study: Study, cases: Sequence[Case], folder: Path, workers: int | None, progress: Progress
) -> dict[tuple[str, Case], Tally]:
    """Drive and score; see `drive` and `score`."""
    for case in cases:
        case.sensing.steps_between(study.task.physics.rate_hz)
    return score(study, drive(study, folder, workers, progress), cases, folder, workers, progress)


def load_event_trace(study: Study, event: Event, folder: Path) -> Trace:
    """Return the trace that holds an event."""
    jobs = study.jobs(event.walls, event.chunk)
    job = next(job for job in jobs if (job.world, job.driver) == (event.world, event.driver))
    return load_trace(folder / "traces" / job.file_name)


def _score_job(path: Path, sensing: Sensing, what: list[Representation], study: Study, folder: Path) -> TraceScore:
    key = json.dumps([to_json(sensing), [to_json(one) for one in what], study.seed])
    kept = folder / "scores" / hashlib.sha256(key.encode()).hexdigest()[:12] / path.name
    if kept.is_file():
        return _load_score(kept)
    trace = load_trace(path)
    readings = take_readings(trace, study.task.robot, sensing, study.seed)
    made = score_trace(trace, readings, what, study.task.robot)
    save_npz(kept, SCORE_SCHEMA, asdict(made))
    return made


def _load_score(path: Path) -> TraceScore:
    with refusing(path, ZebratError, "is not a score", "delete it, and it is scored anew"):
        values = load_npz(path, SCORE_SCHEMA)
        return TraceScore(**values | {"events": [Event(**event) for event in values["events"]]})


def _tallies(scores: Sequence[TraceScore], n: int) -> Iterator[Tally]:
    events = [event for one in scores for event in one.events]
    for r in range(n):
        yield Tally(
            events=events,
            lead_s=np.concatenate([one.lead_s[r] for one in scores]),
            in_time=np.concatenate([one.in_time[r] for one in scores]),
            false_alarms=int(sum(one.false_alarms[r] for one in scores)),
            clear_s=sum(one.clear_s for one in scores),
            overlap_sweeps=np.concatenate([one.overlap_sweeps for one in scores]),
            overlap_reports=np.concatenate([one.overlap_reports[r] for one in scores]),
        )
