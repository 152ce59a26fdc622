"""What happens beside the learning on planar cars: episode log, evaluation, checkpoints, progress, the end."""

import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from zebrat_bullet.agents.policy import PolicyAgent, save_policy
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.planar.trial import drive_out
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.training.callbacks import Progress, refuse_non_finite
from zebrat_bullet.training.checkpoint import save_checkpoint
from zebrat_bullet.training.logs import EPISODE_COLUMNS, EVALUATION_COLUMNS, rank
from zebrat_bullet.training.networks import to_agent
from zebrat_bullet.training.planar_vec_env import PlanarVecEnv
from zebrat_bullet.training.ppo import RunPPO
from zebrat_bullet.training.settings import PlanarConfig, TrainConfig

LOGGED_CARS = 4
FORGET = 0.1
"""How much of a track's success the latest episode there is."""
RECENT = 2000


class PlanarCallback(BaseCallback):
    """Watches a run on planar cars; evaluates and saves between two rollouts.

    `episodes.csv` holds the episodes of the first `LOGGED_CARS` cars: all of them would be hundreds of thousands.

    Args:
        config: the run.
        planar: its planar part.
        folder: where it writes.
        cars: the cars that learn.
        judge: cars in the validation worlds, one for each episode of an evaluation.
        provenance: what an exported policy says of its origin.
        on_progress: told after every rollout.
        state: what the checkpoint of a resumed run says; empty for a new one.
    """

    def __init__(
        self,
        config: TrainConfig,
        planar: PlanarConfig,
        folder: Path,
        cars: PlanarVecEnv,
        judge: PlanarDrive,
        provenance: dict[str, object],
        on_progress: Callable[[Progress], None],
        state: dict[str, Any],
    ) -> None:
        super().__init__()
        self._config, self._planar, self._folder = config, planar, folder
        self._cars, self._judge = cars, judge
        self._provenance, self._on_progress = provenance, on_progress
        self._episode = state.get("episode", 0)
        self._best = tuple(state["best"]) if state.get("best") else None
        self._wall_before = state.get("wall_s", 0.0)
        # What a fine-tuning begins with is judged first.
        self._evaluated_at = state.get("evaluated_at", -planar.eval_every_steps if config.init else 0)
        self._recent: deque[bool] = deque(maxlen=RECENT)
        self._episodes = CsvLog(folder / "episodes.csv", EPISODE_COLUMNS)
        self._evaluations = CsvLog(folder / "evaluations.csv", EVALUATION_COLUMNS)
        for log in (self._episodes, self._evaluations):
            log.cut_after(self._episode)
        self._good_enough = self._over = False
        # By world: half means nothing is known, and is where most is to be learned.
        self._learned = np.array(state.get("learned", [0.5] * len(cars.env.drive.worlds)))

    def _on_training_start(self) -> None:
        self._began = time.monotonic()
        self._first_step = self.num_timesteps

    def _on_step(self) -> bool:
        for car, info in enumerate(self.locals["infos"]):
            if info:
                self._recent.append(info["is_success"])
                self._learned[info["world"]] += FORGET * (info["is_success"] - self._learned[info["world"]])
                if car < LOGGED_CARS:
                    self._log_episode(car, info)
        return not self._over

    def _on_rollout_start(self) -> None:
        if isinstance(self.model, RunPPO):
            self.model.share_done = min(self._share_done(), 1.0)
        done, since = self._share_done() >= 1.0, self.num_timesteps - self._evaluated_at
        if since >= self._planar.eval_every_steps or (done and since > 0):
            self._evaluate()
            self.save()
        # Only between two rollouts: one that is cut short would not be learned from. The next step ends the run.
        self._over = self._good_enough or done
        if self._planar.curriculum > 0.0:
            interest = self._planar.curriculum + self._learned * (1.0 - self._learned)
            self._cars.env.drive.weights = interest
        elapsed = max(time.monotonic() - self._began, 1e-9)
        steps_per_s = (self.num_timesteps - self._first_step) / elapsed
        recent = sum(self._recent) / max(len(self._recent), 1)
        percent = round(100 * min(self._share_done(), 1.0))
        self._on_progress(Progress(percent, 100, steps_per_s, recent, self._best[0] if self._best else 0.0))

    def save(self) -> None:
        """Write the last policy and a checkpoint."""
        save_policy(self._agent("last"), self._folder / "last.safetensors")
        plain, arrays = self._cars.state()
        state = {
            "episode": self._episode,
            "best": self._best,
            "wall_s": self._wall_s(),
            "evaluated_at": self._evaluated_at,
            "cars": plain,
            "learned": self._learned.tolist(),
        }
        save_checkpoint(self._folder / "checkpoint", self.model, state, arrays)

    def _wall_s(self) -> float:
        return self._wall_before + time.monotonic() - self._began

    def _share_done(self) -> float:
        """Return how much of the run is over, by whichever of its limits is nearest."""
        config = self._config
        steps = self.num_timesteps / config.steps if config.steps else 0.0
        return max(steps, self._wall_s() / (60.0 * config.max_minutes) if config.max_minutes else 0.0)

    def _log_episode(self, car: int, info: dict[str, Any]) -> None:
        self._episode += 1
        self._episodes.append(
            {
                "episode": self._episode,
                "total_steps": self.num_timesteps,
                "wall_s": round(self._wall_s(), 2),
                "env": car,
                "world": info["world"],
                "outcome": info["outcome"],
                "return": round(info["episode"]["r"], 3),
                "steps": info["episode"]["l"],
                "epsilon": "",
            }
        )

    def _agent(self, name: str) -> PolicyAgent:
        provenance = self._provenance | {"total_steps": self.num_timesteps}
        return to_agent(self.model, name, self._judge.spec, provenance)

    def _evaluate(self) -> None:
        refuse_non_finite(self.model, self._folder, f"{self.num_timesteps} steps")
        self._evaluated_at = self.num_timesteps
        agent, n_worlds = self._agent("best"), len(self._judge.worlds)
        worlds = np.repeat(np.arange(n_worlds, dtype=np.int32), self._planar.n_eval_starts)
        starts = np.tile(np.arange(self._planar.n_eval_starts), n_worlds)
        self._judge.reset(self._config.seed)  # the same dynamics and noise every time
        trial = drive_out(self._judge, agent.action, worlds, self._judge.starts[worlds, starts])
        success = trial.outcome == Outcome.SUCCESS.code
        rate = float(success.mean())
        collision = float((trial.outcome == Outcome.COLLISION.code).mean())
        step_s = self._config.task.physics.control_step_s
        row: dict[str, float | None] = {
            "success": rate,
            "collision": collision,
            "fail": 1.0 - rate - collision,
            "time_s": float(trial.n_steps[success].mean()) * step_s if success.any() else None,
        }
        best = self._best is None or rank(row) >= self._best  # of equals, the longer trained
        if best:
            self._best = rank(row)
            save_policy(agent, self._folder / "best.safetensors")
            self.model.save(self._folder / "best.zip")
        self._good_enough = self._config.stop_at is not None and rate >= self._config.stop_at
        where = {"episode": self._episode, "total_steps": self.num_timesteps, "wall_s": round(self._wall_s(), 2)}
        self._evaluations.append(where | row | {"best": int(best)})
        self.logger.record("evaluation/success", row["success"])
        self.logger.record("evaluation/collision", collision)
