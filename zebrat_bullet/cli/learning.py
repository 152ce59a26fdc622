"""The commands that learn or gather what is learnt from: train, demonstrate, imitate, teleop."""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from zebrat_bullet.cli.common import (
    TRACKS,
    AddCommand,
    Result,
    file_name,
    given,
    note,
    placed,
    progress_bar,
    require_default,
    require_no_settings,
    task_of,
    told_when_stopped,
)
from zebrat_bullet.cli.options import (
    noisy_options,
    place_options,
    reward_options,
    sim_option,
    task_options,
    whole_number,
    workers_option,
)
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.processes import usable_cores


def train(arguments: argparse.Namespace) -> Result:
    """Train a policy, or resume a killed run; leave its learning curve in its folder."""
    from zebrat_bullet.report.curves import draw_learning_curve
    from zebrat_bullet.training import run
    from zebrat_bullet.training.run_folder import evaluations, has_checkpoint, summarise
    from zebrat_bullet.training.sweep_run import claim

    folder = arguments.out or Path("runs") / _run_name(arguments)
    if arguments.resume:
        require_no_settings(arguments, folder, "preset", "algo", "reward", "seed")
        run.require_run(folder)
    config = None if arguments.resume else _train_config(arguments)
    with claim(folder) as mine, progress_bar(arguments) as bar:
        if not mine:
            raise ConfigError(f"another process is training in {folder}; wait for it, or name another folder")
        shown = bar.add_task("training", total=None)

        def on_progress(at: Any) -> None:
            said = f"{at.steps_per_s:.0f} steps/s  success {at.recent_success:.0%}  best {at.best_success:.0%}"
            bar.update(shown, completed=at.done, total=at.total, description=said)

        try:
            if config is None:
                run.resume(folder, on_progress)
            else:
                run.train(config, folder, on_progress)
        except KeyboardInterrupt:
            if has_checkpoint(folder):
                note(arguments, f"`zebrat train --resume --out {folder}` goes on from its last checkpoint")
            raise
    draw_learning_curve(folder, folder / "learning_curve.png")
    summary = summarise(folder)
    best = summary["best"]
    curve = "  ".join(f"{at['episode']}: {float(at['success']):.0%}" for at in evaluations(folder))
    text = f"success in evaluations after so many episodes: {curve}\nbest policy: {best['success']:.0%} after episode "
    return summary, f"{text}{best['episode']:.0f}; curves and policies: {folder}"


def _run_name(arguments: argparse.Namespace) -> str:
    algo = [arguments.algo] if arguments.algo else []
    reward = [arguments.reward] if arguments.reward else []
    return "-".join([arguments.preset, *algo, *reward, f"seed{arguments.seed}"])


def _train_config(arguments: argparse.Namespace) -> Any:
    """Return the `TrainConfig` that the options say."""
    from zebrat_bullet.config_text import with_overrides, with_settings_of
    from zebrat_bullet.training.presets import ALGORITHMS, TRAIN_PRESETS, with_task

    config = replace(TRAIN_PRESETS[arguments.preset], seed=arguments.seed)
    if arguments.algo:
        config = replace(config, learner=ALGORITHMS[arguments.algo])
    config = with_task(config, arguments.robot, arguments.reward)
    worlds = placed(arguments, arguments.worlds or [])
    if worlds:
        config = replace(config, worlds=tuple(worlds))
    if arguments.config:
        return with_settings_of(config, arguments.config, arguments.set)
    return with_overrides(config, arguments.set)


