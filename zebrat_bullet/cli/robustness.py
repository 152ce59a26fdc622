"""The command that measures how much of car and senses may differ from what a driver knows."""

import argparse
import json
import math
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from zebrat_bullet.cli.common import (
    AddCommand,
    Result,
    engine_task_of,
    of_engine,
    progress_bar,
    require_own_caster,
    take_own_robot,
)
from zebrat_bullet.cli.options import (
    agents_option,
    engine_option,
    reward_options,
    supervised_option,
    task_options,
    whole_number,
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
    _require_disturbed(axes)
    take_own_robot(arguments)
    task = engine_task_of(arguments)
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
    for agent in study.agents:
        require_own_caster(arguments, study.own_task(agent))
    bar = progress_bar(arguments)
    with ExitStack() as driving:

        def on_row(doing: str, done: int, total: int) -> None:
            if not bar.tasks:  # not before: what is refused is refused without a bar
                driving.enter_context(bar)
                bar.add_task(doing)
            bar.update(bar.task_ids[0], description=doing, completed=done, total=total)

        rows = run_study(study, out, on_row)
    summary = summarise(rows)
    table = everything_table(summary) if together else robustness_table(summary)
    draw_robustness(summary, out / "robustness.png")
    (out / "robustness.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")
    (out / "robustness.md").write_text(table + "\n", encoding="utf-8")
    return summary, f"{table}\n\nfigure, table and every row driven: {out}"


def _axes(arguments: argparse.Namespace) -> tuple[str, ...]:
    from zebrat_bullet.evaluation.axes import AXIS_NAMES

    return tuple(AXIS_NAMES if arguments.axes is None else arguments.axes)


def _require_disturbed(axes: Mapping[str, tuple[float, ...]]) -> None:
    """Refuse levels at none of which anything is disturbed: there would be nothing to draw."""
    from zebrat_bullet.evaluation.axes import is_everything, levels_of, nominal_of

    if axes and all(level == nominal_of(axis) for axis, levels in axes.items() for level in levels):
        axis = next(iter(axes))
        option = "--everything " if is_everything(axis) else f"--axes {axis}="
        raise ConfigError(
            f"nothing is disturbed: {', '.join(f'{axis} is nominal at {nominal_of(axis):g}' for axis in axes)}; "
            f"give another level too, as in {option}{levels_of(axis)[0]:g}"
        )


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
    made.set_defaults(robot=None)
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
    made.add_argument("--episodes", type=whole_number, help="in each world at each level (default 10)")
    made.add_argument(
        "--pose-sigma-m", type=float, default=0.05, help="drifting error of the pose that planners get (default 0.05 m)"
    )
    made.add_argument("--pose-sigma-deg", type=float, default=3.0, help="and of its yaw (default 3 degrees)")
    made.add_argument("--set", nargs="+", action="extend", default=[], metavar="task.KEY=VALUE", help="as for evaluate")
