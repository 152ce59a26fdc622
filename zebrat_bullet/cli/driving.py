"""The commands that drive and look: evaluate, replay, video, worlds, robots, bench."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zebrat_bullet.assets import list_assets
from zebrat_bullet.cli.common import (
    TRACKS,
    AddCommand,
    Result,
    file_name,
    noisy_options,
    note,
    progress_bar,
    randomise_option,
    reward_options,
    task_of,
    task_options,
)
from zebrat_bullet.cli.held_out import evaluate_generated, evaluate_set
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError, PlanError, WorldError

if TYPE_CHECKING:
    from zebrat_bullet.evaluation.metrics import Score
    from zebrat_bullet.robot import RobotModel


def evaluate(arguments: argparse.Namespace) -> Result:
    """Judge one agent or several; write every episode's record, the scores and the tables."""
    from zebrat_bullet.agents import load_agent
    from zebrat_bullet.report.tables import comparison_table

    if arguments.generated and arguments.set:
        raise ConfigError("--generated and --set both say what to drive; give one")
    if arguments.generated:
        return evaluate_generated(arguments)
    if arguments.set:
        return evaluate_set(arguments)
    if len(arguments.agent) == 1:
        (agent,) = arguments.agent
        out = arguments.out or Path("results") / f"evaluate-{file_name(agent)}"
        scores, table = _evaluate_one(arguments, agent, out)
        return {world: score.as_dict() for world, score in scores.items()}, f"{table}\n\nrecords and scores: {out}"
    for agent in arguments.agent:
        load_agent(agent, task_of(arguments))  # a wrong name is told before hours of driving
    out = arguments.out or Path("results") / "evaluate"
    every = {agent: _evaluate_one(arguments, agent, out / file_name(agent))[0] for agent in arguments.agent}
    table = comparison_table(every)
    result = {agent: {world: score.as_dict() for world, score in scores.items()} for agent, scores in every.items()}
    (out / "comparison.json").write_text(json.dumps(result, indent=2))
    (out / "comparison.md").write_text(table + "\n")
    return result, f"{table}\n\nrecords, scores and a table for each agent: {out}"


def _evaluate_one(arguments: argparse.Namespace, agent: str, out: Path) -> "tuple[dict[str, Score], str]":
    """Judge one agent, leave its records, scores and table in a folder, and return scores and table."""
    from zebrat_bullet.evaluation.judge import Judgement, judge
    from zebrat_bullet.report.tables import score_table

    what = Judgement(
        agent=agent,
        worlds=tuple(arguments.worlds),
        episodes=arguments.episodes,
        seed=arguments.seed,
        action_noise=arguments.action_noise,
        records=out / "records",
        workers=arguments.workers,
        task=task_of(arguments),
    )
    with progress_bar(arguments) as bar:
        shown = bar.add_task("judging", total=len(what.worlds) * what.episodes)
        scores = judge(what, lambda world: bar.update(shown, advance=1, description=f"judging {agent}, {world}"))
    table = score_table(scores)
    (out / "scores.json").write_text(json.dumps({world: score.as_dict() for world, score in scores.items()}, indent=2))
    (out / "table.md").write_text(table + "\n")
    return scores, table


def replay(arguments: argparse.Namespace) -> Result:
    """Drive a recorded episode's commands again and say whether every pose came out the same."""
    from zebrat_bullet.config import from_json
    from zebrat_bullet.evaluation.records import load_record
    from zebrat_bullet.evaluation.rollout import replay_episode
    from zebrat_bullet.task.drive import Drive
    from zebrat_bullet.world import load_world

    record = load_record(arguments.record)
    world = load_world(record.world)
    drive = Drive(from_json(TaskConfig, record.task), world)
    again = replay_episode(drive, record, world)
    drive.close()
    result = {"exact": True, "outcome": again.outcome, "steps": len(again.reward), "world": again.world}
    if arguments.out:
        result["video"] = str(_write_video(arguments, again))
    return result, f"{again.world}: {again.outcome} after {again.duration_s:.1f} s, every pose as recorded"


def video(arguments: argparse.Namespace) -> Result:
    """Drive one episode and write it as an MP4."""
    from zebrat_bullet.agents import load_agent
    from zebrat_bullet.evaluation.rollout import run_episode
    from zebrat_bullet.task.drive import Drive
    from zebrat_bullet.world import load_world

    task = task_of(arguments)
    drive = Drive(task, load_world(arguments.world))
    agent = load_agent(arguments.agent, task, arguments.action_noise)
    record = run_episode(drive, agent, arguments.seed, arguments.episode)
    drive.close()
    arguments.out = arguments.out or Path("results") / f"{file_name(arguments.agent)}-{Path(arguments.world).stem}.mp4"
    path = _write_video(arguments, record)
    result = {"video": str(path), "outcome": record.outcome, "duration_s": record.duration_s}
    return result, f"{record.outcome} after {record.duration_s:.1f} s: {path}"