def demonstrate(arguments: argparse.Namespace) -> Result:
    """Let an agent drive and record it as demonstrations to imitate; the oracle also on generated tracks."""
    from zebrat_bullet.agents import load_agent
    from zebrat_bullet.agents.human import HumanLikeAgent
    from zebrat_bullet.evaluation.own_task import as_trained
    from zebrat_bullet.imitation.demonstrations import demonstrate

    arguments.agent = arguments.agent or ("oracle" if arguments.generated else "shipped")
    if arguments.sim == "planar" and not arguments.generated:
        raise ConfigError("--sim planar: planar cars demonstrate on --generated N tracks; give it, or leave --sim out")
    if arguments.generated:
        return _demonstrate_generated(arguments)
    if others := given(arguments, ["families", "episodes", "workers"]):
        raise ConfigError(f"{', '.join(others)} goes with --generated N, not with --worlds; leave that out")
    pairs = 10_000 if arguments.pairs is None else arguments.pairs
    task, differing = as_trained(task_of(arguments), arguments.agent, own_robot=not given(arguments, ["robot"]))
    if differing:
        note(arguments, f"{arguments.agent} drives in the task that it was trained on: {', '.join(differing)}")
    out = arguments.out = arguments.out or Path("results/demonstrations") / file_name(arguments.agent)
    agent = load_agent(arguments.agent, task, arguments.action_noise)
    if arguments.human_noise:
        agent = HumanLikeAgent(agent, task.physics)
    with told_when_stopped(arguments, f"the same command, with --out {out}, goes on"), progress_bar(arguments) as bar:
        shown = bar.add_task("pairs", total=pairs)
        done = demonstrate(
            agent,
            placed(arguments, arguments.worlds),
            pairs,
            out,
            task,
            arguments.seed,
            arguments.compact,
            lambda n: bar.update(shown, completed=n),
        )
    text = f"{done['pairs']} pairs from {done['successes']} of {done['episodes']} episodes, which succeeded: {out}"
    return {"folder": str(out), **done}, text


def _demonstrate_generated(arguments: argparse.Namespace) -> Result:
    from zebrat_bullet.imitation.planar_demonstrations import Demonstrating, demonstrate_generated
    from zebrat_bullet.world import FAMILIES

    if arguments.sim not in (None, "planar"):
        raise ConfigError(f"--generated: planar cars drive generated tracks, got --sim {arguments.sim}; leave it out")
    of_worlds = ["worlds", "pairs", "human_noise", "compact", "start", "goal", "exit"]
    if others := given(arguments, of_worlds):
        raise ConfigError(f"{', '.join(others)} goes with --worlds, not with --generated; leave that out")
    arguments.sim = "planar"
    how = Demonstrating(
        agent=arguments.agent,
        families=tuple(arguments.families or FAMILIES),
        episodes=arguments.episodes,
        action_noise=arguments.action_noise,
        task=task_of(arguments),
        seed=arguments.seed,
    )
    out = arguments.out = arguments.out or Path("results/demonstrations") / f"generated-{file_name(arguments.agent)}"
    with told_when_stopped(arguments, f"the same command, with --out {out}, goes on"), progress_bar(arguments) as bar:
        shown = bar.add_task("tracks", total=arguments.generated)
        done = demonstrate_generated(
            how,
            arguments.generated,
            out,
            arguments.workers or usable_cores(),
            lambda tracks, pairs: bar.update(shown, completed=tracks, description=f"tracks, {pairs} pairs"),
        )
    ends = ", ".join(f"{n} {name}" for name, n in done.items() if name not in ("pairs", "tracks") and n)
    return {"folder": str(out), **done}, f"{done['pairs']} pairs on {done['tracks']} tracks ({ends}): {out}"


def imitate(arguments: argparse.Namespace) -> Result:
    """Clone the behaviour in demonstrations; with --dagger, let an expert label what the learner then meets."""
    from zebrat_bullet.config_text import with_overrides
    from zebrat_bullet.imitation import run
    from zebrat_bullet.imitation.settings import ImitationConfig

    folder = arguments.out or Path("runs") / f"imitate-seed{arguments.seed}"
    if arguments.resume:
        require_no_settings(arguments, folder, "seed")
        run.resume_imitation(folder, lambda said: note(arguments, said))
    else:
        require_default(arguments, "demonstrations")
        config = ImitationConfig(
            demonstrations=arguments.demonstrations,
            iterations=arguments.dagger or 0,
            expert=arguments.expert,
            seed=arguments.seed,
        )
        run.imitate(with_overrides(config, arguments.set), folder, lambda said: note(arguments, said))
    rows = run.iterations(folder)
    text = "\n".join(
        f"iteration {row['iteration']:.0f}: {row['pairs']:.0f} pairs, held-out loss {row['held_out_loss']:.4f}, "
        f"noise-free success {row['success']:.0%}"
        for row in rows
    )
    return {"folder": str(folder), "iterations": rows}, f"{text}\nbest policy and all others: {folder}"


