"""Imitation learning, from its settings to its folder: behaviour cloning, then DAgger iterations on top of it.

DAgger (Ross, Gordon, Bagnell, AISTATS 2011): the learner drives, the expert says at every state what it would have done
there, and the learner is fitted anew to all that has been gathered. Iteration 0 is plain behaviour cloning.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from zebrat_bullet.agents import Agent, load_agent
from zebrat_bullet.agents.policy import PolicyAgent, load_policy, save_policy
from zebrat_bullet.config import MOST_SEED, TaskConfig, within
from zebrat_bullet.config_text import from_json, read_config, to_json
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.evaluation.judge import record_path
from zebrat_bullet.evaluation.metrics import Score, score
from zebrat_bullet.evaluation.records import load_record, save_record
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.files import refusing
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.training.cloning import Clone, CloneConfig, clone
from zebrat_bullet.training.demonstrations import encode_pairs, labels_path, load_demonstrations, observation_of
from zebrat_bullet.training.logs import rank
from zebrat_bullet.training.places import judging_worlds
from zebrat_bullet.training.run import run_versions
from zebrat_bullet.types import Command, Reading
from zebrat_bullet.world import World

ITERATION_COLUMNS = (
    "iteration", "pairs", "best_epoch", "train_loss", "held_out_loss", "success", "collision", "fail", "time_s", "best",
)  # fmt: skip
EVALUATION_SEED = 1_000_000
DAGGER_SEED = 2_000_000


@dataclass(frozen=True, kw_only=True)
class ImitationConfig:
    """One run of imitation learning.

    Attributes:
        demonstrations: folder of episode records, or a zip archive of one.
        iterations: DAgger iterations after behaviour cloning; 0 is the paper's imitation learning.
        expert: who labels in DAgger: an agent's name, policy file or run folder.
        beta: in iteration i the expert drives a step with probability beta ** i, else the learner.
        pairs: states to label in each iteration; the last episode is driven to its end.
        eval_episodes: noise-free episodes in each world that choose the best iteration.
        clone: how the network is fitted.
        seed: of the network, the start poses and of who drives a step.
    """

    demonstrations: str
    iterations: int = 0
    expert: str = ""
    beta: float = 0.5
    pairs: int = 2000
    eval_episodes: int = 5
    clone: CloneConfig = field(default_factory=CloneConfig)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.iterations < 0 or self.pairs < 1 or self.eval_episodes < 1:
            raise ConfigError("iterations must be at least 0, pairs and eval_episodes at least 1")
        if self.iterations and not self.expert:
            raise ConfigError("DAgger needs an expert that labels what the learner meets: name one with --expert")
        within(self, iterations=(0, 1000), pairs=(1, 10**8), eval_episodes=(1, 10_000), seed=(0, MOST_SEED))
        if not 0 <= self.beta <= 1:
            raise ConfigError(f"beta is a probability, got {self.beta}")


class MixtureAgent:
    """Who drives in DAgger: the expert with probability beta at each step, else the learner; the expert labels all.

    Attributes:
        labels: the expert's command at each step of this episode.
    """

    def __init__(self, learner: Agent, expert: Agent, beta: float) -> None:
        self.name = f"{learner.name}+{expert.name}"
        self.privileged = learner.privileged | expert.privileged
        self._learner, self._expert, self._beta = learner, expert, beta
        self.labels: list[Command] = []

    def reset(self, seed: int) -> None:
        """Reset both and seed the choice between them."""
        self._learner.reset(seed)
        self._expert.reset(seed)
        self._rng = np.random.default_rng(seed)
        self.labels = []

    def act(self, reading: Reading) -> Command:
        """Return the expert's or the learner's command; the expert's is kept as the label."""
        self.labels.append(self._expert.act(reading))
        command = self._learner.act(reading)
        return self.labels[-1] if self._rng.random() < self._beta else command


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
    (folder / "config.json").write_text(to_json(config))
    (folder / "versions.json").write_text(json.dumps(run_versions(), indent=2))
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
        first = self._given[0].record
        self._observation = observation_of(first)
        self._task = from_json(TaskConfig, first.task)
        names = dict.fromkeys(demonstration.record.world for demonstration in self._given)
        self._worlds = dict(zip(names, judging_worlds(list(names), self._task), strict=True))
        self._expert = load_agent(config.expert, self._task) if config.iterations else None

    def drive_on(self) -> None:
        log = CsvLog(self._folder / "iterations.csv", ITERATION_COLUMNS)
        drive = Drive(self._task, next(iter(self._worlds.values())))
        for iteration in range(len(log.rows()), self._config.iterations + 1):
            if iteration:
                self._collect(drive, iteration)
            fitted, n_pairs = self._fit(iteration)
            result = self._evaluate(drive, fitted.agent)
            best = all(rank(result.as_dict()) > rank(row) for row in iterations(self._folder))
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
                    "success": result.success,
                    "collision": result.collision,
                    "fail": result.fail,
                    "time_s": result.time_s,
                    "best": int(best),
                }
            )
            self._note(
                f"iteration {iteration}: {n_pairs} pairs, held-out loss {held_out_loss:.4f}, "
                f"noise-free success {result.success:.0%}"
            )
        drive.close()

    def _iteration_folder(self, iteration: int) -> Path:
        return self._folder / f"iteration_{iteration}"

    def _policy_path(self, iteration: int) -> Path:
        return self._iteration_folder(iteration) / "policy.safetensors"

    def _collect(self, drive: Drive, iteration: int) -> None:
        """Let the last learner drive and the expert label; an episode that is on disk already is not driven again."""
        assert self._expert is not None
        learner = load_policy(str(self._policy_path(iteration - 1)))
        agent = MixtureAgent(learner, self._expert, self._config.beta**iteration)
        n_pairs, episode = 0, 0
        while n_pairs < self._config.pairs:
            for name, world in self._worlds.items():
                path = record_path(self._iteration_folder(iteration) / "records", name, episode, list(self._worlds))
                if not path.exists():
                    self._label(drive, agent, world, iteration, episode, path)
                n_pairs += len(load_record(path).command)
                if n_pairs >= self._config.pairs:
                    break
            episode += 1

    def _label(self, drive: Drive, agent: MixtureAgent, world: World, iteration: int, episode: int, path: Path) -> None:
        record = run_episode(drive, agent, self._config.seed + DAGGER_SEED + iteration, episode, world)
        path.parent.mkdir(parents=True, exist_ok=True)
        # The labels first: a record without labels would count as a demonstration by the learner itself.
        np.save(labels_path(path), [(label.speed_mps, label.steering_rad) for label in agent.labels])
        save_record(record, path)

    def _fit(self, iteration: int) -> tuple[Clone, int]:
        """Fit a new network to the demonstrations and all labels up to this iteration."""
        gathered = list(self._given)
        for i in range(1, iteration + 1):
            gathered += load_demonstrations(self._iteration_folder(i) / "records")
        pairs = encode_pairs(gathered, self._observation)
        provenance = {"config": json.loads(to_json(self._config)), "iteration": iteration} | run_versions()
        return clone(pairs, self._observation, self._config.clone, self._config.seed, provenance), len(pairs.actions)

    def _evaluate(self, drive: Drive, agent: PolicyAgent) -> Score:
        """Judge a policy noise-free in every world of the demonstrations."""
        seed = self._config.seed + EVALUATION_SEED
        return score(
            [
                run_episode(drive, agent, seed, episode, world)
                for world in self._worlds.values()
                for episode in range(self._config.eval_episodes)
            ]
        )
