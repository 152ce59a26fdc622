"""From the outputs of a comparison, whole or in part, to its tables: nothing is driven, nothing is invented."""

import math
import shlex
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zebrat_bullet.comparison.episodes import read_made_by, record_rows, set_rows
from zebrat_bullet.comparison.policies import EPISODES, MODEL, Place, best_rank, best_run, runs_by_policy, who_of
from zebrat_bullet.comparison.records import digest, read_records
from zebrat_bullet.comparison.steps import CASES, MADE_BY, Collisions, Judge, steps
from zebrat_bullet.comparison.tables import COLUMNS, table_of
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.csv_log import read_rows
from zebrat_bullet.files import refusing
from zebrat_bullet.training.run_folder import evaluations, is_finished
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep import Sweep, sweep_command

if TYPE_CHECKING:
    from pyarrow import Table

_BLOCK = 20
"""Episodes of which the paper's training curve shows the best."""
_CASES = {"detected": "in_time", "events": "contacts"}
"""Columns of the table that have other names in cases.csv."""


def gather(place: Place) -> "dict[str, Table]":
    """Return the five tables of what a budget has so far.

    Raises:
        ZebratError: a file among the outputs is damaged; the message names it.
        ConfigError: pyarrow is not installed.
    """
    planned = steps(place)
    runs, learning = list[dict[str, Any]](), list[dict[str, Any]]()
    for name in place.manifest.trainings:
        if name in place.plan.trainings or place.manifest.trainings[name].kept:
            for row, curve in _training_rows(place, name):
                runs.append(row)
                learning += curve
    episodes, paths = list[dict[str, Any]](), list[dict[str, Any]]()
    run_of = runs_by_policy(place)
    for step in planned:
        if isinstance(step, Judge):
            for row, path in _judged_rows(step, run_of):
                episodes.append(row)
                paths += [path] if path else []
    study = next((step.folder for step in planned if isinstance(step, Collisions) and step.is_done()), None)
    tables = {"runs": runs, "learning": learning, "episodes": episodes, "paths": paths}
    tables["collisions"] = list(_collision_rows(study or place.checkout / place.manifest.collisions))
    return {name: table_of(name, rows) for name, rows in tables.items()}


def _training_rows(place: Place, name: str) -> Iterator[tuple[dict[str, Any], list[dict[str, Any]]]]:
    """Yield the row of each run of a training, and the rows of its learning curve."""
    training, configs = place.manifest.trainings[name], place.runs(name)
    sweeps, readable = place.sweeps(name), place.readable_runs(name)
    for run, config in configs.items():
        algo, reward = who_of(run, config)
        row = {
            **{"run": place.run_name(run), "study": training.study, "algorithm": algo, "reward": reward},
            **{"variant": training.variant, "seed": config.seed, "asked": training.asked},
            "command": _command(place, name, _of_one(sweeps[run.parent], algo, reward, config.seed), run.parent),
        }
        row |= reached(readable[run], config)
        if place.is_cut_short(name) and row["state"] == "complete":
            row["state"] = "partial"  # of what `asked` says
        yield row, list(_curve(readable[run], place.run_name(run)))


def _of_one(sweep: Sweep, algo: str, reward: str, seed: int) -> Sweep:
    return replace(sweep, algos=(algo,), rewards=(reward,), seeds=(seed,))


def _command(place: Place, name: str, sweep: Sweep, folder: Path) -> str:
    if init := place.manifest.trainings[name].init:
        try:
            model = place.portable(best_run(place, init, sweep.algos[0], sweep.rewards[0]) / MODEL)
        except ConfigError:  # none is finished
            model = "RUN/best.zip"
        sweep = replace(sweep, set=(*sweep.set, f"init={model}"))
    return shlex.join(["zebrat", *sweep_command(sweep, place.portable(folder))])


def reached(run: Path, config: TrainConfig) -> dict[str, Any]:
    """Return the columns of `runs` that say what is done of a run.

    Raises:
        ZebratError: its tables are damaged.
    """
    rows, judged = read_rows(run / EPISODES), evaluations(run)
    if not rows and not judged:
        return {"state": "missing"}
    with refusing(run, ZebratError, "its tables are not those of a run", "restore them, or move the folder away"):
        last = [table[-1] for table in (rows, judged) if table]
        return {
            "episodes": None if config.planar else len(rows),
            "steps": max(int(row["total_steps"]) for row in last),
            "wall_s": max(float(row["wall_s"]) for row in last),
            **(_best(run) if judged else {}),
            "state": "complete" if is_finished(run) else "partial",
        }


def _best(run: Path) -> dict[str, float | None]:
    success, collision, time_s = best_rank(run)
    return {
        "best_success": success,
        "best_collision": -collision,
        "best_time_s": -time_s if math.isfinite(time_s) else None,
    }


def _curve(run: Path, name: str) -> Iterator[dict[str, Any]]:
    rows = read_rows(run / EPISODES)
    with refusing(run, ZebratError, "its tables are not those of a run", "restore them, or move the folder away"):
        for first in range(0, len(rows), _BLOCK):
            block = rows[first : first + _BLOCK]
            yield {
                **{"run": name, "episode": int(block[-1]["episode"]), "total_steps": int(block[-1]["total_steps"])},
                "best_return": max(float(row["return"]) for row in block),
            }
        for row in evaluations(run):
            where = {"run": name, "episode": int(row["episode"]), "total_steps": int(row["total_steps"])}
            yield where | {"success": float(row["success"])}


def _judged_rows(step: Judge, run_of: dict[str, str]) -> Iterator[tuple[dict[str, Any], dict[str, Any] | None]]:
    cell, records = step.cell, step.place.records if step.is_kept() and not step.is_driven() else None
    made_by = step.made_by() if records else read_made_by(step.folder / MADE_BY)
    if made_by is None:
        return
    agent = made_by["agent"]
    who: dict[str, Any] = {
        **{"agent": agent, "method": cell.method, "setting": cell.setting, "study": cell.study},
        **{"run": run_of.get(agent), "sim": cell.sim, "place": cell.place, "noise": cell.noise},
        "made_by": digest(made_by),
    }
    if records:
        yield from read_records(records).rows(who["made_by"], cell.place, cell.episodes, who)
    elif cell.is_set:
        yield from ((row, None) for row in set_rows(step.folder, who))
    else:
        yield from record_rows(step.folder, cell.place, cell.episodes, who)


def _collision_rows(folder: Path) -> Iterator[dict[str, Any]]:
    kinds: dict[str, Callable[[str], object]] = {
        "string": str,
        "int64": lambda text: int(float(text)),
        "float64": float,
    }
    for row in read_rows(folder / CASES):
        with refusing(folder / CASES, ZebratError, "is not the table of a collision study", "make it anew"):
            texts = {column: row[_CASES.get(column, column)] for column in COLUMNS["collisions"]}
            yield {
                column: kinds[kind](text) if (text := texts[column]) or kind == "string" else None
                for column, kind in COLUMNS["collisions"].items()
            }
