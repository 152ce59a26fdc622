"""The command that trains many policies: algorithms x rewards x worlds x seeds, here or on a Ray cluster."""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zebrat_bullet.cli.common import AddCommand, PartialResultError, Result, note
from zebrat_bullet.config import REWARD_PRESETS
from zebrat_bullet.errors import ConfigError

if TYPE_CHECKING:
    from rich.table import Table

COLOURS: dict[str, str] = {"failed": "red", "running": "bold", "waiting": "dim", "done": "green"}
"""Of every state of a run, those first that a person wants to see first."""


def sweep(arguments: argparse.Namespace) -> Result:
    """Train every combination of algorithms, rewards, worlds and seeds; what is finished is kept, the rest goes on."""
    from zebrat_bullet.training.sweep import open_sweep
    from zebrat_bullet.training.sweep_local import require_workers, run_locally
    from zebrat_bullet.training.sweep_ray import connected, run_on_ray

    if arguments.retries < 0:
        raise ConfigError(f"retries must be at least 0, got {arguments.retries}")
    require_workers(arguments.workers)
    folder = (arguments.out or Path("runs/sweep")).resolve()
    asked = _sweep_of(arguments, folder)
    try:
        with connected(arguments.ray) if arguments.ray else nullcontext():
            runs = open_sweep(asked, folder)
            with _live_table(arguments, runs) as show:
                if arguments.ray:
                    run_on_ray(runs, arguments.retries, show)
                else:
                    run_locally(runs, arguments.workers, arguments.retries, show)
    except KeyboardInterrupt:
        note(arguments, f"nothing finished is lost; `zebrat sweep --out {folder}` continues from the checkpoints")
        raise
    result = {run.name: _summary(run) for run in runs}
    text = "\n".join(_line(name, summary) for name, summary in result.items()) + f"\ncurves and policies: {folder}"
    if failed := [name for name, summary in result.items() if "error" in summary]:
        what = f"{len(failed)} of {len(runs)} runs failed: {', '.join(failed)}"
        raise PartialResultError(
            f"{what}; error.txt in the folder of each says why, the same command tries again", (result, text)
        )
    return result, text


def _sweep_of(arguments: argparse.Namespace, folder: Path) -> Any:
    """Return the sweep that the options name, upon that of the manifest or the one which the folder holds already."""
    from zebrat_bullet.training.sweep import AXES, MANIFEST, read_manifest, sweep_of

    saved = folder / MANIFEST
    manifest = arguments.manifest or (saved if saved.is_file() else None)
    settings = read_manifest(manifest) if manifest else {}
    given = {name: getattr(arguments, name) for name in (*AXES, "preset", "robot", "set")}
    if arguments.seed is not None:
        if arguments.seeds is not None:
            raise ConfigError(f"--seed {arguments.seed} and --seeds name the same; leave one out")
        given["seeds"] = [arguments.seed]
    return sweep_of(settings | {name: value for name, value in given.items() if value is not None})


@contextmanager
def _live_table(arguments: argparse.Namespace, runs: Mapping[Path, Any]) -> Iterator[Callable[[], None]]:
    if arguments.quiet:
        yield lambda: None
        return
    from rich.console import Console
    from rich.live import Live

    with Live(_table(runs), console=Console(stderr=True), auto_refresh=False) as live:
        yield lambda: live.update(_table(runs), refresh=True)


def _table(runs: Mapping[Path, Any]) -> "Table":
    from rich.table import Table

    from zebrat_bullet.training.sweep_run import status

    at = {run: status(run) for run in runs}
    counts = Counter[str](now.state for now in at.values())
    table = Table(caption=", ".join(f"{counts[state]} {state}" for state in COLOURS if counts[state]))
    for heading in ("run", "state", "episode", "steps/s", "success", "best"):
        table.add_column(heading, justify="left" if heading in ("run", "state") else "right", no_wrap=True)
    for run, now in sorted(at.items(), key=lambda item: list(COLOURS).index(item[1].state)):
        table.add_row(
            run.name,
            now.state,
            str(now.episode) if runs[run].planar else f"{now.episode}/{runs[run].episodes}",
            "-" if now.steps_per_s is None else f"{now.steps_per_s:.0f}",
            "-" if now.success is None else f"{now.success:.0%}",
            "-" if now.best is None else f"{now.best:.0%}",
            style=COLOURS[now.state],
        )
    return table


def _summary(run: Path) -> dict[str, Any]:
    from zebrat_bullet.training.run_folder import ERROR, read_summary

    return read_summary(run) or {
        "folder": str(run),
        "error": (run / ERROR).read_text(encoding="utf-8").splitlines()[-1],
    }


def _line(name: str, summary: Mapping[str, Any]) -> str:
    if "error" in summary:
        return f"{name}: failed: {summary['error']}"
    best = summary["best"]
    return f"{name}: {best['success']:.0%} after episode {best['episode']:.0f} of {summary['episodes']}"


def add(command: AddCommand) -> None:
    """Add the commands of this file."""
    made = command(sweep)
    made.set_defaults(robot=None, seed=None)  # then those of the manifest
    made.add_argument("--manifest", type=Path, metavar="YAML", help="a file with any of the settings below")
    made.add_argument("--algos", nargs="+", metavar="ALGO", help="ddpg dqn sac ppo ppo-discrete (default ddpg)")
    made.add_argument(
        "--rewards",
        nargs="+",
        metavar="REWARD",
        help=f"{' '.join(REWARD_PRESETS)}, or own: the preset's (default fomt)",
    )
    made.add_argument("--worlds", nargs="+", metavar="WORLD", help="one training world a run (default: the preset's)")
    made.add_argument("--seeds", nargs="+", type=int, metavar="SEED", help="(default 0)")
    made.add_argument("--preset", help="settings to begin with (default: the paper's)")
    made.add_argument(
        "--set",
        nargs="+",
        action="extend",
        metavar="KEY=VALUE",
        help="override settings of all runs, e.g. episodes=500",
    )
    made.add_argument("--workers", type=int, help="runs at a time here (default: as many as there are cores for)")
    made.add_argument("--retries", type=int, default=2, help="how often to resume a run whose process dies (default 2)")
    made.add_argument(
        "--ray", metavar="ADDRESS", help="run on this Ray cluster; --out must be on storage its nodes share"
    )
