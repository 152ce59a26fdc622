"""Runs the steps of a comparison, each a process, one a core at a time: killed at any point, the same call goes on."""

import ctypes
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from zebrat_bullet.comparison.steps import Step
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.processes import usable_cores
from zebrat_bullet.training.sweep_run import claim

LOGS = "logs"
_PR_SET_PDEATHSIG = 1
_TAIL = 300
_POLL_S = 0.05
_libc = ctypes.CDLL(None)


def run_steps(
    steps: Sequence[Step], out: Path, on_step: Callable[[int, Step, str], None] = lambda number, step, what: None
) -> dict[str, str]:
    """Run every step that is not done, as many at once as there are cores; one that fails does not hold up the others.

    Args:
        steps: in their order.
        out: the comparison's folder; the output of each step goes to a file in its `logs`.
        on_step: called with the number of a step, the step, and "done before", "begins", "done" or "failed: ...".

    Returns:
        Why they failed, by the names of the steps that did.

    Raises:
        ConfigError: another process runs a comparison in this folder.
    """
    cores = usable_cores()
    failed: dict[str, str] = {}
    running: list[_Running] = []

    def ended(number: int, step: Step, why: str) -> None:
        if why:
            failed[step.name] = why
        on_step(number, step, f"failed: {why}" if why else "done")

    def wait() -> None:
        while not (over := [one for one in running if one.process.poll() is not None]):
            time.sleep(_POLL_S)
        for one in over:
            running.remove(one)
            ended(one.number, one.step, _why(one))

    with claim(out) as mine:
        if not mine:
            raise ConfigError(f"another process runs a comparison in {out}; wait for it, or name another folder")
        try:
            for number, step in enumerate(steps, 1):
                while len(running) >= (1 if step.alone else cores) or any(one.step.alone for one in running):
                    wait()
                if step.is_done():
                    on_step(number, step, "done before")
                    continue
                on_step(number, step, "begins")
                try:
                    command = step.command()
                except ZebratError as error:  # what it needs is not there
                    ended(number, step, str(error))
                    continue
                log = out / LOGS / (re.sub(r"[^\w.=-]+", "-", step.name) + ".txt")
                running.append(_Running(number, step, log, _start(command, log)))
            while running:
                wait()
        finally:
            for one in running:
                _kill(one.process)
    return failed


@dataclass(frozen=True, slots=True)
class _Running:
    number: int
    step: Step
    log: Path
    process: subprocess.Popen[bytes]


def _why(one: _Running) -> str:
    """Return why a step that has ended failed, "" if it did not."""
    status = one.process.returncode
    if status == 0 and one.step.is_done():
        return ""
    said = one.log.read_text(errors="replace", encoding="utf-8").strip().splitlines() or ["it said nothing"]
    return f"status {status}: {said[-1][-_TAIL:]} (all of it: {one.log})"


def call(command: Sequence[str], log: Path) -> int:
    """Call `zebrat` with these arguments and return its status; it ends with this process, however that ends.

    Args:
        command: what follows `zebrat`.
        log: where standard output and error go.
    """
    process = _start(command, log)
    try:
        return process.wait()
    finally:
        _kill(process)


def _start(command: Sequence[str], log: Path) -> subprocess.Popen[bytes]:
    code = "import sys; from zebrat_bullet.cli import main; sys.exit(main())"
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("w", encoding="utf-8") as file:
        file.write(f"zebrat {' '.join(command)}\n")
        file.flush()
        return subprocess.Popen(
            [sys.executable, "-c", code, *command],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            process_group=0,  # Ctrl-C is for this process to answer
            preexec_fn=_die_with_parent,
        )


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a process, if it has not ended, and those that it has started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _die_with_parent() -> None:
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
