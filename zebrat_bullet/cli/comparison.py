"""The command that writes the report on the comparison."""

import argparse
from pathlib import Path

from zebrat_bullet.cli.common import AddCommand, Result

_RECORDS = Path("docs") / "results" / "comparison"


def report(arguments: argparse.Namespace) -> Result:
    """Write the report on the comparison from its tables of records: one HTML file, or Markdown with its pictures."""
    from zebrat_bullet.comparison.manifest import SHIPPED, read_manifest
    from zebrat_bullet.report.comparison import build_report

    out = arguments.out or Path("results") / "report.html"
    written = build_report(arguments.records, out, read_manifest(arguments.manifest or SHIPPED))
    size_mb = sum(path.stat().st_size for path in written) / 1e6
    pictures = f" and {len(written) - 1} pictures" if len(written) > 1 else ""
    return {
        "report": str(out),
        "files": len(written),
        "size_mb": round(size_mb, 3),
    }, f"{out}{pictures}: {size_mb:.1f} MB"


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(report)
    made.add_argument(
        "--records",
        type=Path,
        default=_RECORDS,
        metavar="FOLDER",
        help="the five tables, and notes.md with what was learned, if there is one (default docs/results/comparison)",
    )
    made.add_argument(
        "--manifest",
        type=Path,
        metavar="YAML",
        help="what was to be driven: what of it is not, is marked (default: all)",
    )
