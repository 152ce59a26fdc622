"""DDPG as the paper trains it, on Stable-Baselines3: two learning rates, and exploration by epsilon over the run."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from torch import Tensor

from zebrat_bullet.training.budget import RunBudget
from zebrat_bullet.training.ddpg_update import DDPGUpdate
from zebrat_bullet.training.settings import DDPGConfig


class PaperDDPG(RunBudget, DDPG):
    """SB3's DDPG with the exploration and the two learning rates of the authors' code, and a faster gradient step.

    With probability epsilon, falling linearly to 0 over the run, the action is uniformly random; else it is the
    policy's with Gaussian noise of `sigma`. Beyond the paper, a random action may be held for several steps.
    """

    def __init__(self, *args: Any, settings: DDPGConfig | None = None, **kwargs: Any) -> None:
        self.settings = settings or DDPGConfig()
        self._held = np.zeros((0, 2))
        self._update: DDPGUpdate | None = None
        self._average: list[Tensor] = []
        self.rng = np.random.default_rng(kwargs.get("seed"))
        super().__init__(*args, **kwargs)

    @property
    def epsilon(self) -> float:
        """Probability of a random action now."""
        return self.settings.epsilon * self._current_progress_remaining

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Do the gradient steps of `TD3.train`, faster."""
        assert self.replay_buffer is not None
        if self._update is None:
            if self.settings.standardise and not self._is_standardised():
                self._standardise(self.replay_buffer.observations[: self.replay_buffer.pos])
            if self.settings.average and not self._average:
                self._average = [parameter.detach().clone() for parameter in self.actor.parameters()]
            self._update = DDPGUpdate(self, self.settings.precision)
        self._update_learning_rate([])
        loss = torch.zeros(())
        for _ in range(gradient_steps):
            self._n_updates += 1
            batch = self.replay_buffer.sample(batch_size)
            loss = self._update.critic_step(batch)
            if self._n_updates % self.policy_delay == 0:
                self._update.actor_step(batch.observations)
                if self.settings.average:
                    now = [parameter.data for parameter in self.actor.parameters()]
                    torch._foreach_lerp_(self._average, now, 1.0 / self.settings.average)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/critic_loss", loss.item())

    @contextmanager
    def averaged(self) -> Iterator[None]:
        """Give the actor its average weights, for as long as this lasts."""
        weights = [parameter.data for parameter in self.actor.parameters()]
        kept = [weight.clone() for weight in weights]
        torch._foreach_copy_(weights, self._average or kept)
        try:
            yield
        finally:
            torch._foreach_copy_(weights, kept)

    def _is_standardised(self) -> bool:
        """Return whether mean and deviation were taken already: before a resume, or by the model to begin with."""
        features: Any = self.actor.features_extractor
        return bool(features.mean.any())

    def _standardise(self, observations: NDArray[np.float32]) -> None:
        for network in (self.actor, self.actor_target, self.critic, self.critic_target):
            features: Any = network.features_extractor
            features.fit(observations.reshape(-1, observations.shape[-1]))

    def _update_learning_rate(self, optimizers: Any) -> None:
        """Give actor and critic each its own rate, where SB3 gives both the same."""
        share = self.settings.lr_final + (1.0 - self.settings.lr_final) * self._current_progress_remaining
        rates = (self.actor.optimizer, self.settings.actor_lr), (self.critic.optimizer, self.settings.critic_lr)
        for optimizer, rate in rates:
            for group in optimizer.param_groups:
                group["lr"] = share * rate

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Explore; the action space is [-1, 1], so the action and what the buffer stores are the same."""
        if self.num_timesteps < learning_starts:
            action = self.rng.uniform(-1.0, 1.0, (n_envs, 2))
        else:
            assert isinstance(self._last_obs, np.ndarray)  # SB3 resets the environments before the first rollout
            with torch.no_grad():
                policy = self.actor(torch.from_numpy(self._last_obs)).numpy()
            noisy = np.clip(policy + self.rng.normal(0.0, self.settings.sigma, policy.shape), -1.0, 1.0)
            explores = self._hold_random_actions(n_envs)
            action = np.where(explores, self._held, noisy)
        return action.astype(np.float32), action.astype(np.float32)

    def _hold_random_actions(self, n_envs: int) -> NDArray[np.bool_]:
        """Return (n_envs, 1), which environments act randomly now; `_held` (n_envs, 2) says how."""
        if len(self._held) != n_envs:
            self._held, self._hold_left = np.zeros((n_envs, 2)), np.zeros((n_envs, 1), dtype=int)
        longest = self.settings.hold_steps
        mean_hold = 0.5 * (1 + longest)
        begins = (self._hold_left == 0) & (
            self.rng.random((n_envs, 1)) < self.epsilon / (mean_hold - self.epsilon * (mean_hold - 1.0))
        )
        self._held = np.where(begins, self.rng.uniform(-1.0, 1.0, (n_envs, 2)), self._held)
        self._hold_left = np.where(begins, self.rng.integers(1, longest + 1, (n_envs, 1)), self._hold_left)
        explores = self._hold_left > 0
        self._hold_left = np.maximum(self._hold_left - 1, 0)
        return explores

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_update"]
