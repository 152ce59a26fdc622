"""DDPG as the paper trains it, on Stable-Baselines3: two learning rates, and exploration by epsilon over the run."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG

from zebrat_bullet.training.budget import RunBudget
from zebrat_bullet.training.ddpg_update import DDPGUpdate
from zebrat_bullet.training.learner_settings import DDPGConfig


class PaperDDPG(RunBudget, DDPG):
    """SB3's DDPG with the exploration and the two learning rates of the authors' code, and a faster gradient step.

    With probability epsilon, falling linearly to 0 over the run, the action is uniformly random; else it is the
    policy's with Gaussian noise of `sigma`.
    """

    def __init__(self, *args: Any, settings: DDPGConfig | None = None, **kwargs: Any) -> None:
        self.settings = settings or DDPGConfig()
        self._update: DDPGUpdate | None = None
        self.rng = np.random.default_rng(kwargs.get("seed"))
        super().__init__(*args, **kwargs)

    @property
    def epsilon(self) -> float:
        """Probability of a random action now."""
        return self.settings.epsilon * self._current_progress_remaining

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Do the gradient steps of `TD3.train`, faster."""
        assert self.replay_buffer is not None
        self._update = self._update or DDPGUpdate(self, self.settings.precision, self.settings.cloning)
        self._update_learning_rate([])
        loss = torch.zeros(())
        for _ in range(gradient_steps):
            batch = self.replay_buffer.sample(batch_size)
            loss = self._update.critic_step(batch)
            if self.num_timesteps >= self.settings.critic_first_steps:
                self._update.actor_step(batch)
            self._update.follow()
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/critic_loss", loss.item())

    def _update_learning_rate(self, optimizers: Any) -> None:
        """Give actor and critic each its own rate, where SB3 gives both the same."""
        rates = (self.actor.optimizer, self.settings.actor_lr), (self.critic.optimizer, self.settings.critic_lr)
        for optimizer, rate in rates:
            for group in optimizer.param_groups:
                group["lr"] = rate

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Explore; the action space is [-1, 1], so the action and what the buffer stores are the same."""
        if self.num_timesteps < learning_starts and not self.settings.critic_first_steps:
            action = self.rng.uniform(-1.0, 1.0, (n_envs, 2))
        else:
            assert isinstance(self._last_obs, np.ndarray)  # SB3 resets the environments before the first rollout
            with torch.no_grad():
                policy = self.actor(torch.from_numpy(self._last_obs)).numpy()
            noisy = np.clip(policy + self.rng.normal(0.0, self.settings.sigma, policy.shape), -1.0, 1.0)
            explores = self.rng.random((n_envs, 1)) < self.epsilon
            action = np.where(explores, self.rng.uniform(-1.0, 1.0, (n_envs, 2)), noisy)
        return action.astype(np.float32), action.astype(np.float32)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_update"]
