"""How fast this machine is at what a comparison does: each kind of step once, briefly, really run."""

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory

from zebrat_bullet.comparison.gather import reached
from zebrat_bullet.comparison.policies import Place
from zebrat_bullet.comparison.run import call
from zebrat_bullet.comparison.steps import Collisions, Judge, Step, Train
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.files import is_file, read_json
from zebrat_bullet.processes import usable_cores
from zebrat_bullet.robot import load_robot
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep import runs_of, sweep_command
from zebrat_bullet.training.sweep_run import cores_of
from zebrat_bullet.world import generate_tracks

SPEED = "speed.json"
A_POLICY, A_SET, START, CONTACT = "a policy", "a set", "start", "contact"
_MINUTES = 0.1
_WORLD = "track_2"
_SHORT = ("eval_every=1000000", "eval_episodes=1", "task.episode.max_steps=60")
_SHORT_PLANAR = ("planar.n_tracks=50", "planar.n_eval_tracks=4")
_CONTACTS = 6
_TRACKS = 200


def measure(place: Place, to_do: Sequence[Step]) -> dict[str, float]:
    """Measure what the steps to do are made of, and keep it in the comparison's folder; what is there stays.

    Returns:
        By the name of `kind`: steps a second of a training, among as many as run at once, and seconds of processor time
        to draw one of its tracks (`track_kind`); seconds of an episode in track_2 of a driver (`A_POLICY`
        stands for all that are trained), of a process until it drives (`START`), of a set (`A_SET`), and of a contact
        of the collision study (`CONTACT`). What could not be measured is absent.
    """
    path = place.out / SPEED
    speed: dict[str, float] = read_json(path, ConfigError) if is_file(path) else {}
    place.out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix="zebrat-") as scratch:
        for number, step in enumerate(to_do):
            folder = Path(scratch) / str(number)
            for name, value in _measured(place, step, folder, speed).items():
                speed[name] = value
                path.write_text(json.dumps(speed, indent=1), encoding="utf-8")
    return speed


def training_kind(config: TrainConfig) -> str:
    """Return what runs of the same speed have in common."""
    where = "PyBullet" if config.planar is None else f"{config.planar.n_cars} planar cars"
    updates = (
        f", {config.planar.gradient_steps} gradient steps" if config.planar and config.planar.gradient_steps else ""
    )
    return f"train {config.learner.algo}, {where}{updates}"


def track_kind(config: TrainConfig) -> str:
    """Return what trainings whose tracks take as long to draw have in common."""
    return f"a track of {', '.join(sorted(set(config.planar.families)))}" if config.planar else ""


def at_once(config: TrainConfig) -> int:
    """Return how many such trainings run side by side here."""
    return max(usable_cores() // cores_of(config), 1)


def driver_kind(step: Judge) -> str:
    """Return what judgements of the same speed have in common."""
    if step.cell.is_set and step.cell.sim == "planar":
        return A_SET
    return step.cell.agent or A_POLICY


def _measured(place: Place, step: Step, folder: Path, known: dict[str, float]) -> dict[str, float]:
    folder.mkdir()
    log = folder / "log.txt"
    if isinstance(step, Train):
        return _train(step, folder, log, known)
    if isinstance(step, Collisions):
        if CONTACT in known or step.what.events <= _CONTACTS:
            return {}
        began = time.monotonic()
        call(replace(step, folder=folder / "study", what=replace(step.what, events=_CONTACTS)).command(), log)
        return {CONTACT: (time.monotonic() - began) / _CONTACTS}
    assert isinstance(step, Judge)
    kind = driver_kind(step)
    if kind in known:
        return {}
    agent = step.cell.agent if kind not in (A_POLICY, A_SET) else "shipped"
    began, began_file = time.monotonic(), time.time()
    if kind == A_SET:
        tracks = step.place.plan.judgements[step.cell.judgement].tracks or step.how.tracks
        some = ["--tracks", str(tracks)] if tracks else []
        where = ["--set", step.cell.place, *some, "--episodes", str(step.cell.episodes)]
        call(["evaluate", "--agent", agent, *where, "--workers", "1", "--out", str(folder / "judged"), "--quiet"], log)
        return {A_SET: time.monotonic() - began}
    where = ["--worlds", _WORLD, "--episodes", "2", "--workers", "1", *step.how.options]
    call(["evaluate", "--agent", agent, *where, "--out", str(folder / "judged"), "--quiet"], log)
    written = sorted(path.stat().st_mtime for path in (folder / "judged").rglob("*.npz"))
    if len(written) < 2:
        return {}
    episode_s = written[1] - written[0]
    return {kind: episode_s, START: max(written[0] - began_file - episode_s, 0.0)}


def _train(step: Train, folder: Path, log: Path, known: dict[str, float]) -> dict[str, float]:
    found: dict[str, float] = {}
    for config in runs_of(step.sweep, step.folder).values():
        kind = training_kind(config)
        if config.planar and config.planar.n_tracks and track_kind(config) not in known | found:
            found[track_kind(config)] = _drawing_s(config)
        if kind in known or kind in found:
            continue
        reward = step.sweep.rewards[0]
        short = (*_SHORT_PLANAR, *_SHORT[2:]) if config.planar else _SHORT
        settings = (*step.sweep.set, *short, f"max_minutes={_MINUTES}")
        algo = config.learner.algo
        # Runs side by side share the cores' units and caches: one alone would be faster than they are.
        seeds = tuple(range(min(at_once(config), len(step.missing()))))
        brief = replace(step.sweep, algos=(algo,), rewards=(reward,), seeds=seeds, set=settings)
        out = folder / algo
        call([*sweep_command(brief, str(out)), "--workers", str(len(seeds)), "--quiet"], log)
        rates = []
        for run, at in runs_of(brief, out).items():
            try:
                done = reached(run, at)
            except ZebratError:
                continue
            if done.get("wall_s"):
                rates.append(done["steps"] / done["wall_s"])
        if rates:
            found[kind] = fmean(rates)
    return found


def _drawing_s(config: TrainConfig) -> float:
    assert config.planar is not None
    families, difficulty, robot = config.planar.families, config.planar.difficulty, load_robot(config.task.robot)
    n = min(config.planar.n_tracks, _TRACKS)
    began = time.process_time()
    for _ in generate_tracks(range(n), family=families, difficulty=difficulty, robot=robot):
        pass
    return (time.process_time() - began) / n
