"""What happens beside the learning: the episode log, noise-free evaluation, checkpoints, progress, the end."""

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback

from zebrat_bullet.agents.policy import save_policy
from zebrat_bullet.errors import SimulationError
from zebrat_bullet.evaluation.metrics import Score, score
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.observation import ObservationSpec
from zebrat_bullet.training.checkpoint import save_checkpoint
from zebrat_bullet.training.ddpg import PaperDDPG, actor_to_agent
from zebrat_bullet.training.logs import EPISODE_COLUMNS, EVALUATION_COLUMNS, CsvLog
from zebrat_bullet.training.presets import TrainConfig
from zebrat_bullet.world import World

RECENT = 20


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a run stands: finished episodes of all, steps a second, success rate of the last episodes."""

    episode: int
    n_episodes: int
    steps_per_s: float
    recent_success: float
    best_success: float
    epsilon: float


def rank(result: Score) -> tuple[float, float, float]:
    """Return the order in which policies are better: success, then collisions, then time."""
    return result.success, -result.collision, -(result.time_s if result.time_s is not None else math.inf)


class RunCallback(BaseCallback):
    """Watches a run. Work that needs a consistent learner waits for the start of the next rollout.

    Args:
        config: the run.
        folder: where it writes.
        judge: the drive that noise-free evaluations use, never the training environments.
        eval_worlds: where they take place.
        observation: how the exported policy encodes readings.
        provenance: what an exported policy says of its origin.
        on_progress: told after every episode.
        state: episodes begun, steps, wall time and best rank of a resumed run; empty for a new one.
    """

    def __init__(
        self,
        config: TrainConfig,
        folder: Path,
        judge: Drive,
        eval_worlds: list[World],
        observation: ObservationSpec,
        provenance: dict[str, object],
        on_progress: Callable[[Progress], None],
        state: dict[str, Any],
    ) -> None:
        super().__init__()
        self._config, self._folder, self._judge, self._eval_worlds = config, folder, judge, eval_worlds
        self._observation, self._provenance, self._on_progress = observation, provenance, on_progress
        self._episode = state.get("episode", 0)
        self._best = tuple(state["best"]) if state.get("best") else None
        self._wall_before = state.get("wall_s", 0.0)
        self._recent: deque[bool] = deque(maxlen=RECENT)
        self._episodes = CsvLog(folder / "episodes.csv", EPISODE_COLUMNS)
        self._evaluations = CsvLog(folder / "evaluations.csv", EVALUATION_COLUMNS)
        for log in (self._episodes, self._evaluations):
            log.cut_after(self._episode)
        self._due: set[str] = set()
        self._evaluated_at = -1

    def _on_training_start(self) -> None:
        self._began = time.monotonic()
        self._first_step = self.num_timesteps

    def _on_step(self) -> bool:
        for i, info in enumerate(self.locals["infos"]):
            if "outcome" in info:
                self._finish_episode(i, info)
        return self._episode < self._config.episodes and not self._out_of_time()

    def _on_rollout_start(self) -> None:
        """Evaluate and save here: the transition is stored, the gradient step done, the next episode begun."""
        if "evaluation" in self._due:
            self._evaluate()
        if "checkpoint" in self._due:
            self.save()
        self._due.clear()

    def _on_training_end(self) -> None:
        if self._evaluated_at != self._episode:
            self._evaluate()
        self.save()

    def save(self) -> None:
        """Write the last policy and a checkpoint."""
        save_policy(self._agent("last"), self._folder / "last.safetensors")
        state = {
            "episode": self._episode,
            "best": self._best,
            "wall_s": self._wall_s(),
            "begun": self.training_env.get_attr("n_episodes"),
        }
        save_checkpoint(self._folder / "checkpoint", self._learner, state)

    @property
    def _learner(self) -> PaperDDPG:
        assert isinstance(self.model, PaperDDPG)
        return self.model

    def _wall_s(self) -> float:
        return self._wall_before + time.monotonic() - self._began

    def _out_of_time(self) -> bool:
        limit = self._config.max_minutes
        return limit is not None and self._wall_s() > 60.0 * limit

    def _finish_episode(self, env: int, info: dict[str, Any]) -> None:
        self._episode += 1
        self._recent.append(info["is_success"])
        self._episodes.append(
            {
                "episode": self._episode,
                "total_steps": self.num_timesteps,
                "wall_s": round(self._wall_s(), 2),
                "env": env,
                "world": info["world"],
                "outcome": info["outcome"],
                "return": round(info["episode"]["r"], 3),
                "steps": info["episode"]["l"],
                "epsilon": round(self._learner.epsilon, 4),
            }
        )
        self.logger.record("episode/outcome_success", float(info["is_success"]))
        if self._episode % self._config.eval_every == 0:
            self._due.add("evaluation")
        if self._episode % self._config.checkpoint_every == 0:
            self._due.add("checkpoint")
        elapsed = max(time.monotonic() - self._began, 1e-9)
        self._on_progress(
            Progress(
                self._episode,
                self._config.episodes,
                (self.num_timesteps - self._first_step) / elapsed,
                sum(self._recent) / len(self._recent),
                self._best[0] if self._best else 0.0,
                self._learner.epsilon,
            )
        )

    def _agent(self, name: str) -> Any:
        provenance = self._provenance | {"episodes": self._episode, "total_steps": self.num_timesteps}
        return actor_to_agent(self._learner, name, self._observation, provenance)

    def _evaluate(self) -> None:
        self._refuse_non_finite()
        self._evaluated_at = self._episode
        agent = self._agent("best")
        records = [
            run_episode(self._judge, agent, self._config.seed + 1_000_000, episode, world)
            for world in self._eval_worlds
            for episode in range(self._config.eval_episodes)
        ]
        result = score(records)
        better = self._best is None or rank(result) > self._best
        if better:
            self._best = rank(result)
            save_policy(agent, self._folder / "best.safetensors")
            self._learner.save(self._folder / "best.zip")
        row = {name: getattr(result, name) for name in ("success", "collision", "fail", "time_s")}
        where = {"episode": self._episode, "total_steps": self.num_timesteps, "wall_s": round(self._wall_s(), 2)}
        self._evaluations.append(where | row | {"best": int(better)})
        self.logger.record("evaluation/success", result.success)
        self.logger.record("evaluation/collision", result.collision)

    def _refuse_non_finite(self) -> None:
        parameters = [*self._learner.actor.parameters(), *self._learner.critic.parameters()]
        if all(torch.isfinite(parameter).all() for parameter in parameters):
            return
        self._learner.save(self._folder / "non_finite.zip")
        raise SimulationError(
            f"a network weight is not finite after episode {self._episode}; the learner was saved as "
            f"{self._folder / 'non_finite.zip'}; resume from the checkpoint with lower learning rates"
        )
