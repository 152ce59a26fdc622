"""What a comparison does, step by step, each a command of `zebrat`; whether a step is done, its outputs say."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Protocol

from zebrat_bullet.comparison.cells import Cell, cells
from zebrat_bullet.comparison.manifest import Contacts, Judgement
from zebrat_bullet.comparison.named import digest_of_agent, digest_of_world, digests_of_files, folder_name
from zebrat_bullet.comparison.policies import Place, best_model, best_policy
from zebrat_bullet.comparison.records import digest, read_records
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.csv_log import read_rows
from zebrat_bullet.evaluation.set_episodes import SCHEMA
from zebrat_bullet.evaluation.track_set import TrackSet, read_set
from zebrat_bullet.files import is_file, read_json
from zebrat_bullet.training.run_folder import is_finished
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep import MANIFEST, Sweep, read_manifest, runs_of, sweep_command

MADE_BY, SCORES, CASES = "made_by.json", "scores.json", "cases.csv"


class Step(Protocol):
    """One command.

    Attributes:
        name: of the step, unique.
        folder: where its outputs are.
        alone: whether it keeps all cores busy by itself; one that does not keeps one busy.
    """

    @property
    def name(self) -> str:
        """Name of the step, unique."""

    @property
    def folder(self) -> Path:
        """Where its outputs are."""

    @property
    def alone(self) -> bool:
        """Whether it keeps all cores busy by itself."""

    def is_done(self) -> bool:
        """Return whether its outputs are all there."""

    def command(self) -> list[str]:
        """Return what `zebrat` is called with; prepares the folder.

        Raises:
            ZebratError: what it needs is not there: a step before it has failed.
        """


@dataclass(frozen=True, kw_only=True)
class Train:
    """The runs of a training: a sweep, which resumes each from its checkpoint."""

    place: Place
    training: str
    sweep: Sweep
    folder: Path
    ray: str | None = None
    alone: ClassVar[bool] = True

    @property
    def name(self) -> str:
        """Name of the step, unique."""
        return f"train {self.folder.relative_to(self.place.out / 'training')}"

    def missing(self) -> list[Path]:
        """Return the runs that are not finished, here or in what is kept."""
        readable = self.place.readable_runs(self.training)
        return [run for run in runs_of(self.sweep, self.folder) if not is_finished(readable[run])]

    def is_done(self) -> bool:
        """Return whether every run came to its end."""
        return not self.missing()

    def command(self) -> list[str]:
        """Return the smallest sweep with all that is missing, and what another budget has begun in this folder."""
        missing, begun = set(self.missing()), self.folder / MANIFEST
        before = read_manifest(begun) if is_file(begun) else {}

        def needed(axis: str) -> tuple[Any, ...]:
            """Return the values on an axis of missing runs, and those begun: another budget has other seeds."""
            values, had = getattr(self.sweep, axis), before.get(axis, ())
            asked = (value for value in values if value in had or not missing.isdisjoint(only(**{axis: (value,)})))
            return tuple(dict.fromkeys([*asked, *had]))

        def only(**axes: Any) -> dict[Path, TrainConfig]:
            return runs_of(replace(self.sweep, **axes), self.folder)

        sweep = replace(self.sweep, algos=needed("algos"), rewards=needed("rewards"), seeds=needed("seeds"))
        if init := self.place.manifest.trainings[self.training].init:
            (algo,), (reward,) = sweep.algos, sweep.rewards
            sweep = replace(sweep, set=(*sweep.set, f"init={best_model(self.place, init, algo, reward)}"))
        return [*sweep_command(sweep, str(self.folder)), *(("--ray", self.ray) if self.ray else ()), "--quiet"]


@dataclass(frozen=True, kw_only=True)
class Collisions:
    """The study of which representation sees a contact."""

    folder: Path
    what: Contacts
    alone: ClassVar[bool] = True

    @property
    def name(self) -> str:
        """Name of the step, unique."""
        return f"collisions, {self.what.events} contacts"

    def is_done(self) -> bool:
        """Return whether the study of at least so many contacts has left its tables, the last of which is table.md."""
        rows = read_rows(self.folder / CASES)
        base = [int(float(row["contacts"])) for row in rows if row["panel"] == "base"]
        return bool(base) and min(base) >= self.what.events and is_file(self.folder / "table.md")

    def command(self) -> list[str]:
        """Return the study, which goes on from the drives that it has."""
        how = ["--events", str(self.what.events), *self.what.options]
        return ["collisions", *how, "--out", str(self.folder), "--no-video", "--quiet"]


@dataclass(frozen=True, kw_only=True)
class Judge:
    """One agent in one place."""

    place: Place
    cell: Cell
    alone: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """Name of the step, unique."""
        return f"judge {self.folder.relative_to(self.place.out / 'judged')}"

    @property
    def folder(self) -> Path:
        """Where scores and records are."""
        cell = self.cell
        if cell.agent:
            who = folder_name(cell.agent)
        else:
            folder = self.place.training_folder(cell.training).name
            who = f"{folder}-{cell.algorithm}-{cell.reward}" + ("" if cell.seed is None else f"-seed{cell.seed}")
        return self.place.out / "judged" / cell.judgement / who / folder_name(cell.place)

    @property
    def how(self) -> Judgement:
        """The judgement that the cell is of."""
        return self.place.manifest.judgements[self.cell.judgement]

    def agent(self) -> str:
        """Return who drives: a name, or the path of a policy.

        Raises:
            ConfigError: there is no policy yet.
        """
        cell = self.cell
        if not cell.agent:
            return str(best_policy(self.place, cell.training, cell.algorithm, cell.reward, cell.seed))
        file = self.place.checkout / cell.agent
        return str(file) if is_file(file) else cell.agent

    def _n_tracks(self) -> int | None:
        """Return how many tracks of a set are driven: as many as are asked for, or all; None of a world."""
        if not self.cell.is_set:
            return None
        asked = self.place.plan.judgements[self.cell.judgement].tracks or self.how.tracks
        return min(asked, len(_set(self.cell.place).tracks)) if asked else None

    def made_by(self) -> dict[str, Any]:
        """Return what the outputs depend on but for the number of episodes; the agent by a portable name."""
        agent, world = self.agent(), None if self.cell.is_set else digest_of_world(self.cell.place)
        made_by = {
            "agent": self.place.portable(Path(agent)) if is_file(agent) else agent,
            "sha256": digest_of_agent(agent),
            "sim": self.cell.sim,
            "seed": self.how.seed,
            "options": list(self.how.options),
            "set": _set(self.cell.place).sha256 if self.cell.is_set else None,
            "tracks": self._n_tracks(),
            "starts": self.cell.episodes if self.cell.is_set else None,
        }
        files = digests_of_files(self.how.options)
        known = {"world": world, "files": files or None, "format": SCHEMA if self.cell.is_set else None}
        return made_by | {name: value for name, value in known.items() if value is not None}

    def is_done(self) -> bool:
        """Return whether it is driven, or kept."""
        return self.is_driven() or self.is_kept()

    def is_kept(self) -> bool:
        """Return whether the budget's records hold it: of this agent, as many episodes at least."""
        if (records := self.place.records) is None:
            return False
        try:
            key = digest(self.made_by()), self.cell.place
        except ZebratError:  # nobody has learned to drive it yet, or what is named is not there
            return False
        episodes = [row["episode"] for row in read_records(records).episodes.get(key, ())]
        return bool(episodes) and max(episodes) + 1 >= self.cell.episodes

    def is_driven(self) -> bool:
        """Return whether the scores are of this agent and of as many episodes at least."""
        try:
            if read_json(self.folder / MADE_BY, ZebratError) != self.made_by():
                return False
            scores = read_json(self.folder / SCORES, ZebratError)
            (score,) = scores.values()
            return self.cell.is_set or score["episodes"] >= self.cell.episodes
        except (ZebratError, AttributeError, KeyError, TypeError, ValueError):
            return False  # nothing yet, or what a kill has left

    def command(self) -> list[str]:
        """Return the evaluation; what another agent has left in the folder goes."""
        made_by = self.made_by()
        path = self.folder / MADE_BY
        if not is_file(path) or path.read_text(encoding="utf-8") != json.dumps(made_by):
            shutil.rmtree(self.folder, ignore_errors=True)
            self.folder.mkdir(parents=True)
            path.write_text(json.dumps(made_by), encoding="utf-8")
        return [*self.evaluation(self.agent()), "--workers", "1", "--out", str(self.folder), "--quiet"]

    def evaluation(self, agent: str) -> list[str]:
        """Return what is asked of `zebrat evaluate`, but for how and where."""
        where = ["--set", self.cell.place] if self.cell.is_set else ["--worlds", self.cell.place]
        n_tracks = self._n_tracks()
        return [
            *("evaluate", "--agent", agent, *where, *(["--tracks", str(n_tracks)] if n_tracks else [])),
            *("--sim", self.cell.sim, "--episodes", str(self.cell.episodes), "--seed", str(self.how.seed)),
            *self.how.options,
        ]


