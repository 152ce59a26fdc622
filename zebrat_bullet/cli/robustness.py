"""The command that measures how much of car and senses may differ from what a driver knows."""

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

from zebrat_bullet.cli.common import (
    AddCommand,
    Result,
    agents_option,
    engine_option,
    of_engine,
    progress_bar,
    reward_options,
    supervised_option,
    task_of,
    task_options,
    workers_option,
)
from zebrat_bullet.errors import ConfigError

_GRID = ("track_2", "track_4", "track_5", "real_1", "real_3")
_DEMONSTRATION = ("real_1", "real_2", "real_3")


def robustness(arguments: argparse.Namespace) -> Result:
    """Measure success over noise, lag, latency, friction, mass and more: table and figure; goes on after a kill."""
    from zebrat_bullet.evaluation.axes import everything_but, parse_axes
    from zebrat_bullet.evaluation.robustness import RobustnessStudy, run_study
    from zebrat_bullet.report.robustness import draw_robustness, everything_table, robustness_table, summarise

    together = arguments.everything is not None
    if together and arguments.axes is not None:
        raise ConfigError("--axes and --everything both say what is disturbed; give one (--axes takes everything too)")
    if arguments.but and not together:
        raise ConfigError("--but leaves something out of --everything; give that too")
    axes = (
        {everything_but(arguments.but): tuple(arguments.everything or (0.2,))}
        if together
        else parse_axes(_axes(arguments))
    )
    task = task_of(arguments)
    error = {"pose_sigma_m": arguments.pose_sigma_m, "pose_sigma_rad": math.radians(arguments.pose_sigma_deg)}
    study = RobustnessStudy(
        agents=tuple(arguments.agent),
        axes=axes,
        worlds=tuple(arguments.worlds or (_DEMONSTRATION if together else _GRID)),
        episodes=arguments.episodes if arguments.episodes is not None else 70 if together else 10,
        supervised_m=arguments.supervised,
        seed=arguments.seed,
        workers=arguments.workers,
        task=replace(task, disturbance=replace(task.disturbance, **error)),
        settings=tuple(_settings(arguments)),
    )
    name = "robustness-everything" if together else "robustness"
    out = arguments.out or Path("results") / f"{name}{of_engine(arguments)}"
    with progress_bar(arguments) as bar:
        shown = bar.add_task("driving", total=None)
        rows = run_study(
            study, out, lambda doing, done, total: bar.update(shown, description=doing, completed=done, total=total)
        )
    summary = summarise(rows)
    table = everything_table(summary) if together else robustness_table(summary)
    draw_robustness(summary, out / "robustness.png")
    (out / "robustness.json").write_text(json.dumps(summary, indent=1))
    (out / "robustness.md").write_text(table + "\n")
    return summary, f"{table}\n\nfigure, table and every row driven: {out}"


def _axes(arguments: argparse.Namespace) -> tuple[str, ...]:
    from zebrat_bullet.evaluation.axes import AXIS_NAMES

    return tuple(AXIS_NAMES if arguments.axes is None else arguments.axes)


def _settings(arguments: argparse.Namespace) -> list[str]:
    if wrong := [text for text in arguments.set if not text.startswith("task.") or "=" not in text]:
        raise ConfigError(f"--set takes settings as task.KEY=VALUE, got {', '.join(wrong[:3])}")
    return [text.removeprefix("task.") for text in arguments.set]


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(
        robustness,
        *(agents_option(), task_options(), reward_options(), workers_option(), supervised_option(), engine_option()),
    )
    made.add_argument(
        "--axes",
        nargs="+",
        metavar="AXIS[=LEVEL,LEVEL]",
        help="what to disturb (default: all): range_noise dropout dark_walls mount_offset mount_yaw steering_lag "
        "steering_offset speed latency command_noise friction mass acceleration steering_rate everything",
    )
    made.add_argument(
        "--everything",
        nargs="*",
        type=float,
        metavar="SCALE",
        help="instead: all of it drawn at random for each episode, within so much of nominal (default 0.2), in real_1 "
        "to real_3, 70 episodes in each",
    )
    made.add_argument("--but", nargs="+", default=[], metavar="AXIS", help="leave these out of --everything")
    made.add_argument("--worlds", nargs="+", metavar="WORLD", help=f"(default: {' '.join(_GRID)})")
    made.add_argument("--episodes", type=int, help="in each world at each level (default 10)")
    made.add_argument(
        "--pose-sigma-m", type=float, default=0.05, help="drifting error of the pose that planners get (default 0.05 m)"
    )
    made.add_argument("--pose-sigma-deg", type=float, default=3.0, help="and of its yaw (default 3 degrees)")
    made.add_argument("--set", nargs="+", action="extend", default=[], metavar="task.KEY=VALUE", help="as for evaluate")