def teleop(arguments: argparse.Namespace) -> Result:
    """Drive yourself in a browser; every episode joins a data set of demonstrations."""
    from zebrat_bullet.teleop.session import teleop

    out = arguments.out or Path("results/demonstrations") / "person"
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out} is a file; name a folder, which keeps an episode each")
    arguments.out = out
    outcomes: list[str] = []

    def on_episode(record: Any, path: Path) -> None:
        outcomes.append(record.outcome)
        note(arguments, f"{record.outcome} after {record.duration_s:.1f} s: {path}")

    (world,) = placed(arguments, [arguments.world])
    teleop(
        world,
        out,
        task_of(arguments),
        host=arguments.host,
        port=arguments.port,
        seed=arguments.seed,
        episodes=arguments.episodes,
        on_ready=lambda url: print(f"drive at {url} (Ctrl-C ends)", file=sys.stderr, flush=True),
        on_episode=on_episode,
    )
    return {"folder": str(out), "outcomes": outcomes}, f"{len(outcomes)} episodes saved in {out}"


def add(command: AddCommand) -> None:
    """Add the commands of this file."""
    made = command(train, reward_options(), place_options())
    made.set_defaults(reward=None)
    made.add_argument("--preset", choices=("paper", "general", "quick", "allround"), default="paper")
    made.add_argument(
        "--algo",
        choices=("ddpg", "dqn", "sac", "ppo", "ppo-discrete"),
        help="with the paper's networks and parameters, instead of the preset's learner",
    )
    made.add_argument("--worlds", nargs="+", metavar="WORLD", help="training worlds instead of the preset's")
    made.add_argument("--config", type=Path, metavar="YAML", help="a file of settings that override the preset's")
    made.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="KEY=VALUE",
        help="override settings, e.g. learner.batch_size=128",
    )
    made.add_argument("--resume", action="store_true", help="continue the run in --out from its last checkpoint")

    made = command(
        demonstrate,
        *(task_options(), noisy_options(), reward_options(), place_options()),
        *(
            sim_option("what drives: PyBullet, or MuJoCo, in --worlds; planar cars on --generated tracks"),
            workers_option(),
        ),
    )
    made.add_argument(
        "--agent", help="who demonstrates; as in `zebrat evaluate` (default shipped; on --generated tracks oracle)"
    )
    made.add_argument(
        "--worlds", nargs="+", default=list(TRACKS[:4]), metavar="WORLD", help="one episode in each by turns"
    )
    made.add_argument("--pairs", type=int, help="steps of successful episodes to record (default 10000)")
    made.add_argument(
        "--generated",
        type=whole_number,
        default=0,
        metavar="N",
        help="instead: N generated tracks for training, on planar cars, by the oracle; where --action-noise is given "
        "each episode draws its own, up to this, and the label stays the oracle's own command",
    )
    made.add_argument("--families", nargs="+", metavar="FAMILY", help="of --generated, in turn (default: all)")
    made.add_argument("--episodes", type=whole_number, default=1, help="in each track of --generated (default 1)")
    made.add_argument("--human-noise", action="store_true", help="act late, steer unsteadily, change speed gently")
    made.add_argument("--compact", action="store_true", help="leave the 360-range scans out: a sixth of the size")

    made = command(imitate, car=False)
    made.add_argument(
        "--demonstrations",
        default="docs/results/demonstrations.zip",
        metavar="FOLDER",
        help="episode records, or a zip archive of them (default: those of this checkout)",
    )
    made.add_argument("--dagger", type=int, metavar="N", help="DAgger iterations after behaviour cloning")
    made.add_argument("--expert", default="", metavar="AGENT", help="who labels in DAgger; as in `zebrat evaluate`")
    made.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="KEY=VALUE",
        help="override settings, e.g. clone.epochs=40",
    )
    made.add_argument("--resume", action="store_true", help="continue the run in --out")

    made = command(teleop, task_options(), reward_options(), place_options())
    made.add_argument("--world", default="big_track")
    made.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    made.add_argument("--port", type=int, default=8765, help="port to listen on, 0 for any that is free (default 8765)")
    made.add_argument("--episodes", type=int, help="end after so many (default: at Ctrl-C)")
