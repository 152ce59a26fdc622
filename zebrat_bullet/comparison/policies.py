"""What the runs of a training have become, here or in what is kept of them, and which of their policies is best."""

import atexit
import hashlib
import shlex
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

from zebrat_bullet.comparison.manifest import Budget, Manifest
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.files import refusing
from zebrat_bullet.training.archive import as_folder
from zebrat_bullet.training.logs import rank
from zebrat_bullet.training.run_folder import POLICY_FILES, evaluations, is_finished
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep import Sweep, runs_of, sweep_command

OUT = Path("runs/comparison")
"""Where a comparison is, as tables and commands name it, wherever it really is."""
POLICY, MODEL = POLICY_FILES
EPISODES = "episodes.csv"


@dataclass(frozen=True, kw_only=True)
class Place:
    """A manifest and a budget of it, in a folder.

    Attributes:
        manifest, budget: what is done; `budget` is its name.
        out: the folder.
        checkout: where the paths in the manifest begin.
    """

    manifest: Manifest
    budget: str
    out: Path
    checkout: Path
    _runs: dict[str, dict[Path, TrainConfig]] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def plan(self) -> Budget:
        """What the budget does."""
        return self.manifest.budget(self.budget)

    def portable(self, path: Path) -> str:
        """Return a path as tables have it: from where `zebrat` is called with the default folder."""
        for base, name in ((self.out, OUT), (self.checkout, Path())):
            if path.is_relative_to(base):
                return str(name / path.relative_to(base))
        return str(path)

    @property
    def records(self) -> Path | None:
        """Where judged episodes are kept; None where all are to be driven.

        Raises:
            ConfigError: the folder is not there.
        """
        if not (named := self.plan.records):
            return None
        folder = self.checkout / named
        if not folder.is_dir():
            where = f"budgets.{self.budget}.records"
            raise ConfigError(f"{where} names {named}, which is not there; run it in the checkout, or correct the name")
        return folder

    def training_folder(self, name: str) -> Path:
        """Return where the runs of a training are; those that a budget cuts short are no one else's."""
        return self.out / "training" / (f"{name}-{self.budget}" if self.is_cut_short(name) else name)

    def run_name(self, run: Path) -> str:
        """Return the name of a run in the tables."""
        return str(run.relative_to(self.out / "training"))

    def sweeps(self, name: str, more_seeds: Sequence[int] = ()) -> dict[Path, Sweep]:
        """Return the sweeps of a training by their folders: one, or one for each model that is begun with.

        Args:
            name: of the training.
            more_seeds: beside the budget's; of a training that it does not run, beside those that are kept.

        Raises:
            ConfigError: a setting is wrong; the message names the training.
        """
        training, folder = self.manifest.trainings[name], self.training_folder(name)
        settings = (*training.set, *self.plan.trainings.get(name, ()))
        kept = () if name in self.plan.trainings else training.kept_seeds
        seeds = kept or training.seeds_of(self.plan.seeds)
        with refusing(f"trainings.{name}", ConfigError, "cannot be run", "mend the manifest"):
            whole = Sweep(
                algos=training.algos,
                rewards=training.rewards,
                seeds=tuple(sorted({*seeds, *more_seeds})),
                preset=training.preset,
                set=settings,
            )
            if not training.init:
                return {folder: whole}
            pairs = [(algo, reward) for algo in training.algos for reward in training.rewards]
            return {folder / f"{a}-{r}": replace(whole, algos=(a,), rewards=(r,)) for a, r in pairs}

    def runs(self, name: str) -> dict[Path, TrainConfig]:
        """Return the runs of a training by their folders: the budget's, and those that are kept.

        They lack the models that they begin with.
        """
        if name not in self._runs:
            kept = () if self.is_cut_short(name) else self.manifest.trainings[name].kept_seeds
            with refusing(f"trainings.{name}", ConfigError, "cannot be run", "mend the manifest"):
                sweeps = self.sweeps(name, kept).items()
                self._runs[name] = {run: at for folder, sweep in sweeps for run, at in runs_of(sweep, folder).items()}
        return self._runs[name]

    def is_cut_short(self, name: str) -> bool:
        """Return whether the budget runs less of a training than the manifest asks for."""
        return bool(self.plan.trainings.get(name))

    def kept_policy(self, name: str, run: Path) -> Path | None:
        """Return the policy of a kept run; None where only its logs are kept."""
        folder = self.manifest.trainings[name].policies
        policy = self.checkout / folder / f"{run.name}.safetensors"
        return policy if folder and policy.is_file() else None

    def readable_runs(self, name: str) -> dict[Path, Path]:
        """Return where each run of a training in this budget can be read: there, or in what is kept of it.

        A finished one goes before one that is not, and one of this folder before a kept one.
        """
        training, runs = self.manifest.trainings[name], list(self.runs(name))
        if not training.kept or self.is_cut_short(name):
            return {run: run for run in runs}
        kept = self.checkout / training.kept
        if not kept.exists():
            where = f"trainings.{name}.kept"
            raise ConfigError(
                f"{where} names {training.kept}, which is not there; run it in the checkout, or correct the name"
            )
        folder = _unpacked(kept)
        return {run: min((run, folder / run.name), key=_how_far) for run in runs}


