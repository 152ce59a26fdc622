"""The commands that drive and look: evaluate, replay, video."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zebrat_bullet.cli.common import (
    TRACKS,
    AddCommand,
    Result,
    file_name,
    file_names,
    given,
    of_engine,
    own_task_of,
    placed,
    progress_bar,
    told_when_stopped,
)
from zebrat_bullet.cli.held_out import evaluate_generated, evaluate_set, sort_set
from zebrat_bullet.cli.options import (
    agents_option,
    engine_option,
    noisy_options,
    place_options,
    randomise_option,
    reward_options,
    sim_option,
    supervised_option,
    task_options,
    whole_number,
    workers_option,
)
from zebrat_bullet.cli.recording import BAG_OPTIONS, bag_options, replay_bag
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.outputs import require_writable

if TYPE_CHECKING:
    from zebrat_bullet.evaluation.judge import Judgement
    from zebrat_bullet.evaluation.metrics import Score


def evaluate(arguments: argparse.Namespace) -> Result:
    """Judge one agent or several; write every episode's record, the scores and the tables."""
    from zebrat_bullet.evaluation.judge import require_drivable
    from zebrat_bullet.report.tables import comparison_table

    _settle(arguments)
    if arguments.generated:
        return evaluate_generated(arguments)
    if arguments.set:
        return evaluate_set(arguments)
    if len(arguments.agent) == 1:
        (agent,) = arguments.agent
        out = arguments.out = arguments.out or Path("results") / f"evaluate-{file_name(agent)}{of_engine(arguments)}"
        what = _judgement(arguments, agent, out)
        require_writable(out, folder=True)
        scores, table = _evaluate_one(arguments, what, out)
        return {world: score.as_dict() for world, score in scores.items()}, f"{table}\n\nrecords and scores: {out}"
    out = arguments.out = arguments.out or Path("results") / f"evaluate{of_engine(arguments)}"
    names = file_names(arguments.agent)
    judgements = {agent: _judgement(arguments, agent, out / names[agent]) for agent in arguments.agent}
    for what in judgements.values():
        require_drivable(what)  # before hours of driving
    require_writable(out, folder=True)
    every = {agent: _evaluate_one(arguments, what, out / names[agent])[0] for agent, what in judgements.items()}
    table = comparison_table(every, all(_certified(arguments, what.task) for what in judgements.values()))
    result = {agent: {world: score.as_dict() for world, score in scores.items()} for agent, scores in every.items()}
    (out / "comparison.json").write_text(json.dumps(result, indent=2), encoding="utf-8")
    (out / "comparison.md").write_text(table + "\n", encoding="utf-8")
    return result, f"{table}\n\nrecords, scores and a table for each agent: {out}"


def require_evaluable(arguments: argparse.Namespace) -> None:
    """Refuse what `evaluate` would refuse with these options, and drive nothing.

    Raises:
        ZebratError: an option, an agent, a world or a set is wrong.
    """
    from zebrat_bullet.agents import load_agent
    from zebrat_bullet.evaluation.endings import as_policy
    from zebrat_bullet.evaluation.judge import require_drivable
    from zebrat_bullet.evaluation.track_set import read_set

    _settle(arguments)
    if arguments.set:
        read_set(arguments.set)
    for name in arguments.agent:
        if not arguments.set:
            require_drivable(_judgement(arguments, name, Path()))
            continue
        agent = load_agent(name, own_task_of(arguments, name))
        if arguments.sim == "planar":
            as_policy(agent, name)


def _settle(arguments: argparse.Namespace) -> None:
    """Part what --set says, refuse options that do not go together, and say what drives."""
    sort_set(arguments)
    if arguments.generated and arguments.set:
        raise ConfigError("--generated and --set both say what to drive; give one")
    if (arguments.generated or arguments.set) and (arguments.start or arguments.goal or arguments.exit):
        raise ConfigError("--start, --goal and --exit go with one of --worlds, not with --generated or --set")
    planar_drives = bool(arguments.generated or arguments.set)
    if planar_drives and given(arguments, ["worlds"]):
        raise ConfigError("--worlds, --set and --generated each say what to drive; give one of them")
    if arguments.tracks is not None and not arguments.set:
        raise ConfigError("--tracks goes with --set NAME, of which it takes so many; leave it out")
    if arguments.sim == "planar" and not planar_drives:
        raise ConfigError(
            "--sim planar: planar cars drive --set NAME or --generated N, not --worlds; give one of these, or --sim "
            "bullet or mujoco"
        )
    arguments.sim = arguments.sim or ("planar" if planar_drives else "bullet")


