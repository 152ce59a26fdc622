"""Where a run of imitation learning drives: DAgger's labels and the noise-free evaluations.

In worlds, a car at a time in PyBullet; where the demonstrations are of generated tracks, on more of these, by planar
cars.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zebrat_bullet.agents import Agent, load_agent
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.endings import planar_endings
from zebrat_bullet.evaluation.judge import record_path
from zebrat_bullet.evaluation.metrics import score
from zebrat_bullet.evaluation.records import load_record, save_record
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.imitation.demonstration import (
    SUFFIX,
    Demonstration,
    read_demonstrations,
    save_demonstrations,
    seed_of,
)
from zebrat_bullet.imitation.demonstrations import labels_path
from zebrat_bullet.imitation.planar_demonstrations import TRACKS_ABREAST, Demonstrating, drive_seeds
from zebrat_bullet.imitation.settings import ImitationConfig
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.training.places import judging_worlds
from zebrat_bullet.training.settings import VALIDATION_SEED
from zebrat_bullet.types import Command, Reading
from zebrat_bullet.world import World, generate_tracks

EVALUATION_SEED = 1_000_000
DAGGER_SEED = 2_000_000
# Who crashes early needs more tracks than these steps say, and then meets some of the last iteration's again.
_LEAST_STEPS = 16


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


class WorldPlaces:
    """The worlds of the demonstrations, in PyBullet."""

    def __init__(self, config: ImitationConfig, given: Sequence[Demonstration]) -> None:
        self._config, task = config, given[0].task
        names = list(dict.fromkeys(demonstration.world for demonstration in given))
        self._worlds = dict(zip(names, judging_worlds(names, task), strict=True))
        self._expert = load_agent(config.expert, task) if config.iterations else None
        self._drive = Drive(task, next(iter(self._worlds.values())))

    def close(self) -> None:
        """End the simulation."""
        self._drive.close()

    def collect(self, learner: PolicyAgent, iteration: int, folder: Path) -> None:
        """Let the learner drive and the expert label; an episode that is on disk already is not driven again."""
        assert self._expert is not None
        agent = MixtureAgent(learner, self._expert, self._config.beta**iteration)
        n_pairs, episode = 0, 0
        while n_pairs < self._config.pairs:
            for name, world in self._worlds.items():
                path = record_path(folder, name, episode, list(self._worlds))
                if not path.exists():
                    self._label(agent, world, iteration, episode, path)
                n_pairs += len(load_record(path).command)
                if n_pairs >= self._config.pairs:
                    break
            episode += 1

    def _label(self, agent: MixtureAgent, world: World, iteration: int, episode: int, path: Path) -> None:
        record = run_episode(self._drive, agent, self._config.seed + DAGGER_SEED + iteration, episode, world)
        path.parent.mkdir(parents=True, exist_ok=True)
        # The labels first: a record without labels would count as a demonstration by the learner itself.
        np.save(labels_path(path), [(label.speed_mps, label.steering_rad) for label in agent.labels])
        save_record(record, path)

    def evaluate(self, agent: PolicyAgent) -> dict[str, float | None]:
        """Judge a policy noise-free in every world of the demonstrations."""
        seed = self._config.seed + EVALUATION_SEED
        result = score(
            [
                run_episode(self._drive, agent, seed, episode, world)
                for world in self._worlds.values()
                for episode in range(self._config.eval_episodes)
            ]
        )
        return {
            "success": result.success,
            "collision": result.collision,
            "fail": result.fail,
            "time_s": result.time_s,
        }


class GeneratedPlaces:
    """More generated tracks of the families of the demonstrations, on planar cars."""

    def __init__(self, config: ImitationConfig, given: Sequence[Demonstration]) -> None:
        self._config, self._task = config, given[0].task
        families = tuple(dict.fromkeys(demonstration.family for demonstration in given))
        self._first_seed = 1 + max(seed_of(demonstration.world) for demonstration in given)
        self._how = None
        if config.iterations:
            self._how = Demonstrating(agent=config.expert, families=families, task=self._task, seed=config.seed)
        seeds = range(VALIDATION_SEED, VALIDATION_SEED + config.eval_tracks)
        self._tracks = list(generate_tracks(seeds, family=families, robot=load_robot(self._task.robot)))

    def close(self) -> None:
        """Do nothing: memory goes with the object."""

    def collect(self, learner: PolicyAgent, iteration: int, folder: Path) -> None:
        """Let the learner drive tracks that nobody has driven, and the oracle label; what is on disk is kept."""
        assert self._how is not None
        stride = TRACKS_ABREAST * (1 + self._config.pairs // (_LEAST_STEPS * TRACKS_ABREAST))
        n_pairs, seed = 0, self._first_seed + (iteration - 1) * stride
        while n_pairs < self._config.pairs:
            if seed + TRACKS_ABREAST > VALIDATION_SEED:
                raise ConfigError(f"no generated tracks are left to drive before seed {VALIDATION_SEED}; ask for fewer")
            path = folder / f"tracks-{seed:06d}{SUFFIX}"
            if not path.exists():
                seeds = range(seed, seed + TRACKS_ABREAST)
                driven = drive_seeds(self._how, seeds, learner, self._config.beta**iteration)
                save_demonstrations(driven.demonstrations, path)
            n_pairs += sum(len(each.labels) for each in read_demonstrations(path))
            seed += TRACKS_ABREAST

    def evaluate(self, agent: PolicyAgent) -> dict[str, float | None]:
        """Judge a policy noise-free on tracks that are neither demonstrated nor held out."""
        endings = planar_endings(agent, self._task, self._tracks, self._config.eval_episodes)
        success, collision = endings.success, endings.outcome == Outcome.COLLISION.code
        return {
            "success": float(success.mean()),
            "collision": float(collision.mean()),
            "fail": float(1.0 - success.mean() - collision.mean()),
            "time_s": float(endings.time_s[success].mean()) if success.any() else None,
        }