@cache
def _set(name: str) -> TrackSet:
    return read_set(name)


def steps(place: Place, ray: str | None = None) -> list[Step]:
    """Return what a budget does, in this order: collisions, trainings before those that begin with them, judgements.

    Args:
        place: manifest, budget and folder.
        ray: address of a Ray cluster for the trainings; None trains here.

    Raises:
        ConfigError: a training cannot be run as the manifest says, or two judgements would share a folder.
    """
    plan = place.plan
    made: list[Step] = []
    if plan.collisions:
        made.append(Collisions(folder=place.out / f"collisions-{plan.collisions.events}", what=plan.collisions))
    for name in _in_order(place):
        place.runs(name)  # a wrong setting is told before hours of driving
        for folder, sweep in place.sweeps(name).items():
            made.append(Train(place=place, training=name, sweep=sweep, folder=folder, ray=ray))
    judges = [Judge(place=place, cell=cell) for cell in cells(place.manifest, place.budget)]
    named: dict[Path, Cell] = {}
    for judge in judges:
        other = named.setdefault(judge.folder, judge.cell)
        if other is not judge.cell:
            alike = " and ".join(f"{cell.agent or cell.training} in {cell.place}" for cell in (other, judge.cell))
            raise ConfigError(
                f"judgements.{other.judgement} names {alike}, which would share {judge.folder}; name each once, and "
                "move files whose paths differ by signs alone"
            )
    return [*made, *judges]


def _in_order(place: Place) -> Iterator[str]:
    """Yield the trainings so that one that begins with another comes after it."""
    trainings = place.manifest.trainings
    names = sorted(place.plan.trainings, key=list(trainings).index)
    yield from (name for name in names if not trainings[name].init)
    yield from (name for name in names if trainings[name].init)