@cache
def _unpacked(kept: Path) -> Path:
    """Return a folder of kept runs; an archive is unpacked once, until this process ends."""
    opened = ExitStack()
    atexit.register(opened.close)
    return opened.enter_context(as_folder(kept))


def _how_far(run: Path) -> int:
    return 0 if is_finished(run) else 1 if (run / EPISODES).is_file() else 2


def best_policy(place: Place, name: str, algo: str, reward: str, seed: int | None = None) -> Path:
    """Return the policy of a training to be judged: the best of its seeds by their own evaluations, or of one seed.

    Runs that are not finished have none: they would stand beside others that had more time.

    Raises:
        ConfigError: there is none; the message says what to run.
    """
    configs = place.runs(name)
    found: list[tuple[tuple[float, float, float], str, Path]] = []
    for run, readable in place.readable_runs(name).items():
        policy = run / POLICY if readable == run else place.kept_policy(name, run)
        wanted = who_of(run, configs[run]) == (algo, reward) and seed in (None, configs[run].seed)
        if wanted and policy is not None and policy.is_file() and is_finished(readable):
            found.append((best_rank(readable), run.name, policy))
    if not found:
        which = f"{algo} under {reward}" + ("" if seed is None else f", seed {seed}")
        raise ConfigError(f"training {name!r} has no policy of {which} yet; its runs come first")
    return max(sorted(found, key=lambda one: one[1]), key=lambda one: one[0])[2]  # the first of equals


def best_run(place: Place, name: str, algo: str, reward: str) -> Path:
    """Return the run whose best policy a fine-tuning begins with: of all finished ones, here or kept, the best.

    Raises:
        ConfigError: none is finished.
    """
    configs = place.runs(name)
    finished = {
        run: readable
        for run, readable in place.readable_runs(name).items()
        if who_of(run, configs[run]) == (algo, reward) and is_finished(readable)
    }
    if not finished:
        raise ConfigError(f"training {name!r} has no model of {algo} under {reward} to begin with: its runs come first")
    return max(sorted(finished), key=lambda run: best_rank(finished[run]))  # the first of equals


def best_model(place: Place, name: str, algo: str, reward: str) -> Path:
    """Return the model of `best_run`.

    Raises:
        ConfigError: no run is finished, or the best one is not here: of kept runs there are logs and policies alone.
    """
    run = best_run(place, name, algo, reward)
    if not ((run / MODEL).is_file() and is_finished(run)):
        seeds = (place.runs(name)[run].seed,)
        again = replace(place.sweeps(name)[run.parent], algos=(algo,), rewards=(reward,), seeds=seeds)
        raise ConfigError(
            f"fine-tuning {algo} under {reward} begins with {MODEL} of {place.run_name(run)}, of which logs and policy "
            f"alone are kept; drive it again: {shlex.join(['zebrat', *sweep_command(again, str(run.parent))])}"
        )
    return run / MODEL


def best_rank(run: Path) -> tuple[float, float, float]:
    """Return the rank of a run's best policy by its own noise-free evaluations."""
    with refusing(run, ZebratError, "its evaluations are not those of a run", "move the folder away"):
        return max(rank(row) for row in evaluations(run))


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def who_of(run: Path, config: TrainConfig) -> tuple[str, str]:
    """Return algorithm and reward of a run.

    The reward is that in its folder's name, ALGO-REWARD-WORLDS-seedK: its settings may be of no preset.
    """
    algo = config.learner.algo
    return algo, run.name.removeprefix(f"{algo}-").partition("-")[0]


def runs_by_policy(place: Place) -> dict[str, str]:
    """Return the name of the run that each policy is of, by the policy's portable path."""
    found: dict[str, str] = {}
    for name in place.manifest.trainings:
        for run in place.runs(name):
            found[place.portable(run / POLICY)] = place.run_name(run)
            if kept := place.kept_policy(name, run):
                found[place.portable(kept)] = place.run_name(run)
    return found
