"""Held-out tracks: the command that makes sets of them, and what `zebrat evaluate` does with sets and seeds."""

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from zebrat_bullet.cli.common import (
    AddCommand,
    PartialResultError,
    Result,
    file_name,
    file_names,
    of_engine,
    own_task_of,
    progress_bar,
)
from zebrat_bullet.cli.options import workers_option
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.outputs import require_writable
from zebrat_bullet.processes import usable_cores

if TYPE_CHECKING:
    from rich.progress import TaskID


def sets(arguments: argparse.Namespace) -> Result:
    """List the sets of held-out tracks; make some: draw, certify, keep. What a kill leaves is gone on with."""
    from zebrat_bullet.assets import list_assets
    from zebrat_bullet.evaluation.track_set import FOLDER, read_set

    if arguments.make:
        return _make(arguments)
    found = {name: read_set(name) for name in arguments.names or list_assets(FOLDER, ".json")}
    result = {
        name: {
            "tracks": len(at.tracks),
            "robot": at.robot,
            "sha256": at.sha256,
            "families": sorted({track.family for track in at.tracks}),
            "reversals": sorted({track.reversals for track in at.tracks}),
        }
        for name, at in found.items()
    }
    rows = [
        f"| {name} | {at['tracks']} | {', '.join(at['families'])} | {', '.join(map(str, at['reversals']))} |"  # type: ignore[arg-type,call-overload]
        for name, at in result.items()
    ]
    return result, "\n".join(["| set | tracks | families | reversals |", "|---|---|---|---|", *rows])


def _make(arguments: argparse.Namespace) -> Result:
    from zebrat_bullet.evaluation.make_set import Recipe, make_set

    if not arguments.names:
        raise ConfigError("name the sets to make: families of tracks, or reversals-K")
    out = arguments.out or Path("results") / "sets"
    recipes = [
        Recipe(
            name=name,
            n_tracks=arguments.tracks,
            families=tuple(arguments.families),
            most_seeds=arguments.most_seeds,
            robot=arguments.robot,
            workers=_workers(arguments),
        )
        for name in arguments.names
    ]
    result: dict[str, object] = {}
    missing: list[str] = []
    with progress_bar(arguments) as bar:

        def on_candidate(shown: "TaskID", name: str, found: int, tried: int) -> None:
            bar.update(shown, completed=found, description=f"{name}, {tried} tried")

        for recipe in recipes:
            shown = bar.add_task(recipe.name, total=recipe.n_tracks)
            try:
                made, path = make_set(recipe, out, partial(on_candidate, shown, recipe.name))
            except ConfigError as error:  # the others may come off
                missing.append(str(error))
                continue
            result[recipe.name] = {"file": str(path), "tracks": len(made.tracks), "sha256": made.sha256}
    text = "\n".join(f"{name}: {at}" for name, at in result.items())
    if missing:
        raise PartialResultError("\n".join(missing), (result, text))
    return result, text


def sort_set(arguments: argparse.Namespace) -> None:
    """Part what --set says: settings of the task (with "="), and the name of a held-out set."""
    arguments.set_task = [text for text in arguments.set if "=" in text]
    named = [text for text in arguments.set if "=" not in text]
    wrong = [text for text in arguments.set_task if not text.startswith("task.")]
    if len(named) > 1 or wrong:
        raise ConfigError(
            f"--set names one held-out set, or settings as task.KEY=VALUE, got {', '.join(named[:3] + wrong)}"
        )
    arguments.set = named[0] if named else None


