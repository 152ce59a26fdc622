"""The command line: parse, build settings, call one function. Results on standard output, everything else on stderr."""

import argparse
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from zebrat_bullet import __version__
from zebrat_bullet.assets import list_assets
from zebrat_bullet.config import REWARD_PRESETS, TaskConfig, with_overrides
from zebrat_bullet.errors import PlanError, WorldError, ZebratError

TRACKS = ("big_track", *(f"track_{i}" for i in range(1, 9)))


def main(argv: list[str] | None = None) -> int:
    """Run one `zebrat` command and return its exit status: 0, or 2 after an error that the user can mend."""
    arguments = _parser().parse_args(argv)
    with _real_stdout() as stdout:
        try:
            result, text = arguments.run(arguments)
        except ZebratError as error:
            print(f"zebrat {arguments.command}: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print(f"zebrat {arguments.command}: stopped", file=sys.stderr)
            return 130
        print(json.dumps(result) if arguments.json else text, file=stdout)
    return 0


def train(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Train a policy, or resume a killed run; leave its learning curve in its folder."""
    from zebrat_bullet.report.curves import draw_learning_curve
    from zebrat_bullet.training import run
    from zebrat_bullet.training.presets import TRAIN_PRESETS

    folder = arguments.out or Path("runs") / f"{arguments.preset}-seed{arguments.seed}"
    with _progress_bar(arguments) as bar:
        shown = bar.add_task("training", total=None)

        def on_progress(at: Any) -> None:
            note = f"{at.steps_per_s:.0f} steps/s  success {at.recent_success:.0%}  best {at.best_success:.0%}"
            bar.update(shown, completed=at.episode, total=at.n_episodes, description=note)

        if arguments.resume:
            run.resume(folder, on_progress)
        else:
            config = replace(TRAIN_PRESETS[arguments.preset], seed=arguments.seed)
            config = replace(config, task=replace(config.task, reward=REWARD_PRESETS[arguments.reward]))
            if arguments.worlds:
                config = replace(config, worlds=tuple(arguments.worlds))
            run.train(with_overrides(config, arguments.set), folder, on_progress)
    draw_learning_curve(folder, folder / "learning_curve.png")
    summary = run.summarise(folder)
    best = summary["best"]
    curve = "  ".join(f"{at['episode']}: {float(at['success']):.0%}" for at in run.evaluations(folder))
    text = f"noise-free success after so many episodes: {curve}\nbest policy: {best['success']:.0%} after episode "
    return summary, f"{text}{best['episode']:.0f}; curves and policies: {folder}"


def evaluate(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Judge an agent; write every episode's record, the scores and the table."""
    from zebrat_bullet.evaluation.judge import Judgement, judge
    from zebrat_bullet.report.tables import score_table

    out = arguments.out or Path("results") / f"evaluate-{_file_name(arguments.agent)}"
    what = Judgement(
        agent=arguments.agent,
        worlds=tuple(arguments.worlds),
        episodes=arguments.episodes,
        seed=arguments.seed,
        action_noise=arguments.action_noise,
        records=out / "records",
        workers=arguments.workers,
        task=_task(arguments),
    )
    with _progress_bar(arguments) as bar:
        shown = bar.add_task("judging", total=len(what.worlds) * what.episodes)
        scores = judge(what, lambda world: bar.update(shown, advance=1, description=f"judging {world}"))
    result = {world: score.as_dict() for world, score in scores.items()}
    table = score_table(scores)
    (out / "scores.json").write_text(json.dumps(result, indent=2))
    (out / "table.md").write_text(table + "\n")
    return result, f"{table}\n\nrecords and scores: {out}"


def replay(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
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


def video(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Drive one episode and write it as an MP4."""
    from zebrat_bullet.agents import load_agent
    from zebrat_bullet.evaluation.rollout import run_episode
    from zebrat_bullet.task.drive import Drive
    from zebrat_bullet.world import load_world

    task = _task(arguments)
    drive = Drive(task, load_world(arguments.world))
    agent = load_agent(arguments.agent, task, arguments.action_noise)
    record = run_episode(drive, agent, arguments.seed, arguments.episode)
    drive.close()
    arguments.out = arguments.out or Path("results") / f"{_file_name(arguments.agent)}-{Path(arguments.world).stem}.mp4"
    path = _write_video(arguments, record)
    result = {"video": str(path), "outcome": record.outcome, "duration_s": record.duration_s}
    return result, f"{record.outcome} after {record.duration_s:.1f} s: {path}"


def worlds(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """List worlds with length, narrowest width and turns; draw them to scale, write ROS maps, certify drives out."""
    from zebrat_bullet.planning.grid import OccupancyGrid, write_ros_map
    from zebrat_bullet.report.tables import worlds_table
    from zebrat_bullet.report.track_figure import draw_worlds
    from zebrat_bullet.robot import load_robot
    from zebrat_bullet.world import load_world, world_summary

    loaded = [load_world(name) for name in arguments.names or list_assets("worlds", ".yaml")]
    result = {world.name: world_summary(world) for world in loaded}
    if arguments.draw:
        path = arguments.out or Path("results") / "worlds.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        draw_worlds(loaded, path, load_robot(arguments.robot).footprint_base)
        _note(arguments, f"drew {path}")
    for world in loaded if arguments.map else ():
        ends = [(world.start.pose.x, world.start.pose.y), *world.waypoints]
        write_ros_map(OccupancyGrid.of_walls(world.walls, also_inside=ends), arguments.map / world.name)
    text = worlds_table(result)
    if arguments.certify:
        text += "\n\n" + "\n".join(_certify(arguments, world, result[world.name]) for world in loaded)
    return result, text


def bench(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Time the full environment step and its parts, for both ray casters."""
    from zebrat_bullet.bench import bench_text, run_bench

    result = run_bench(arguments.world, arguments.steps, arguments.seed, arguments.rate_hz)
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(result, indent=2))
    return result, bench_text(result)


def collisions(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Drive into walls and count which scan representation reports it; recommend a margin."""
    from zebrat_bullet.config import LidarConfig, NoiseConfig
    from zebrat_bullet.detection.cases import POSTS, cases
    from zebrat_bullet.detection.scoring import Sensing
    from zebrat_bullet.detection.study import Study, run_study
    from zebrat_bullet.detection.summary import recommended_margins, summaries
    from zebrat_bullet.report.collision_report import write_misses_mp4, write_report

    out = arguments.out or Path("results") / "collisions"
    drives = arguments.drives or out
    study = Study(
        worlds=tuple(arguments.worlds),
        drivers=tuple(arguments.drivers),
        walls=tuple(arguments.walls),
        n_events=arguments.events,
        seed=arguments.seed,
        policy=arguments.policy,
        task=TaskConfig(robot=arguments.robot),
    )
    sensing = Sensing(
        lidar=LidarConfig(caster=arguments.caster),
        noise=NoiseConfig(range_sigma_m=arguments.noise),
        rate_hz=arguments.rate_hz,
    )
    panels = ["base", *(panel for panel in arguments.panels if panel not in ("base", "posts"))]
    chosen = cases(panels, sensing, arguments.rays, arguments.margin)
    posts = {}
    with _progress_bar(arguments) as bar:
        shown = bar.add_task("driving")

        def on_progress(doing: str, done: int, total: int) -> None:
            bar.update(shown, description=doing, completed=done, total=total)

        results = run_study(study, chosen, drives, arguments.workers, on_progress)
        if "posts" in arguments.panels:
            thin = cases(["base", "rays"], sensing, arguments.rays, arguments.margin)
            for field in POSTS:
                there = replace(
                    study, worlds=(field,), drivers=("random-smooth",), n_events=max(study.n_events // 5, 1)
                )
                posts[field] = run_study(there, thin, drives / field, arguments.workers, on_progress)
    text = write_report(study, results, posts, out)
    result: dict[str, Any] = {
        "counts": summaries(results),
        "recommended_margin_m": {
            walls: {kind: margin for kind, (margin, _) in recommended_margins(results, walls).items()}
            for walls in study.walls
        },
    }
    if not arguments.no_video:
        try:
            result["video"] = str(write_misses_mp4(study, results, drives, out))
        except (ZebratError, OSError) as error:  # the counts are worth more than the film
            _note(arguments, f"no video: {error}")
    return result, f"{text}\n\ntables, every contact, figures and video: {out}"


def demonstrate(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Let an agent drive and record it as demonstrations to imitate."""
    from zebrat_bullet.agents import load_agent
    from zebrat_bullet.agents.human import HumanLikeAgent
    from zebrat_bullet.training.demonstrations import demonstrate

    task = _task(arguments)
    out = arguments.out or Path("demonstrations") / _file_name(arguments.agent)
    agent = load_agent(arguments.agent, task, arguments.action_noise)
    if arguments.human_noise:
        agent = HumanLikeAgent(agent, task.physics)
    with _progress_bar(arguments) as bar:
        shown = bar.add_task("pairs", total=arguments.pairs)
        done = demonstrate(
            agent,
            arguments.worlds,
            arguments.pairs,
            out,
            task,
            arguments.seed,
            arguments.compact,
            lambda n: bar.update(shown, completed=n),
        )
    text = f"{done['pairs']} pairs from {done['successes']} of {done['episodes']} episodes, which succeeded: {out}"
    return {"folder": str(out), **done}, text


def imitate(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Clone the behaviour in demonstrations; with --dagger, let an expert label what the learner then meets."""
    from zebrat_bullet.training import imitation

    folder = arguments.out or Path("runs") / f"imitate-seed{arguments.seed}"
    if arguments.resume:
        imitation.resume_imitation(folder, lambda note: _note(arguments, note))
    else:
        config = imitation.ImitationConfig(
            demonstrations=arguments.demonstrations,
            iterations=arguments.dagger,
            expert=arguments.expert,
            seed=arguments.seed,
        )
        imitation.imitate(with_overrides(config, arguments.set), folder, lambda note: _note(arguments, note))
    rows = imitation.iterations(folder)
    text = "\n".join(
        f"iteration {row['iteration']:.0f}: {row['pairs']:.0f} pairs, held-out loss {row['held_out_loss']:.4f}, "
        f"noise-free success {row['success']:.0%}"
        for row in rows
    )
    return {"folder": str(folder), "iterations": rows}, f"{text}\nbest policy and all others: {folder}"


def teleop(arguments: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Drive yourself in a browser; every episode joins a data set of demonstrations."""
    from zebrat_bullet.teleop.session import teleop

    out = arguments.out or Path("demonstrations") / "person"
    outcomes: list[str] = []

    def on_episode(record: Any, path: Path) -> None:
        outcomes.append(record.outcome)
        _note(arguments, f"{record.outcome} after {record.duration_s:.1f} s: {path}")

    teleop(
        arguments.world,
        out,
        _task(arguments),
        host=arguments.host,
        port=arguments.port,
        seed=arguments.seed,
        episodes=arguments.episodes,
        on_ready=lambda url: print(f"drive at {url} (Ctrl-C ends)", file=sys.stderr, flush=True),
        on_episode=on_episode,
    )
    return {"folder": str(out), "outcomes": outcomes}, f"{len(outcomes)} episodes saved in {out}"


def _certify(arguments: argparse.Namespace, world: Any, result: dict[str, Any]) -> str:
    """Write a world's certificate, note it in the world's result, and return what it says."""
    from zebrat_bullet.planning.certificate import certify, save_certificate
    from zebrat_bullet.robot import load_robot

    try:
        certificate = certify(world, load_robot(arguments.robot))
    except (PlanError, WorldError) as error:
        result["certificate"] = None
        return f"{world.name}: not certified: {error}"
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
    with _progress_bar(arguments) as bar:
        shown = bar.add_task("drawing", total=None)
        write_video(
            record,
            arguments.out,
            load_robot(arguments.robot),
            load_world(record.world),
            progress=lambda done, total: bar.update(shown, completed=done, total=total),
        )
    return arguments.out


def _task(arguments: argparse.Namespace) -> TaskConfig:
    task = TaskConfig(robot=arguments.robot, reward=REWARD_PRESETS[arguments.reward])
    task = replace(task, lidar=replace(task.lidar, caster=arguments.caster))
    return replace(task, noise=replace(task.noise, range_sigma_m=arguments.noise))


def _file_name(agent: str) -> str:
    """Return an agent's name or path as part of a file name."""
    return Path(agent).name.removesuffix(".safetensors").replace(":", "-").replace(",", "-")


def _note(arguments: argparse.Namespace, message: str) -> None:
    if not arguments.quiet:
        print(message, file=sys.stderr)


def _progress_bar(arguments: argparse.Namespace) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), disable=arguments.quiet)


@contextmanager
def _real_stdout() -> Iterator[TextIO]:
    """Yield the true standard output while all else that is written there, PyBullet's greeting too, goes to stderr."""
    sys.stdout.flush()
    saved = os.dup(1)
    os.dup2(2, 1)
    try:
        with os.fdopen(os.dup(saved), "w") as stream:
            yield stream
    finally:
        sys.stdout.flush()
        os.dup2(saved, 1)
        os.close(saved)


def _seed(text: str) -> int:
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"a seed is a whole number from 0 up, got {text!r}")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--json", action="store_true", help="print one JSON object as the last line")
    common.add_argument("--seed", type=_seed, default=0, help="seed of everything random (default 0)")
    common.add_argument("--out", type=Path, help="file or folder to write")
    common.add_argument("--quiet", action="store_true", help="no progress")
    common.add_argument("--robot", default="zebrat", help="URDF name or file")
    task = argparse.ArgumentParser(add_help=False)
    task.add_argument("--caster", choices=("bullet", "embree"), default="bullet", help="ray caster of the lidar")
    task.add_argument("--noise", type=float, default=0.0, help="lidar range noise, sigma in m")
    noisy = argparse.ArgumentParser(add_help=False)
    noisy.add_argument("--action-noise", type=float, default=0.0, help="sigma on the commands, fraction of the limits")
    reward = argparse.ArgumentParser(add_help=False)
    reward.add_argument("--reward", choices=sorted(REWARD_PRESETS), default="fomt", help="reward preset")

    parser = argparse.ArgumentParser(prog="zebrat", description="Learn to drive out of narrow spaces.")
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True)

    def command(run: Any, *parents: argparse.ArgumentParser) -> argparse.ArgumentParser:
        made = commands.add_parser(run.__name__, parents=[common, *parents], help=run.__doc__, description=run.__doc__)
        made.set_defaults(run=run)
        return made

    made = command(train, reward)
    made.add_argument("--preset", choices=("paper", "general", "finetune", "quick"), default="paper")
    made.add_argument("--worlds", nargs="+", metavar="WORLD", help="training worlds instead of the preset's")
    made.add_argument(
        "--set", nargs="+", default=[], metavar="KEY=VALUE", help="override settings, e.g. batch_size=128"
    )
    made.add_argument("--resume", action="store_true", help="continue the run in --out from its last checkpoint")

    made = command(evaluate, task, noisy, reward)
    made.add_argument(
        "--agent",
        required=True,
        help="shipped, random, dwa:inflation_radius_m=0.5, ..., a .safetensors policy or a run folder",
    )
    made.add_argument("--worlds", nargs="+", default=list(TRACKS), metavar="WORLD")
    made.add_argument("--episodes", type=int, default=10, help="in each world (default 10)")
    made.add_argument("--workers", type=int, help="processes (default: one a core)")

    made = command(replay)
    made.add_argument("record", type=Path, help="an .npz that `zebrat evaluate` wrote; --out FILE.mp4 draws it")

    made = command(video, task, noisy, reward)
    made.add_argument("--agent", default="shipped")
    made.add_argument("--world", default="big_track")
    made.add_argument("--episode", type=int, default=0, help="which episode of the seed")

    made = command(demonstrate, task, noisy, reward)
    made.add_argument("--agent", default="shipped", help="who demonstrates; as in `zebrat evaluate`")
    made.add_argument(
        "--worlds", nargs="+", default=list(TRACKS[:4]), metavar="WORLD", help="one episode in each by turns"
    )
    made.add_argument(
        "--pairs", type=int, default=10_000, help="steps of successful episodes to record (default 10000)"
    )
    made.add_argument("--human-noise", action="store_true", help="act late, steer unsteadily, change speed gently")
    made.add_argument("--compact", action="store_true", help="leave the 360-range scans out: a sixth of the size")

    made = command(imitate)
    made.add_argument("--demonstrations", default="demonstrations/oracle", metavar="FOLDER", help="episode records")
    made.add_argument("--dagger", type=int, default=0, metavar="N", help="DAgger iterations after behaviour cloning")
    made.add_argument("--expert", default="", metavar="AGENT", help="who labels in DAgger; as in `zebrat evaluate`")
    made.add_argument(
        "--set", nargs="+", default=[], metavar="KEY=VALUE", help="override settings, e.g. clone.epochs=40"
    )
    made.add_argument("--resume", action="store_true", help="continue the run in --out")

    made = command(teleop, task, reward)
    made.add_argument("--world", default="big_track")
    made.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    made.add_argument("--port", type=int, default=8765, help="port to listen on, 0 for any that is free (default 8765)")
    made.add_argument("--episodes", type=int, help="end after so many (default: at Ctrl-C)")

    made = command(collisions)
    made.add_argument("--events", type=int, default=1000, help="contacts to drive for (default 1000)")
    made.add_argument("--worlds", nargs="+", default=["big_track", *TRACKS[4:]], metavar="WORLD")
    made.add_argument("--drivers", nargs="+", default=["random", "random-smooth", "policy"], metavar="DRIVER")
    made.add_argument("--policy", default="shipped", help="the agent behind the driver `policy`")
    made.add_argument("--walls", nargs="+", default=["solid", "ghost"], help="solid stop the car, ghost let it through")
    made.add_argument("--rays", type=int, default=32, help="rays of each representation (default 32)")
    made.add_argument("--margin", type=float, default=0.0, help="margin of each representation in m (default 0)")
    made.add_argument("--rate-hz", type=float, default=5.0, help="sweeps a second (default 5)")
    made.add_argument("--caster", choices=("bullet", "embree"), default="embree", help="ray caster (default embree)")
    made.add_argument("--noise", type=float, default=0.0, help="lidar range noise, sigma in m")
    made.add_argument(
        "--panels",
        nargs="*",
        default=["margin"],
        metavar="PANEL",
        help="what else to vary: margin rays rate resolution noise caster posts (default: margin)",
    )
    made.add_argument(
        "--drives", type=Path, metavar="FOLDER", help="drives of an earlier --out, to count them otherwise"
    )
    made.add_argument("--workers", type=int, help="processes (default: one a core)")
    made.add_argument("--no-video", action="store_true", help="leave out misses.mp4")

    made = command(worlds)
    made.add_argument("names", nargs="*", metavar="WORLD", help="names or files (default: all that are shipped)")
    made.add_argument("--draw", action="store_true", help="draw them to scale into --out FILE.png")
    made.add_argument("--certify", type=Path, metavar="FOLDER", help="find a drive out of each, write the proof there")
    made.add_argument("--map", type=Path, metavar="FOLDER", help="write each as a ROS map, NAME.yaml and NAME.pgm")

    made = command(bench)
    made.add_argument("--world", default="big_track")
    made.add_argument("--steps", type=int, default=1000)
    made.add_argument("--rate-hz", type=float, default=None, help="physics rate (default: the task's)")
    return parser
