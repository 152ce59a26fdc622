"""The command that makes figures and tables of training runs."""

import argparse
from pathlib import Path

from zebrat_bullet.cli.common import AddCommand, Result


def curves(arguments: argparse.Namespace) -> Result:
    """Draw and tabulate training runs, grouped by algorithm, reward and settings, from their folders alone."""
    from zebrat_bullet.report.learning import write_report

    out = arguments.out or Path("results/curves")
    groups, text = write_report(arguments.folders, out)
    return {"folder": str(out), "groups": groups}, f"{text}\n\nfigures, the data behind them and this table: {out}"


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(curves, car=False)
    made.add_argument(
        "folders",
        nargs="+",
        type=Path,
        metavar="FOLDER",
        help="run folders, or folders or zip archives that hold some, such as runs",
    )
