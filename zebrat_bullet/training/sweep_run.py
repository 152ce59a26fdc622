"""One run of a sweep: claimed by one process at a time, begun or resumed, never run twice; read by any other."""

import fcntl
import os
import shutil
import socket
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Literal

from threadpoolctl import threadpool_limits

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.csv_log import read_rows
from zebrat_bullet.files import refusing
from zebrat_bullet.training.run_folder import ERROR, has_checkpoint, is_finished
from zebrat_bullet.training.settings import TrainConfig

LOCK, OUTPUT = "lock", "output.txt"
CLAIM_S = 1.0
RECENT = 20
TAIL = 16_384
"""Bytes at the end of a table that a status is read from: it is asked every second, of every run."""


class Outcome(IntEnum):
    """How a worker's turn at a run ended; also its exit status."""

    DONE = 0
    FAILED = 3
    BUSY = 4


@dataclass(frozen=True, slots=True)
class RunStatus:
    """Where a run stands, as its folder says.

    Attributes:
        state: "running" (a process, anywhere, holds it), "waiting", "done" or "failed".
        episode: finished episodes.
        steps_per_s: environment steps a second over the last 20 episodes; None before.
        success: share of them that succeeded; None before.
        best: success of the best noise-free evaluation; None before.
    """

    state: Literal["running", "waiting", "done", "failed"]
    episode: int = 0
    steps_per_s: float | None = None
    success: float | None = None
    best: float | None = None


def cores_of(config: TrainConfig) -> int:
    """Return how many cores a run keeps busy."""
    return config.threads + (config.n_envs if config.overlap else 0)


def perform(config: TrainConfig, folder: Path) -> Outcome:
    """Take a run to its end: resume it from its checkpoint, or begin it anew.

    Returns:
        DONE if it is finished, now or before; FAILED if it raised (its traceback is in error.txt); BUSY if another
        process holds it, which then alone writes to the folder.
    """
    from zebrat_bullet.training.run import resume, train  # torch: seconds that who only watches a sweep need not wait

    with claim(folder) as mine:
        if not mine:
            return Outcome.BUSY
        if is_finished(folder):
            return Outcome.DONE
        try:
            with threadpool_limits(1):
                if has_checkpoint(folder):
                    (folder / ERROR).unlink(missing_ok=True)
                    resume(folder)
                else:
                    _empty(folder)
                    train(config, folder)
        except Exception:
            record_failure(folder, traceback.format_exc())
            return Outcome.FAILED
    return Outcome.DONE


def record_failure(folder: Path, why: str) -> None:
    """Say in its folder why a run was given up."""
    (folder / ERROR).write_text(why, encoding="utf-8")


@contextmanager
def claim(folder: Path) -> Iterator[bool]:
    """Try to become the only process that writes to a run folder; yield whether this one is.

    The claim is a lock of the kernel, not a file that exists: it ends with the process that holds it, however that
    ends, and never before, so that neither a stale file blocks a run nor a slow process loses it. On a network file
    system the server keeps it, and drops it when a dead machine's lease runs out.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("a+") as file:
        patience = time.monotonic() + CLAIM_S  # another's glance at the lock takes it for a moment
        while not (mine := lock(file.fileno(), fcntl.LOCK_EX)) and time.monotonic() < patience:
            time.sleep(0.05)
        if mine:
            file.truncate(0)
            file.write(f"{socket.gethostname()} {os.getpid()}\n")
            file.flush()
        yield mine


def lock(file: int, kind: int) -> bool:
    """Take a lock on an open file if that is possible at once; return whether it was.

    The file must be open for reading and writing: over NFS, a shared lock takes the one, an exclusive lock the other.

    Raises:
        ZebratError: the storage has no locks.
    """
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        raise ZebratError(f"this storage has no file locks (flock): {error}; name a folder on one that has") from error
    return True


def status(folder: Path) -> RunStatus:
    """Return where the run in a folder stands."""
    with refusing(folder, ZebratError, "its tables are not those of a run", "move the folder away"):
        return _status(folder)


def _status(folder: Path) -> RunStatus:
    best = max((float(row["success"]) for row in read_rows(folder / "evaluations.csv", TAIL)), default=None)
    recent = read_rows(folder / "episodes.csv", TAIL)[-RECENT:]
    if not recent:
        return RunStatus(_state(folder), best=best)
    steps, seconds = (float(recent[-1][name]) - float(recent[0][name]) for name in ("total_steps", "wall_s"))
    return RunStatus(
        _state(folder),
        int(recent[-1]["episode"]),
        steps / seconds if seconds > 0 else None,
        sum(row["outcome"] == "success" for row in recent) / len(recent),
        best,
    )


def _state(folder: Path) -> Literal["running", "waiting", "done", "failed"]:
    if is_finished(folder):
        return "done"
    if is_claimed(folder):
        return "running"
    return "failed" if (folder / ERROR).exists() else "waiting"


def is_claimed(folder: Path) -> bool:
    """Return whether a process holds the run in a folder."""
    try:
        with (folder / LOCK).open("a+") as file:
            return not lock(file.fileno(), fcntl.LOCK_SH)
    except FileNotFoundError:
        return False


def _empty(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path.name not in (LOCK, OUTPUT):
            path.unlink()
