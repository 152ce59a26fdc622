"""One run as several attempts, side by side on the cores there are: the first that is good enough ends it.

What a learner reaches depends on luck, so that several short attempts promise more than one of their length together.
"""

import math
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.training.callbacks import Progress
from zebrat_bullet.training.logs import EPISODE_COLUMNS, EVALUATION_COLUMNS, CsvLog, rank, read_rows
from zebrat_bullet.training.run_folder import ATTEMPTS, ERROR, POLICY_FILES
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep_local import run_locally
from zebrat_bullet.training.sweep_run import cores_of, status

TABLES = {"episodes": EPISODE_COLUMNS, "evaluations": EVALUATION_COLUMNS}


def run_attempts(config: TrainConfig, folder: Path, on_progress: Callable[[Progress], None]) -> None:
    """Take the attempts of a run to its end, from wherever they stand, and make its folder that of one run.

    Each attempt is a run of its own in `attempts/`. The tables of the folder hold the rows of all in the order of time,
    with the episodes and steps of all counted together; its policy is that of the best attempt.

    Args:
        config: the run.
        folder: of the run; holds its config.json.
        on_progress: told once a second how many attempts have ended.

    Raises:
        ZebratError: no attempt got as far as its first evaluation.
    """
    seeds = np.random.SeedSequence(config.seed).generate_state(config.attempts) >> 1
    one = replace(config, attempts=1, max_minutes=None)
    runs = {folder / ATTEMPTS / f"{i:02}": replace(one, seed=int(seed)) for i, seed in enumerate(seeds)}
    workers = max(len(os.sched_getaffinity(0)) // cores_of(one), 1)
    spent_s = sum(float(row["wall_s"]) for run in runs for row in read_rows(run / "episodes.csv")[-1:]) / workers
    ends = time.monotonic() - spent_s + (60.0 * config.max_minutes if config.max_minutes else math.inf)

    def show() -> None:
        now = [status(run) for run in runs]
        running = [at for at in now if at.state == "running"]
        on_progress(
            Progress(
                sum(at.state in ("done", "failed") for at in now),
                config.attempts,
                sum(at.steps_per_s or 0.0 for at in running),
                max((at.success or 0.0 for at in running), default=0.0),
                max(at.best or 0.0 for at in now),
            )
        )

    def is_over() -> bool:
        best = max((at.best for run in runs if (at := status(run)).best is not None), default=-math.inf)
        return time.monotonic() > ends or (config.stop_at is not None and best >= config.stop_at)

    run_locally(runs, workers, retries=1, on_tick=show, is_over=is_over)
    _gather(folder, [run for run in runs if (run / "config.json").is_file()])


def _gather(folder: Path, runs: list[Path]) -> None:
    """Write the tables of all attempts as one, and keep the policy of the best."""
    logs = {name: CsvLog(folder / f"{name}.csv", columns) for name, columns in TABLES.items()}
    for log in logs.values():
        log.cut_after(-1)  # an episode 0 is what a fine-tuning began with
    best: tuple[float, ...] = (-math.inf,)
    winner = None
    for name, run, row in _in_order(folder, runs):
        if name == "evaluations":
            result = rank(row)
            row["best"] = int(result >= best)
            best, winner = (result, run) if result >= best else (best, winner)
        logs[name].append(row)
    if winner is None:
        errors = "".join(f"; {run.name}: {(run / ERROR).read_text()[-500:]}" for run in runs if (run / ERROR).is_file())
        raise ZebratError(f"no attempt in {folder} came to an evaluation{errors or '; raise max_minutes'}")
    for file in POLICY_FILES:
        shutil.copy2(winner / file, folder / file)
    for run in runs:
        shutil.rmtree(run / "checkpoint", ignore_errors=True)


def _in_order(folder: Path, runs: list[Path]) -> list[tuple[str, Path, dict[str, Any]]]:
    """Return (table, attempt, row) of all by time since the run began, with the episodes and steps of all summed."""
    began = (folder / "config.json").stat().st_mtime
    found: list[tuple[float, str, Path, dict[str, Any]]] = []
    for run in runs:
        offset_s = (run / "config.json").stat().st_mtime - began
        for name in TABLES:
            found += [(offset_s + float(row["wall_s"]), name, run, row) for row in read_rows(run / f"{name}.csv")]
    done: dict[Path, tuple[int, int]] = {}
    result = []
    for wall_s, name, run, row in sorted(found, key=lambda at: at[0]):
        done[run] = int(row["episode"]), int(row["total_steps"])
        episodes, steps = map(sum, zip(*done.values(), strict=True))
        result.append((name, run, row | {"episode": episodes, "total_steps": steps, "wall_s": round(wall_s, 2)}))
    return result
