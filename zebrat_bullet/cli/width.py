"""The command that measures success over the width of a passage."""

import argparse
import json
from pathlib import Path

from zebrat_bullet.cli.common import AddCommand, Result, progress_bar, take_own_robot, task_of
from zebrat_bullet.cli.options import (
    agents_option,
    noisy_options,
    randomise_option,
    reward_options,
    sim_option,
    task_options,
    workers_option,
)


def width(arguments: argparse.Namespace) -> Result:
    """Measure success over the width of straights and corners: table, figure, least widths mastered and certified."""
    from zebrat_bullet.evaluation.certified_width import CertifiedRow, certify_widths
    from zebrat_bullet.evaluation.width import WidthStudy, run_study, width_range
    from zebrat_bullet.report.width import draw_width, summarise, width_table

    take_own_robot(arguments)
    task, out = task_of(arguments), arguments.out or Path("results") / "width"
    study = WidthStudy(
        agents=tuple(arguments.agent),
        shapes=tuple(arguments.shapes),
        widths_m=width_range(arguments.least_m, arguments.most_m, arguments.step_m),
        episodes=arguments.episodes,
        sim=arguments.sim,
        seed=arguments.seed,
        action_noise=arguments.action_noise,
        workers=arguments.workers,
        task=task,
    )
    with progress_bar(arguments) as bar:
        shown = bar.add_task("driving", total=None)
        rows = run_study(
            study, out, lambda doing, done, total: bar.update(shown, description=doing, completed=done, total=total)
        )

        def on_certified(row: CertifiedRow) -> None:
            bar.update(shown, description=f"certifying {row.shape}, {row.width_m:.3f} m", completed=0, total=None)

        certified = certify_widths(study.shapes, study.widths_m, task, out, arguments.workers, on_certified)
    summary = summarise(rows, certified, task)
    table = width_table(summary)
    draw_width(summary, out / "width.png")
    (out / "width.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")
    (out / "width.md").write_text(table + "\n", encoding="utf-8")
    return summary, f"{table}\n\nfigure, table and every passage driven: {out}"


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(
        width,
        *(agents_option(), task_options(), noisy_options(), randomise_option(), reward_options()),
        *(sim_option(), workers_option()),
    )
    made.set_defaults(sim="planar", robot=None)
    made.add_argument("--shapes", nargs="+", default=["straight", "45", "90", "180"], help="(default: all)")
    made.add_argument("--least-m", type=float, default=0.8, help="narrowest passage (default 0.8)")
    made.add_argument("--most-m", type=float, default=1.6, help="widest passage (default 1.6)")
    made.add_argument("--step-m", type=float, default=0.025, help="from width to width (default 0.025)")
    made.add_argument("--episodes", type=int, default=32, help="in each passage and sense (default 32)")