def _judgement(arguments: argparse.Namespace, agent: str, out: Path) -> "Judgement":
    from zebrat_bullet.evaluation.judge import Judgement

    return Judgement(
        agent=agent,
        worlds=tuple(placed(arguments, arguments.worlds)),
        episodes=arguments.episodes,
        seed=arguments.seed,
        action_noise=arguments.action_noise,
        supervised_m=arguments.supervised,
        records=out / "records",
        workers=arguments.workers,
        task=own_task_of(arguments, agent),
    )


def _evaluate_one(arguments: argparse.Namespace, what: "Judgement", out: Path) -> "tuple[dict[str, Score], str]":
    """Judge one agent, leave its records, scores and table in a folder, and return scores and table."""
    from zebrat_bullet.evaluation.judge import judge
    from zebrat_bullet.report.tables import score_table

    left = f"the episodes that were driven lie in {what.records}; they are not scored"
    with told_when_stopped(arguments, left), progress_bar(arguments) as bar:
        shown = bar.add_task("judging", total=len(what.worlds) * what.episodes)
        judged = judge(what, lambda at: bar.update(shown, advance=1, description=f"judging {what.agent}, {at}"))
    scores = {world: judged[reference] for world, reference in zip(arguments.worlds, what.worlds, strict=True)}
    table = score_table(scores, _certified(arguments, what.task))
    (out / "scores.json").write_text(
        json.dumps({world: score.as_dict() for world, score in scores.items()}, indent=2), encoding="utf-8"
    )
    (out / "table.md").write_text(table + "\n", encoding="utf-8")
    return scores, table


def _certified(arguments: argparse.Namespace, task: TaskConfig) -> bool:
    """Return whether car, limits and start are those that the shipped certificates are of."""

    def certified(of: TaskConfig) -> tuple[object, ...]:
        return of.robot, of.physics.max_speed_mps, of.physics.max_steering_rad, of.dynamics, of.episode.start

    return certified(task) == certified(TaskConfig()) and arguments.start is None


def replay(arguments: argparse.Namespace) -> Result:
    """Drive a recorded episode's commands again and compare every pose; or run a policy on a bag (--bag)."""
    if (arguments.record is None) == (arguments.bag is None):
        raise ConfigError("name an .npz that `zebrat evaluate` wrote, or a recording: --bag FILE")
    if arguments.bag:
        return replay_bag(arguments)
    if others := given(arguments, BAG_OPTIONS):
        raise ConfigError(f"a record is no bag: {', '.join(others)} can only be heeded with --bag FILE; leave that out")
    from zebrat_bullet.config_text import from_json
    from zebrat_bullet.evaluation.records import load_record
    from zebrat_bullet.evaluation.rollout import replay_episode
    from zebrat_bullet.report.mp4 import check_mp4
    from zebrat_bullet.report.video import DEFAULT_SIZE
    from zebrat_bullet.robot import load_robot
    from zebrat_bullet.task.drive import Drive
    from zebrat_bullet.world import load_world

    if arguments.out:
        check_mp4(arguments.out, DEFAULT_SIZE)
    record = load_record(arguments.record)
    task = from_json(TaskConfig, record.task)
    if arguments.robot is not None:  # its own car, elsewhere: another would not come by the recorded poses
        task = replace(task, robot=arguments.robot)
    world = load_world(record.world, robot=load_robot(task.robot))
    if arguments.out:
        require_writable(arguments.out)
    drive = Drive(task, world)
    again = replay_episode(drive, record, world)
    drive.close()
    result = {"exact": True, "outcome": again.outcome, "steps": len(again.reward), "world": again.world}
    if arguments.out:
        result["video"] = str(_write_video(arguments, again))
    return result, f"{again.world}: {again.outcome} after {again.duration_s:.1f} s, every pose as recorded"


