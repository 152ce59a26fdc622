"""Stable-Baselines3's PPO with schedules that end with the run, a floor for its noise, and commands on a grid."""

import math
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from zebrat_bullet.training.learner_settings import PPOConfig


class RunPPO(PPO):
    """SB3's PPO; its learning rate falls over the run as `settings` say.

    Attributes:
        share_done: how much of the run is over, in [0, 1]; who knows its length sets it.
    """

    share_done = 0.0

    def __init__(self, *args: Any, settings: PPOConfig | None = None, **kwargs: Any) -> None:
        self.settings = settings or PPOConfig()
        super().__init__(*args, **kwargs)

    def _update_current_progress_remaining(self, num_timesteps: int, total_timesteps: int) -> None:
        self._current_progress_remaining = 1.0 - self.share_done

    def _update_learning_rate(self, optimizers: Any) -> None:
        final = self.settings.lr_final
        for group in self.policy.optimizer.param_groups:
            group["lr"] = self.settings.lr * (final + (1.0 - final) * self._current_progress_remaining)

    def train(self) -> None:
        """Learn from a rollout."""
        super().train()
        if self.settings.least_std > 0.0 and hasattr(self.policy, "log_std"):
            with torch.no_grad():
                self.policy.log_std.clamp_(min=math.log(self.settings.least_std))


class GridActions(VecEnvWrapper):
    """Takes a choice of speed and one of steering instead of two fractions of the limits."""

    def __init__(self, venv: Any, settings: PPOConfig) -> None:
        self._grid = [np.array(values, dtype=np.float32) for values in (settings.speeds, settings.steerings)]
        super().__init__(venv, action_space=spaces.MultiDiscrete([len(values) for values in self._grid]))

    def reset(self) -> VecEnvObs:
        """Reset the environments."""
        return self.venv.reset()

    def step_async(self, actions: NDArray[np.int64]) -> None:
        """Take (N, 2) choices."""
        self.venv.step_async(np.stack([values[i] for values, i in zip(self._grid, actions.T, strict=True)], axis=1))

    def step_wait(self) -> VecEnvStepReturn:
        """Step the environments."""
        return self.venv.step_wait()


class ScaledRewards(VecEnvWrapper):
    """Multiplies every reward; infos keep the task's."""

    def __init__(self, venv: Any, scale: float) -> None:
        super().__init__(venv)
        self._scale = scale

    def reset(self) -> VecEnvObs:
        """Reset the environments."""
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        """Step the environments."""
        observations, rewards, dones, infos = self.venv.step_wait()
        return observations, rewards * self._scale, dones, infos
