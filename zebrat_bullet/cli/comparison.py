"""The commands of the paper's comparison: run it, report on it."""

import argparse
import io
import warnings
from contextlib import redirect_stderr
from pathlib import Path
from typing import TYPE_CHECKING

from zebrat_bullet.cli.common import AddCommand, PartialResultError, Result, name_robot, note, require_default
from zebrat_bullet.cli.driving import require_evaluable
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.notes import Note

if TYPE_CHECKING:
    from zebrat_bullet.comparison.steps import Judge, Step

_SHOWN = 5
_RECORDS = Path("docs") / "results" / "comparison"


def reproduce(arguments: argparse.Namespace) -> Result:
    """Run the paper's comparison at a budget, or go on with it, up to its report. A kill loses a cell a core."""
    from zebrat_bullet.comparison.estimate import forecast
    from zebrat_bullet.comparison.gather import gather
    from zebrat_bullet.comparison.manifest import SHIPPED, read_manifest
    from zebrat_bullet.comparison.measure import measure
    from zebrat_bullet.comparison.policies import OUT, Place
    from zebrat_bullet.comparison.run import run_steps
    from zebrat_bullet.comparison.steps import steps
    from zebrat_bullet.comparison.tables import read_tables, table_of, write_tables
    from zebrat_bullet.report.comparison import build_report

    table_of("runs", ())  # a library that is missing is told before hours of driving
    manifest = read_manifest(arguments.manifest or SHIPPED)
    out = (arguments.out or OUT).resolve()
    place = Place(manifest=manifest, budget=arguments.budget, out=out, checkout=Path.cwd())
    planned = _chosen(steps(place, arguments.ray), arguments.only)
    if not arguments.gather:
        to_do = [step for step in planned if not step.is_done()]
        _require_drivable(to_do)
        note(arguments, f"measuring what {len(to_do)} steps are made of" if to_do else "all steps are done")
        said = forecast(place, planned, to_do, measure(place, to_do))
        if arguments.plan:
            names: dict[str, object] = {"steps": [at.name for at in planned], "to_do": [at.name for at in to_do]}
            return names | {"forecast": said}, said
        note(arguments, said)

    def on_step(number: int, step: "Step", what: str) -> None:
        if what != "done before":
            note(arguments, f"[{number}/{len(planned)}] {step.name}: {what}")

    failed = {} if arguments.gather else run_steps(planned, out, on_step)
    tables = out / "tables" / arguments.budget
    write_tables(gather(place), tables)
    rows = {name: len(table) for name, table in read_tables(tables).items()}
    (page,) = build_report(tables, tables / "report.html", manifest)
    result: dict[str, object] = {"folder": str(out), "tables": str(tables), "rows": rows, "report": str(page)}
    result["failed"] = failed
    text = f"{', '.join(f'{n} {name}' for name, n in rows.items())}: {tables}; the report: {page}"
    if failed:
        whole = "\n".join(f"{name}: {why}" for name, why in failed.items())
        raise PartialResultError(
            f"{len(failed)} of {len(planned)} steps failed; the same command tries them again\n{whole}", (result, text)
        )
    return result, text


def _chosen(planned: "list[Step]", only: list[str] | None) -> "list[Step]":
    """Return the steps whose names hold one of these texts; one that is the whole name of a step means that step."""
    if only is None:
        return planned
    names = {step.name for step in planned}
    chosen = [step for step in planned if any(step.name == t or (t not in names and t in step.name) for t in only)]
    if not chosen:
        some = ", ".join(step.name for step in planned[:_SHOWN])
        raise ConfigError(f"no step is called {', '.join(only)}; there are {some}, ... (--plan lists all with --json)")
    return chosen


def _require_drivable(to_do: "list[Step]") -> None:
    """Refuse judgements that `zebrat evaluate` would refuse, before hours of work.

    Each agent and each place of a judgement is tried once; of policies that are yet to be learned the place alone.

    Raises:
        ConfigError: there is no such agent, place or option; the message names the judgement.
    """
    from zebrat_bullet.comparison.steps import Judge

    tried = set[tuple[str, str]]()
    for step in to_do:
        if not isinstance(step, Judge):
            continue
        name, place = step.cell.judgement, step.cell.place
        try:
            agent = step.agent()
        except ConfigError:
            agent = ""
        if tried >= {(name, agent), (name, place)}:
            continue
        tried |= {(name, agent), (name, place)}
        try:
            _try_judgement(step, agent)
        except ZebratError as error:
            raise ConfigError(f"judgements.{name} of the manifest cannot be driven: {error}") from error


def _try_judgement(step: "Judge", agent: str) -> None:
    from zebrat_bullet.cli.main import parse  # which knows this command too
    from zebrat_bullet.world import sketch_world

    said = io.StringIO()
    try:
        with redirect_stderr(said):
            arguments = parse([*step.evaluation(agent or "random"), "--quiet"])
    except SystemExit:
        raise ConfigError(said.getvalue().strip().rpartition("error: ")[2]) from None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Note)  # they are said when it is driven
        name_robot(arguments)
        if not agent:
            arguments.agent = []
            if not step.cell.is_set:
                sketch_world(step.cell.place)
        require_evaluable(arguments)


def report(arguments: argparse.Namespace) -> Result:
    """Write the report on the comparison from its tables of records: one HTML file, or Markdown with its pictures."""
    from zebrat_bullet.comparison.manifest import SHIPPED, read_manifest
    from zebrat_bullet.report.comparison import build_report

    require_default(arguments, "records")
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
    """Add the commands of this file."""
    made = command(reproduce, car=False)
    made.add_argument("--budget", default="smoke", metavar="NAME", help="smoke, laptop or paper (default smoke)")
    made.add_argument("--manifest", type=Path, metavar="YAML", help="another manifest than the shipped one")
    made.add_argument("--plan", action="store_true", help="say what would be run, how long and what will be missing")
    made.add_argument(
        "--only",
        nargs="+",
        metavar="TEXT",
        help="only steps whose name is or holds one of these, e.g. 'train scale' planners",
    )
    made.add_argument("--gather", action="store_true", help="run nothing: only make the tables of what there is")
    made.add_argument(
        "--ray", metavar="ADDRESS", help="train on this Ray cluster; --out must be on storage its nodes share"
    )

    made = command(report, car=False)
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