def worlds(arguments: argparse.Namespace) -> Result:
    """List worlds with length, narrowest width and turns; generate, draw, certify them, write them as ROS maps."""
    from zebrat_bullet.planning.grid import OccupancyGrid, write_ros_map
    from zebrat_bullet.report.tables import worlds_table
    from zebrat_bullet.report.track_figure import draw_worlds
    from zebrat_bullet.robot import load_robot
    from zebrat_bullet.world import load_world, world_summary

    robot = load_robot(arguments.robot)
    names: Sequence[str | Path] = arguments.names or list_assets("worlds", ".yaml")
    path = arguments.out or Path("results") / "worlds.png"
    if arguments.generate is not None:
        folder = arguments.out or Path("results") / "worlds"
        names, path = _generate(arguments, robot, folder), folder / "worlds.png"
    elif arguments.family or arguments.difficulty is not None:
        raise ConfigError("--family and --difficulty say what to --generate; add --generate N")
    loaded = [load_world(name, robot=robot) for name in names]
    result = {world.name: world_summary(world) for world in loaded}
    if arguments.draw:
        path.parent.mkdir(parents=True, exist_ok=True)
        draw_worlds(loaded, path, robot.footprint_base)
        note(arguments, f"drew {path}")
    for world in loaded if arguments.map else ():
        ends = [(world.start.pose.x, world.start.pose.y), *world.waypoints]
        write_ros_map(OccupancyGrid.of_walls(world.walls, also_inside=ends), arguments.map / world.name)
    text = worlds_table(result)
    if arguments.certify:
        text += "\n\n" + "\n".join(_certify(arguments, world, result[world.name]) for world in loaded)
    return result, text


def robots(arguments: argparse.Namespace) -> Result:
    """List cars with size, turning radius, lidar mount and bearings; draw what each representation watches on them."""
    from zebrat_bullet.config import LidarConfig, SafetyRegionConfig
    from zebrat_bullet.report.region_figure import draw_regions
    from zebrat_bullet.report.tables import robot_summary, robots_table
    from zebrat_bullet.robot import load_robot

    loaded = [(Path(name).stem, load_robot(name)) for name in arguments.names or list_assets("urdf", ".urdf")]
    config, n_bearings = SafetyRegionConfig(), LidarConfig().n_bearings
    result = {name: robot_summary(robot, config, n_bearings) for name, robot in loaded}
    if arguments.draw:
        path = arguments.out or Path("results") / "robots.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        draw_regions(loaded, config, path)
        note(arguments, f"drew {path}")
    return result, robots_table(result)


def bench(arguments: argparse.Namespace) -> Result:
    """Time the environment step and its parts, for both ray casters; or planar cars; or an agent; or learning."""
    from zebrat_bullet.bench import bench_agent, bench_text, run_bench

    show = bench_text
    if arguments.learning == "planar":
        from zebrat_bullet.bench.learning import bench_planar_learning

        result = bench_planar_learning(arguments.cars, arguments.device, arguments.rounds, arguments.seed)
    elif arguments.planar:
        from zebrat_bullet.bench.planar import bench_planar, planar_text

        show = planar_text
        result = bench_planar(arguments.steps, arguments.cars, arguments.device, arguments.rounds, arguments.seed)
    elif arguments.learning:
        from zebrat_bullet.bench.learning import bench_learning
        from zebrat_bullet.training.presets import TRAIN_PRESETS

        config = replace(TRAIN_PRESETS[arguments.learning], worlds=(arguments.world,), seed=arguments.seed)
        result = bench_learning(config, arguments.steps, arguments.rounds)
    elif arguments.agent:
        result = {arguments.agent: bench_agent(arguments.agent, arguments.world, arguments.seed)}
    else:
        result = run_bench(arguments.world, arguments.steps, arguments.seed, arguments.rate_hz, arguments.bearings)
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(result, indent=2))
    return result, show(result)


def _generate(arguments: argparse.Namespace, robot: "RobotModel", folder: Path) -> list[Path]:
    """Write the tracks of N seeds of each family that was named as world files, and return their paths."""
    from zebrat_bullet.world.generate import check_family, generate_spec
    from zebrat_bullet.world.schema import write_spec

    if arguments.names or arguments.generate < 1:
        raise ConfigError(
            f"--generate makes at least 1 world and takes no names, got {arguments.generate} and names "
            f"{arguments.names}; leave the names out to generate"
        )
    chosen, difficulty = arguments.family or ["mixed"], arguments.difficulty
    for family in chosen:
        check_family(family, difficulty)
    seeds = range(arguments.seed, arguments.seed + arguments.generate)
    made = (
        generate_spec(seed, family=family, difficulty=difficulty, robot=robot) for family in chosen for seed in seeds
    )
    paths = [write_spec(spec, folder) for spec in made]
    note(arguments, f"wrote {len(paths)} world files to {folder}")
    return paths


