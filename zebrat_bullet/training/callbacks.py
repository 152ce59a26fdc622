"""What happens beside the learning: episode log, noise-free evaluation, watchdog, checkpoints, progress, the end."""

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from zebrat_bullet.agents.policy import PolicyAgent, save_policy
from zebrat_bullet.errors import SimulationError
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.evaluation.metrics import score
from zebrat_bullet.evaluation.records import EpisodeRecord, save_record
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.observation import ObservationSpec
from zebrat_bullet.training.checkpoint import save_checkpoint
from zebrat_bullet.training.learners import critic_values, exploration
from zebrat_bullet.training.logs import EPISODE_COLUMNS, EVALUATION_COLUMNS, rank
from zebrat_bullet.training.networks import to_agent
from zebrat_bullet.training.ppo import RunPPO
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.watchdog import WATCHDOG_COLUMNS, CriticProbe, Finding, Watchdog
from zebrat_bullet.world import World

RECENT = 20
EVALUATION_SEED = 1_000_000
N_PROBES, PROBE_EVERY = 64, 4
logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a run stands: how much is done of all, steps a second, success rate of the last episodes."""

    done: int
    total: int
    steps_per_s: float
    recent_success: float
    best_success: float


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
        state: what the checkpoint of a resumed run says; empty for a new one.
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
        self._findings = CsvLog(folder / "watchdog.csv", WATCHDOG_COLUMNS)
        for log in (self._episodes, self._evaluations, self._findings):
            log.cut_after(self._episode)
        self._watchdog = Watchdog(config.watchdog, state.get("watchdog"))
        self._probes: list[list[float]] = state.get("probes", [])
        self._good_enough = False
        # What a fine-tuning begins with is judged, and kept unless something no worse is found.
        self._due: set[str] = {"evaluation", "checkpoint"} if config.init and not state else set()
        self._evaluated_at = -1

    def _on_training_start(self) -> None:
        self._began = time.monotonic()
        self._first_step = self.num_timesteps

    def _on_step(self) -> bool:
        if len(self._probes) < N_PROBES and self.n_calls % PROBE_EVERY == 0:
            self._probes.append(self.locals["new_obs"][0].tolist())
        for i, info in enumerate(self.locals["infos"]):
            if info["outcome"]:
                self._finish_episode(i, info)
        return self._share_done() < 1.0 and not self._good_enough

    def _on_rollout_start(self) -> None:
        """Evaluate and save here, where nothing is under way: the learner has stored what the last actions did."""
        if isinstance(self.model, RunPPO):
            self.model.share_done = min(self._share_done(), 1.0)
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
            "places": self.training_env.env_method("place"),
            "watchdog": self._watchdog.state(),
            "probes": self._probes,
        }
        save_checkpoint(self._folder / "checkpoint", self.model, state)

    def _wall_s(self) -> float:
        return self._wall_before + time.monotonic() - self._began

    def _share_done(self) -> float:
        """Return how much of the run is over, by whichever of its limits is nearest."""
        config = self._config
        steps = self.num_timesteps / config.steps if config.steps else 0.0
        time = self._wall_s() / (60.0 * config.max_minutes) if config.max_minutes else 0.0
        return max(self._episode / config.episodes, steps, time)

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
                "epsilon": "" if (epsilon := exploration(self.model)) is None else round(epsilon, 4),
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
            )
        )

    def _agent(self, name: str) -> PolicyAgent:
        provenance = self._provenance | {"episodes": self._episode, "total_steps": self.num_timesteps}
        return to_agent(self.model, name, self._observation, provenance)

    def _evaluate(self) -> None:
        refuse_non_finite(self.model, self._folder, f"episode {self._episode}")
        self._evaluated_at = self._episode
        agent = self._agent("best")
        records = [
            run_episode(self._judge, agent, self._config.seed + EVALUATION_SEED, episode, world)
            for world in self._eval_worlds
            for episode in range(self._config.eval_episodes)
        ]
        result = score(records)
        reached = rank(result.as_dict())
        best = self._best is None or reached >= self._best  # of equals, the longer trained
        if best:
            self._best = reached
            save_policy(agent, self._folder / "best.safetensors")
            self.model.save(self._folder / "best.zip")
        self._good_enough = self._config.stop_at is not None and result.success >= self._config.stop_at
        where = {"episode": self._episode, "total_steps": self.num_timesteps, "wall_s": round(self._wall_s(), 2)}
        row = {name: getattr(result, name) for name in ("success", "collision", "fail", "time_s")}
        self._evaluations.append(where | row | {"best": int(best)})
        self.logger.record("evaluation/success", result.success)
        self.logger.record("evaluation/collision", result.collision)
        self._watch(records)

    def _watch(self, records: list[EpisodeRecord]) -> None:
        """Name a collapse in the log, with the episode that shows it."""
        probe = None
        if len(self._probes) == N_PROBES:
            probe = CriticProbe(critic_values(self.model, np.array(self._probes, dtype=np.float32)))
        for finding in self._watchdog.examine(records, probe, min(self._share_done(), 1.0)):
            self._findings.append(finding.row(self._episode))
            if finding == self._watchdog.confirmed:
                self._show(finding)

    def _show(self, finding: Finding) -> None:
        """Keep the first episode that shows a lasting collapse, and say where it is."""
        folder = self._folder / "collapse"
        folder.mkdir(exist_ok=True)
        if any(folder.glob(f"*_{finding.name}.npz")):
            return
        path = folder / f"episode_{self._episode:05d}_{finding.name}.npz"
        save_record(finding.record, path)
        logger.warning(
            "after episode %d: %s: %s; `zebrat replay %s` shows it",
            *(self._episode, finding.name, finding.measured, path),
        )


def refuse_non_finite(model: BaseAlgorithm, folder: Path, after: str) -> None:
    """Raise where a network weight is not finite; the learner is saved first.

    Raises:
        SimulationError: one is.
    """
    if all(torch.isfinite(parameter).all() for parameter in model.policy.parameters()):
        return
    model.save(folder / "non_finite.zip")
    raise SimulationError(
        f"a network weight is not finite after {after}; the learner was saved as {folder / 'non_finite.zip'}; "
        "train anew with lower learning rates"
    )
