"""Runs the steps of a comparison, each as a process of its own: killed at any point, the same call goes on."""

import ctypes
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from zebrat_bullet.comparison.steps import Step
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.training.sweep_run import claim

LOGS = "logs"
_PR_SET_PDEATHSIG = 1
_TAIL = 300
_libc = ctypes.CDLL(None)


def run_steps(
    steps: Sequence[Step], out: Path, on_step: Callable[[int, Step, str], None] = lambda number, step, what: None
) -> dict[str, str]:
    """Run every step that is not done; one that fails does not hold up the others.

    Args:
        steps: in their order.
        out: the comparison's folder; the output of each step goes to a file in its `logs`.
        on_step: called with the number of a step, the step, and "done before", "begins", "done" or "failed: ...".

    Returns:
        Why they failed, by the names of the steps that did.

    Raises:
        ConfigError: another process runs a comparison in this folder.
    """
    failed: dict[str, str] = {}
    with claim(out) as mine:
        if not mine:
            raise ConfigError(f"another process runs a comparison in {out}; wait for it, or name another folder")
        for number, step in enumerate(steps, 1):
            if step.is_done():
                on_step(number, step, "done before")
                continue
            on_step(number, step, "begins")
            if why := _run(step, out / LOGS):
                failed[step.name] = why
            on_step(number, step, f"failed: {why}" if why else "done")
    return failed


def _run(step: Step, logs: Path) -> str:
    """Run a step; return why it failed, "" if it did not."""
    try:
        command = step.command()
    except ZebratError as error:
        return str(error)
    logs.mkdir(parents=True, exist_ok=True)
    log = logs / (re.sub(r"[^\w.=-]+", "-", step.name) + ".txt")
    status = call(command, log)
    if status == 0 and step.is_done():
        return ""
    said = log.read_text(errors="replace").strip().splitlines() or ["it said nothing"]
    return f"status {status}: {said[-1][-_TAIL:]} (all of it: {log})"


def call(command: Sequence[str], log: Path) -> int:
    """Call `zebrat` with these arguments and return its status; it ends with this process, however that ends.

    Args:
        command: what follows `zebrat`.
        log: where standard output and error go.
    """
    code = "import sys; from zebrat_bullet.cli import main; sys.exit(main())"
    with log.open("w") as file:
        file.write(f"zebrat {' '.join(command)}\n")
        file.flush()
        process = subprocess.Popen(
            [sys.executable, "-c", code, *command],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            process_group=0,  # Ctrl-C is for this process to answer
            preexec_fn=_die_with_parent,
        )
        try:
            return process.wait()
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise


def _die_with_parent() -> None:
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