def _certify(arguments: argparse.Namespace, world: Any, result: dict[str, Any]) -> str:
    """Write a world's certificate, note it in the world's result, and return what it says."""
    from zebrat_bullet.planning.certificate import save_certificate
    from zebrat_bullet.planning.certify import certify
    from zebrat_bullet.robot import load_robot

    try:
        certificate = certify(world, load_robot(arguments.robot))
    except (PlanError, WorldError) as error:
        proven = isinstance(error, PlanError) and error.proven
        result.update(certificate=None, proven_impassable=proven)
        return f"{world.name}: not certified, {'proven' if proven else 'not proven impassable'}: {error}"
    result["certificate"] = str(save_certificate(certificate, arguments.certify))
    return (
        f"{world.name}: {certificate.length_m:.1f} m with {certificate.n_reversals} reversals lead out, at least "
        f"{certificate.clearance_m:.3f} m from every wall; none takes less than {certificate.least_time_s:.1f} s"
    )


def _write_video(arguments: argparse.Namespace, record: Any) -> Path:
    from zebrat_bullet.report.video import write_video
    from zebrat_bullet.robot import load_robot
    from zebrat_bullet.world import load_world

    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    with progress_bar(arguments) as bar:
        shown = bar.add_task("drawing", total=None)
        write_video(
            record,
            arguments.out,
            load_robot(arguments.robot),
            load_world(record.world),
            progress=lambda done, total: bar.update(shown, completed=done, total=total),
        )
    return arguments.out


def add(command: AddCommand) -> None:
    """Add the commands of this file."""
    made = command(evaluate, task_options(), noisy_options(), randomise_option(), reward_options())
    made.add_argument(
        "--agent",
        required=True,
        nargs="+",
        help="shipped, il, dagger, dwa, dwa_tuned, teb:inflation_radius_m=0.5, oracle, a policy file, a run folder",
    )
    made.add_argument("--worlds", nargs="+", default=list(TRACKS), metavar="WORLD")
    made.add_argument(
        "--generated",
        type=int,
        default=0,
        metavar="N",
        help="instead: N generated tracks that are never trained on, --episodes in each, on planar cars",
    )
    made.add_argument(
        "--set", metavar="NAME", help="instead: a held-out set (`zebrat sets` lists them), --episodes in each track"
    )
    made.add_argument(
        "--sim",
        choices=("planar", "bullet"),
        default="planar",
        help="where --set is driven: policies on planar cars (default), any agent in PyBullet",
    )
    made.add_argument("--tracks", type=int, help="only so many of --set, drawn from --seed (default: all)")
    made.add_argument("--anywhere", action="store_true", help="begin anywhere along the way, not at the world's start")
    made.add_argument("--episodes", type=int, default=10, help="in each world (default 10)")
    made.add_argument("--workers", type=int, help="processes (default: one a core)")

    made = command(replay)
    made.add_argument("record", type=Path, help="an .npz that `zebrat evaluate` wrote; --out FILE.mp4 draws it")

    made = command(video, task_options(), noisy_options(), randomise_option(), reward_options())
    made.add_argument("--agent", default="shipped")
    made.add_argument("--world", default="big_track")
    made.add_argument("--episode", type=int, default=0, help="which episode of the seed")

    made = command(worlds)
    made.add_argument("names", nargs="*", metavar="WORLD", help="names or files (default: all that are shipped)")
    made.add_argument(
        "--generate", type=int, metavar="N", help="instead: write tracks of N seeds from --seed on into --out FOLDER"
    )
    made.add_argument("--family", nargs="+", metavar="NAME", help="of these families each (default: mixed)")
    made.add_argument("--difficulty", type=float, help="0 to 1 (default: drawn for each track; mixed: 0.6)")
    made.add_argument("--draw", action="store_true", help="draw them to scale into --out FILE.png (FOLDER/worlds.png)")
    made.add_argument("--certify", type=Path, metavar="FOLDER", help="find a drive out of each, write the proof there")
    made.add_argument("--map", type=Path, metavar="FOLDER", help="write each as a ROS map, NAME.yaml and NAME.pgm")

    made = command(robots)
    made.add_argument("names", nargs="*", metavar="ROBOT", help="names or URDF files (default: all that are shipped)")
    made.add_argument("--draw", action="store_true", help="draw what each representation watches into --out FILE.png")

    made = command(bench)
    made.add_argument("--world", default="big_track")
    made.add_argument("--agent", help="time this agent instead, in one episode")
    made.add_argument(
        "--learning", metavar="WHAT", choices=("paper", "planar"),
        help="time learning instead: the paper's DDPG beside Stable-Baselines3's own, or PPO on planar cars",
    )  # fmt: skip
    made.add_argument("--planar", action="store_true", help="time planar cars instead, beside one car of PyBullet")
    made.add_argument("--cars", type=int, default=1024, help="planar cars (default 1024)")
    made.add_argument("--device", default="cpu", help="of the planar cars: cpu (default) or cuda")
    made.add_argument("--steps", type=int, default=1000)
    made.add_argument("--rounds", type=int, default=5, help="of --learning and --planar (default 5)")
    made.add_argument("--rate-hz", type=float, default=None, help="physics rate (default: the task's)")
    made.add_argument(
        "--bearings",
        choices=("all", "region"),
        default="all",
        help="what a step casts: all, or what the region watches",
    )
