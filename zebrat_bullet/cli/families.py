"""The command that judges policies on every family of generated tracks."""

import argparse
import json
from pathlib import Path

from zebrat_bullet.cli.common import AddCommand, Result, progress_bar, take_own_robot, task_of
from zebrat_bullet.cli.options import agents_option, randomise_option, reward_options, task_options, workers_option
from zebrat_bullet.processes import usable_cores


def families(arguments: argparse.Namespace) -> Result:
    """Judge policies on held-out tracks of every family, on planar cars: table and heat map."""
    from zebrat_bullet.evaluation.families import judge_families
    from zebrat_bullet.report.families import draw_families, families_table
    from zebrat_bullet.world import FAMILIES

    take_own_robot(arguments)
    out = arguments.out or Path("results") / "families"
    with progress_bar(arguments) as bar:
        shown = bar.add_task("judging", total=len(arguments.families or FAMILIES))
        scores = judge_families(
            arguments.agent,
            task_of(arguments),
            families=arguments.families or FAMILIES,
            tracks=arguments.tracks,
            starts=arguments.episodes,
            seed=arguments.seed,
            workers=arguments.workers or usable_cores(),
            on_family=lambda family, done: bar.update(shown, description=family, completed=done),
        )
    result = {agent: {family: at.as_dict() for family, at in of.items()} for agent, of in scores.items()}
    table = families_table(scores)
    out.mkdir(parents=True, exist_ok=True)
    draw_families(scores, out / "families.png")
    (out / "families.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    (out / "families.md").write_text(table + "\n", encoding="utf-8")
    return result, f"{table}\n\nsuccess in % of all episodes / on the worst tenth of the tracks, mean reversals: {out}"


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    agents = agents_option(planar_only=True)
    made = command(families, *(agents, task_options(), randomise_option(), reward_options()), workers_option())
    made.set_defaults(sim="planar", robot=None)
    made.add_argument("--families", nargs="+", metavar="FAMILY", help="(default: all)")
    made.add_argument("--tracks", type=int, default=100, help="of each family (default 100)")
    made.add_argument("--episodes", type=int, default=4, help="in each track (default 4)")
