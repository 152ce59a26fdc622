"""What a sweep is: algorithms x rewards x worlds x seeds, one run folder each, the same for every way of running it."""

import json
import math
from dataclasses import dataclass, fields, replace
from itertools import chain, count, product
from pathlib import Path
from typing import Any

from zebrat_bullet.config import MOST_SEED, within
from zebrat_bullet.config_text import from_json, read_config, to_json, with_overrides
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.files import read_yaml, refusing, shown
from zebrat_bullet.outputs import written_whole
from zebrat_bullet.robot import named_robot
from zebrat_bullet.training.places import car_and_worlds, changed_since, from_any_folder
from zebrat_bullet.training.presets import TRAIN_PRESETS, learner_of, with_task
from zebrat_bullet.training.run_folder import has_checkpoint, is_finished
from zebrat_bullet.training.settings import TrainConfig, require_init
from zebrat_bullet.world import anywhere, parse_reference

AXES = ("algos", "rewards", "worlds", "seeds")
MANIFEST = "manifest.json"
MOST_RUNS = 10_000
OWN = "own"


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A set of runs: every combination of the four axes.

    Attributes:
        algos, rewards: as in `zebrat train`; the reward "own" is the preset's.
        worlds: each run's one training world, a name or a file; none for those of the preset.
        seeds: of the runs.
        preset: one of `TRAIN_PRESETS`; an algorithm other than its own has the paper's networks and parameters.
        robot: the car of all runs, a name or a URDF file.
        set: "key=value" texts that vary every run's settings.
    """

    algos: tuple[str, ...] = ("ddpg",)
    rewards: tuple[str, ...] = ("fomt",)
    worlds: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)
    preset: str = "paper"
    robot: str = "zebrat"
    set: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for axis in AXES:
            values = getattr(self, axis)
            if (not values and axis != "worlds") or len(values) != len(frozenset(values)):
                raise ConfigError(f"{axis} must name at least one, and each once; got {', '.join(map(str, values))!r}")
        if min(self.seeds) < 0:
            raise ConfigError(f"seeds are whole numbers from 0 up, got {min(self.seeds)}")
        within(self, seeds=(0, MOST_SEED))
        n_runs = math.prod(max(len(getattr(self, axis)), 1) for axis in AXES)
        if n_runs > MOST_RUNS:
            raise ConfigError(f"a sweep has at most {MOST_RUNS} runs, these axes make {n_runs}; split it")
        # A worker of the cluster has another working directory.
        object.__setattr__(self, "worlds", tuple(anywhere(world) for world in self.worlds))
        object.__setattr__(self, "robot", named_robot(self.robot))


def read_manifest(path: Path) -> dict[str, Any]:
    """Return the settings of a sweep that a YAML (or JSON) file names.

    Raises:
        ConfigError: it cannot be read, names what no sweep has, or a value is none; the message names the file.
    """
    settings = read_yaml(path, ConfigError)
    known = [field.name for field in fields(Sweep)]
    if not isinstance(settings, dict) or not settings.keys() <= set(known):
        raise ConfigError(f"{path} must hold `key: value` lines with keys of {', '.join(known)}; got {shown(settings)}")
    with refusing(path, ConfigError, "is no sweep", "mend what it names"):
        sweep_of(settings)
    return settings


def sweep_of(settings: dict[str, Any]) -> Sweep:
    """Return the sweep with these settings, the rest as by default.

    Raises:
        ConfigError: a value is of the wrong type or out of its range.
    """
    return from_json(Sweep, json.dumps(settings))


def open_sweep(sweep: Sweep, folder: Path) -> dict[Path, TrainConfig]:
    """Check every run of a sweep, save its manifest in the folder, and return the runs by their folders.

    Nothing is written if anything is wrong. A folder that holds a sweep already goes on if this is the same one or
    has more on its axes.

    Raises:
        ConfigError: a setting is wrong, or the folder holds another sweep.
        ZebratError: a world cannot be driven.
    """
    manifest = folder / MANIFEST
    if manifest.is_file():
        before = read_config(Sweep, manifest)
        _refuse_another(before, sweep, folder)
        # In the order in which they came, for a world's place in it tells the folders of its runs.
        sweep = replace(sweep, worlds=tuple(dict.fromkeys([*before.worlds, *sweep.worlds])))
    runs = runs_of(sweep, folder)
    # Runs of the same worlds differ in nothing else that is read from files.
    files = {worlds: car_and_worlds(config) for worlds, config in {c.worlds: c for c in runs.values()}.items()}
    for run, config in runs.items():
        _refuse_other_settings(run, config, files[config.worlds])
    with written_whole(manifest) as part:
        part.write_text(to_json(sweep), encoding="utf-8")
    return runs


def runs_of(sweep: Sweep, folder: Path) -> dict[Path, TrainConfig]:
    """Return the runs of a sweep by the folders that they would have; nothing is read or written.

    Seed after seed: what is finished when a sweep is stopped can be compared.

    Raises:
        ConfigError: a setting is wrong.
    """
    runs: dict[Path, TrainConfig] = {}
    if sweep.preset not in TRAIN_PRESETS:
        raise ConfigError(f"no preset {sweep.preset!r}; there are {', '.join(TRAIN_PRESETS)}")
    training: list[tuple[str, ...]] = [(world,) for world in sweep.worlds]
    training = training or [TRAIN_PRESETS[sweep.preset].worlds]
    labels = _labels(training)
    for seed, algo, reward, worlds in product(sweep.seeds, sweep.algos, sweep.rewards, training):
        run = folder / f"{algo}-{reward}-{labels[worlds]}-seed{seed}"
        try:
            runs[run] = _run_config(sweep, algo, reward, worlds, seed)
        except ZebratError as error:
            raise ConfigError(f"{run.name}: {error}") from error
    return runs


def sweep_command(sweep: Sweep, folder: str) -> list[str]:
    """Return what `zebrat` is called with for a sweep."""
    return [
        *("sweep", "--algos", *sweep.algos, "--rewards", *sweep.rewards),
        *("--seeds", *map(str, sweep.seeds), "--preset", sweep.preset),
        *(("--set", *sweep.set) if sweep.set else ()),
        *("--out", folder),
    ]


def _labels(training: list[tuple[str, ...]]) -> dict[tuple[str, ...], str]:
    """Return a name for the worlds of each run; of those alike the first keeps it, so that a sweep may grow."""
    made: dict[tuple[str, ...], str] = {}
    for worlds in training:
        plain = "+".join(dict.fromkeys(Path(parse_reference(world).name).stem for world in worlds)) or "generated"
        folders = Path(parse_reference(worlds[0]).name).parent.parts[1:] if worlds else ()
        by_folder = ("-".join([*folders[-depth:], plain]) for depth in range(1, len(folders) + 1))
        by_number = (f"{plain}-{k}" for k in count(2))
        taken = {name.casefold() for name in made.values()}
        made[worlds] = next(name for name in chain([plain], by_folder, by_number) if name.casefold() not in taken)
    return made


def _run_config(sweep: Sweep, algo: str, reward: str, worlds: tuple[str, ...], seed: int) -> TrainConfig:
    named = TRAIN_PRESETS[sweep.preset]
    learner = named.learner if named.learner.algo == algo else learner_of(algo)
    own = None if reward == OWN else reward
    planned = with_task(replace(named, learner=learner, worlds=worlds, seed=seed), sweep.robot, own)
    config = with_overrides(planned, sweep.set)
    if (config.learner.algo, config.worlds, config.seed) != (algo, planned.worlds, seed):
        raise ConfigError(f"set names what is an axis of the sweep; give it as one of {', '.join(AXES)}")
    require_init(config)
    return from_any_folder(config)


def _refuse_another(old: Sweep, new: Sweep, folder: Path) -> None:
    differences = []
    for field in fields(Sweep):
        before, now = getattr(old, field.name), getattr(new, field.name)
        extends = field.name in AXES and set(before) <= set(now)
        if before != now and not extends:
            differences.append(f"{field.name} were {before}, now {now}")
    if differences:
        raise ConfigError(
            f"{folder} holds another sweep: {'; '.join(differences)}. Name another folder, or what the sweep had; "
            f"{', '.join(AXES)} may be added to"
        )


def _refuse_other_settings(run: Path, config: TrainConfig, files: dict[str, Any]) -> None:
    """A run keeps what it was begun with, so one begun with other settings, car or worlds is none of this sweep."""
    if not is_finished(run) and not has_checkpoint(run):
        return
    before = read_config(TrainConfig, run / "config.json")  # has the defaults of settings added since
    names = sorted(field.name for field in fields(TrainConfig))
    differing = [name for name in names if getattr(before, name) != getattr(config, name)]
    if differing:
        raise ConfigError(f"{run} was trained with other settings ({', '.join(differing)}); move it away or name it so")
    if changed := changed_since(run, config.task.robot, files):
        raise ConfigError(
            f"{run} was trained before {', '.join(changed)} changed; put it back as it was, or name another folder"
        )
