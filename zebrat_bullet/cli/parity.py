"""The command that holds the planar car against PyBullet."""

import argparse
from pathlib import Path

from zebrat_bullet.assets import list_assets
from zebrat_bullet.cli.common import AddCommand, Result, progress_bar
from zebrat_bullet.cli.options import workers_option
from zebrat_bullet.config import TaskConfig


def parity(arguments: argparse.Namespace) -> Result:
    """Compare planar cars with PyBullet: motion, senses, contact, and how a policy's episodes end."""
    from zebrat_bullet.evaluation.parity.study import ParityStudy, measure
    from zebrat_bullet.report.parity import write_report

    study = ParityStudy(
        worlds=tuple(arguments.worlds or list_assets("worlds", ".yaml")),
        agent=arguments.agent,
        drives=arguments.drives,
        poses=arguments.poses,
        episodes=arguments.episodes,
        seed=arguments.seed,
        workers=arguments.workers,
        task=TaskConfig(robot=arguments.robot),
    )
    out = arguments.out or Path("results") / "parity"
    with progress_bar(arguments) as bar:
        shown = bar.add_task("comparing", total=None)

        def on_progress(doing: str, done: int, total: int) -> None:
            bar.update(shown, description=doing, completed=done, total=total)

        measured = measure(study, on_progress)
    text = write_report(measured, out)
    return measured.as_dict(), f"{text}\n\ntables, every episode and the figure: {out}"


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(parity, workers_option())
    made.add_argument("--worlds", nargs="+", metavar="WORLD", help="(default: all that are shipped)")
    made.add_argument("--agent", default="shipped", help="an unguided policy (default shipped)")
    made.add_argument(
        "--episodes", type=int, default=70, help="of the policy in each world, those of `zebrat evaluate` (default 70)"
    )
    made.add_argument("--drives", type=int, default=40, help="of 5 s, by each driver in each world (default 40)")
    made.add_argument("--poses", type=int, default=200, help="near the walls of each world (default 200)")