def evaluate_set(arguments: argparse.Namespace) -> Result:
    """Judge agents on a held-out set; write scores, tables and how every episode ended."""
    from zebrat_bullet.evaluation.endings import Endings
    from zebrat_bullet.evaluation.held_out import SetJudgement, judge_set
    from zebrat_bullet.evaluation.set_episodes import save_set_episodes, set_episodes
    from zebrat_bullet.evaluation.track_set import SetTrack, read_set
    from zebrat_bullet.report.held_out import set_table

    tracks = read_set(arguments.set)
    out = arguments.out = arguments.out or Path("results") / f"set-{tracks.name}{of_engine(arguments)}"
    tasks = {agent: own_task_of(arguments, agent) for agent in arguments.agent}
    how = SetJudgement(
        episodes=arguments.episodes,
        sim=arguments.sim,
        n_tracks=arguments.tracks,
        seed=arguments.seed,
        action_noise=arguments.action_noise,
        supervised_m=arguments.supervised,
        workers=_workers(arguments),
        task=tasks[arguments.agent[0]],
    )
    require_writable(out, folder=True)
    names = file_names(arguments.agent)

    def keep(agent: str, driven: Sequence[SetTrack], endings: Endings) -> None:
        made = set_episodes(agent, tracks.name, arguments.sim, arguments.seed, driven, endings)
        save_set_episodes(made, out / f"episodes-{names[agent]}.npz")

    with progress_bar(arguments) as bar:
        shown = bar.add_task("judging", total=None)
        scores = judge_set(
            arguments.agent,
            tracks,
            how,
            lambda agent, done, total: bar.update(shown, description=f"judging {agent}", completed=done, total=total),
            tasks,
            keep,
        )
    out.mkdir(parents=True, exist_ok=True)
    table, result = set_table(scores), {agent: score.as_dict() for agent, score in scores.items()}
    (out / "scores.json").write_text(json.dumps(result), encoding="utf-8")
    (out / "table.md").write_text(table + "\n", encoding="utf-8")
    return result, f"{table}\n\n{out}"


def evaluate_generated(arguments: argparse.Namespace) -> Result:
    """Judge one agent on generated tracks that were never trained on."""
    from zebrat_bullet.evaluation.generated import judge_generated
    from zebrat_bullet.world import HELD_OUT_SEED

    if len(arguments.agent) != 1:
        raise ConfigError("--generated judges one agent at a time; name one")
    if arguments.supervised is not None:
        raise ConfigError("--generated drives planar cars, without whole scans for --supervised; leave one out")
    (agent,) = arguments.agent
    out = arguments.out = arguments.out or Path("results") / f"generated-{file_name(agent)}{of_engine(arguments)}"
    require_writable(out, folder=True)
    seeds = range(HELD_OUT_SEED, HELD_OUT_SEED + arguments.generated)
    score = judge_generated(
        agent,
        seeds,
        arguments.episodes,
        own_task_of(arguments, agent),
        sim=arguments.sim,
        seed=arguments.seed,
        action_noise=arguments.action_noise,
        workers=_workers(arguments),
    )
    out.mkdir(parents=True, exist_ok=True)
    (out / "generated.json").write_text(json.dumps(score.as_dict()), encoding="utf-8")
    low, high = score.success_ci
    text = (
        f"{score.tracks} tracks x {score.starts} starts: {score.success:.2%} ({low:.2%}-{high:.2%}), worst tenth of "
        f"the tracks {score.worst_tenth:.1%}; {', '.join(f'{n} {name}' for name, n in score.causes.items() if n)}"
    )
    return {name: value for name, value in score.as_dict().items() if name != "by_track"}, f"{text}\n{out}"


def _workers(arguments: argparse.Namespace) -> int:
    return arguments.workers or usable_cores()


def add(command: AddCommand) -> None:
    """Add the command of this file."""
    made = command(sets, workers_option())
    made.add_argument("names", nargs="*", metavar="SET", help="names or files (default: all that are shipped)")
    made.add_argument(
        "--make", action="store_true", help="make them: families of tracks, or reversals-K, into the folder --out"
    )
    made.add_argument("--tracks", type=int, default=1000, help="in each set made (default 1000)")
    made.add_argument(
        "--families", nargs="+", default=["manoeuvres"], help="what reversals-K is drawn from (default manoeuvres)"
    )
    made.add_argument("--most-seeds", type=int, default=20_000, help="tried of each family (default 20000)")
