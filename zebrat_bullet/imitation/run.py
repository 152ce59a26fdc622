"""Imitation learning, from its settings to its folder: behaviour cloning, then DAgger iterations on top of it.

DAgger (Ross, Gordon, Bagnell, AISTATS 2011): the learner drives, the expert says at every state what it would have done
there, and the learner is fitted anew to all that has been gathered. Iteration 0 is plain behaviour cloning.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from zebrat_bullet.agents.policy import load_policy, save_policy
from zebrat_bullet.config_text import read_config, to_json
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.files import refusing
from zebrat_bullet.imitation.cloning import Clone, clone
from zebrat_bullet.imitation.demonstrations import encode_pairs, load_demonstrations, observation_of
from zebrat_bullet.imitation.places import GeneratedPlaces, WorldPlaces
from zebrat_bullet.imitation.settings import ImitationConfig
from zebrat_bullet.training.logs import rank
from zebrat_bullet.training.run import run_versions

ITERATION_COLUMNS = (
    "iteration", "pairs", "best_epoch", "train_loss", "held_out_loss", "success", "collision", "fail", "time_s", "best",
)  # fmt: skip


def imitate(config: ImitationConfig, folder: Path, on_progress: Callable[[str], None] = lambda note: None) -> None:
    """Learn from demonstrations, from the beginning.

    Args:
        config: the run.
        folder: where its results go; must not hold another run.
        on_progress: told what was done, in words.

    Raises:
        ConfigError: the folder holds a run already, or there is nothing to imitate.
        AssetError: there is no such expert.
    """
    if (folder / "config.json").exists():
        raise ConfigError(f"{folder} holds a run already; continue it with --resume or name another folder")
    run = _Run(config, folder, on_progress)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(to_json(config), encoding="utf-8")
    (folder / "versions.json").write_text(json.dumps(run_versions(), indent=2), encoding="utf-8")
    run.drive_on()


def resume_imitation(folder: Path, on_progress: Callable[[str], None] = lambda note: None) -> None:
    """Continue a killed run; every finished iteration and every labelled episode is kept.

    Raises:
        ConfigError: the folder holds no run.
    """
    if not (folder / "config.json").is_file():
        raise ConfigError(f"{folder} holds no run (no config.json); name the folder given to `zebrat imitate`")
    _Run(read_config(ImitationConfig, folder / "config.json"), folder, on_progress).drive_on()


def iterations(folder: Path) -> list[dict[str, float | None]]:
    """Return what every finished iteration of a run came to, by column; `time_s` is None where nothing succeeded."""
    path = folder / "iterations.csv"
    with refusing(path, ZebratError, "is not the log of this run", "restore it, or begin the run anew"):
        rows = CsvLog(path, ITERATION_COLUMNS).rows()
        return [{name: float(value) if value else None for name, value in row.items()} for row in rows]


class _Run:
    """A run whose whole state is its folder: an iteration is finished when its row is written."""

    def __init__(self, config: ImitationConfig, folder: Path, on_progress: Callable[[str], None]) -> None:
        self._config, self._folder, self._note = config, folder, on_progress
        self._given = load_demonstrations(Path(config.demonstrations))
        self._observation = observation_of(self._given[0], config.clone.log_gaps)
        generated = {bool(demonstration.family) for demonstration in self._given}
        if len(generated) > 1:
            raise ConfigError(f"{config.demonstrations}: some are of generated tracks, some of worlds; keep one kind")
        self._places = GeneratedPlaces(config, self._given) if True in generated else WorldPlaces(config, self._given)

    def drive_on(self) -> None:
        log = CsvLog(self._folder / "iterations.csv", ITERATION_COLUMNS)
        for iteration in range(len(log.rows()), self._config.iterations + 1):
            if iteration:
                learner = load_policy(str(self._policy_path(iteration - 1)))
                self._places.collect(learner, iteration, self._iteration_folder(iteration) / "records")
            fitted, n_pairs = self._fit(iteration)
            result = self._places.evaluate(fitted.agent)
            best = all(rank(result) > rank(row) for row in iterations(self._folder))
            self._iteration_folder(iteration).mkdir(exist_ok=True)
            save_policy(fitted.agent, self._policy_path(iteration))
            if best:
                shutil.copyfile(self._policy_path(iteration), self._folder / "best.safetensors")
            train_loss, held_out_loss = fitted.losses[fitted.best_epoch].round(6)
            log.append(
                {
                    "iteration": iteration,
                    "pairs": n_pairs,
                    "best_epoch": fitted.best_epoch + 1,
                    "train_loss": train_loss,
                    "held_out_loss": held_out_loss,
                    **result,
                    "best": int(best),
                }
            )
            self._note(
                f"iteration {iteration}: {n_pairs} pairs, held-out loss {held_out_loss:.4f}, "
                f"noise-free success {result['success']:.0%}"
            )
        self._places.close()

    def _iteration_folder(self, iteration: int) -> Path:
        return self._folder / f"iteration_{iteration}"

    def _policy_path(self, iteration: int) -> Path:
        return self._iteration_folder(iteration) / "policy.safetensors"

    def _fit(self, iteration: int) -> tuple[Clone, int]:
        """Fit a new network to the demonstrations and all labels up to this iteration."""
        gathered = list(self._given)
        for i in range(1, iteration + 1):
            gathered += load_demonstrations(self._iteration_folder(i) / "records")
        pairs = encode_pairs(gathered, self._observation)
        config = json.loads(to_json(self._config)) | {"task": json.loads(to_json(self._given[0].task))}
        provenance = {"config": config, "iteration": iteration} | run_versions()
        return clone(pairs, self._observation, self._config.clone, self._config.seed, provenance), len(pairs.actions)
