"""A sweep on this machine: a process for each run, so that one that dies takes no other with it."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Thread

from zebrat_bullet.config_text import from_json, to_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.processes import usable_cores
from zebrat_bullet.training.run_folder import is_finished
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep_run import (
    OUTPUT,
    Outcome,
    cores_of,
    is_claimed,
    perform,
    record_failure,
)

TICK_S = 1.0


def require_workers(workers: int | None) -> None:
    """Raise unless so many runs can be taken at a time.

    Raises:
        ConfigError: fewer than one was asked for.
    """
    if workers is not None and workers < 1:
        raise ConfigError(f"a sweep takes at least 1 worker process, got {workers}")


def run_locally(
    runs: Mapping[Path, TrainConfig],
    workers: int | None,
    retries: int,
    on_tick: Callable[[], None] = lambda: None,
) -> None:
    """Take every run to its end, so many at a time; a run whose process dies goes on from its checkpoint.

    A run that another process holds, one of another sweep in the same folder, is left to it and looked at again later.

    Args:
        runs: the settings of each run by its folder.
        workers: runs at a time; None for as many as there are cores for.
        retries: how often a run whose process dies is taken up again.
        on_tick: called about once a second.

    Raises:
        ConfigError: fewer than one worker was asked for.
    """
    cores = max(map(cores_of, runs.values()))
    require_workers(workers)
    workers = max(usable_cores() // cores, 1) if workers is None else workers
    queue = deque(run for run in runs if not is_finished(run))
    deaths: Counter[Path] = Counter()
    working: dict[Path, subprocess.Popen[str]] = {}
    try:
        while queue or working:
            for run in list(queue):
                if len(working) < workers and not is_claimed(run):
                    queue.remove(run)
                    working[run] = _start(runs[run], run)
            on_tick()
            time.sleep(TICK_S)
            for run, process in list(working.items()):
                if process.poll() is None:
                    continue
                del working[run]
                if process.returncode == Outcome.BUSY:
                    queue.append(run)
                elif process.returncode not in tuple(Outcome):
                    deaths[run] += 1
                    if deaths[run] <= retries:
                        queue.appendleft(run)
                    else:
                        status = f"at last with status {process.returncode}"
                        record_failure(run, f"its process died {deaths[run]} times, {status}; see {OUTPUT}")
    finally:
        for process in working.values():
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _start(config: TrainConfig, run: Path) -> subprocess.Popen[str]:
    """Start a process for a run, in a group of its own: Ctrl-C is for the sweep to answer."""
    run.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", __name__, str(run)]
    with (run / OUTPUT).open("a", encoding="utf-8") as output:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=output, stderr=output, text=True, process_group=0
        )
    assert process.stdin is not None
    process.stdin.write(to_json(config) + "\n")
    process.stdin.flush()
    return process


def _work() -> None:
    """Perform the run that the command line and the standard input name."""
    config = from_json(TrainConfig, sys.stdin.readline())
    Thread(target=_die_with_parent, daemon=True).start()
    sys.exit(perform(config, Path(sys.argv[1])))


def _die_with_parent() -> None:
    """A sweep that is killed leaves nothing behind that trains on unsupervised: its end closes the standard input."""
    sys.stdin.read()
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    _work()