def video(arguments: argparse.Namespace) -> Result:
    """Drive one episode and write it as an MP4."""
    from zebrat_bullet.agents import load_agent
    from zebrat_bullet.agents.supervised import supervised
    from zebrat_bullet.evaluation.judge import require_winnable_by
    from zebrat_bullet.evaluation.rollout import run_episode
    from zebrat_bullet.report.mp4 import check_mp4
    from zebrat_bullet.report.video import DEFAULT_SIZE
    from zebrat_bullet.robot import load_robot
    from zebrat_bullet.task.drive import Drive
    from zebrat_bullet.world import load_world

    sort_set(arguments)
    task = own_task_of(arguments, arguments.agent)
    (reference,) = placed(arguments, [arguments.world])
    name = f"{file_name(arguments.agent)}-{Path(arguments.world).stem}{of_engine(arguments)}.mp4"
    arguments.out = arguments.out or Path("results") / name
    check_mp4(arguments.out, DEFAULT_SIZE)
    world = load_world(reference, robot=load_robot(task.robot))
    agent = load_agent(arguments.agent, task, arguments.action_noise)
    require_winnable_by(agent, world)
    if arguments.supervised is not None:
        agent = supervised(agent, task, arguments.supervised)
    require_writable(arguments.out)
    drive = Drive(task, world)
    record = run_episode(drive, agent, arguments.seed, arguments.episode)
    drive.close()
    path = _write_video(arguments, record)
    result = {"video": str(path), "outcome": record.outcome, "duration_s": record.duration_s}
    return result, f"{record.outcome} after {record.duration_s:.1f} s: {path}"


def _write_video(arguments: argparse.Namespace, record: Any) -> Path:
    from zebrat_bullet.config_text import from_json
    from zebrat_bullet.report.video import write_video
    from zebrat_bullet.robot import load_robot
    from zebrat_bullet.world import load_world

    robot = load_robot(from_json(TaskConfig, record.task).robot)
    with progress_bar(arguments) as bar:
        shown = bar.add_task("drawing", total=None)
        write_video(
            record,
            arguments.out,
            robot,
            load_world(record.world, robot=robot),
            progress=lambda done, total: bar.update(shown, completed=done, total=total),
        )
    return arguments.out


def add(command: AddCommand) -> None:
    """Add the commands of this file."""
    made = command(
        evaluate,
        *(agents_option(), task_options(), noisy_options(), randomise_option(), reward_options()),
        sim_option("what drives: planar cars on --set and --generated (default there), PyBullet, or MuJoCo"),
        *(workers_option(), place_options(), supervised_option()),
    )
    made.add_argument("--worlds", nargs="+", default=list(TRACKS), metavar="WORLD")
    made.add_argument(
        "--generated",
        type=whole_number,
        default=0,
        metavar="N",
        help="instead: N generated tracks that are never trained on, --episodes in each, in --sim",
    )
    made.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME|task.KEY=VALUE",
        help="instead: a held-out set (`zebrat sets` lists them), --episodes in each track; with =: a setting of the "
        "task, e.g. task.lidar.range_max_m=4, instead of the one the agent was trained with",
    )
    made.set_defaults(robot=None)  # then that of the agent
    made.add_argument("--tracks", type=whole_number, help="only so many of --set, drawn from --seed (default: all)")
    made.add_argument("--anywhere", action="store_true", help="begin anywhere along the way, not at the world's start")
    made.add_argument("--episodes", type=whole_number, default=10, help="in each world (default 10)")

    made = command(replay)
    made.set_defaults(robot=None)
    made.add_argument(
        "record", nargs="?", type=Path, help="an .npz that `zebrat evaluate` wrote; --out FILE.mp4 draws it"
    )
    bag_options(made)

    made = command(
        video,
        *(engine_option(), task_options(), noisy_options(), randomise_option(), reward_options(), place_options()),
        supervised_option(),
    )
    made.add_argument("--agent", default="shipped")
    made.add_argument("--set", nargs="+", action="extend", default=[], metavar="task.KEY=VALUE", help="as for evaluate")
    made.set_defaults(robot=None)
    made.add_argument("--world", default="big_track")
    made.add_argument("--episode", type=whole_number, default=0, help="which episode of the seed")
