"""DDPG as the paper trains it, on Stable-Baselines3: two learning rates, and exploration by epsilon in episodes."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.task.observation import ObservationSpec
from zebrat_bullet.training.presets import TrainConfig


class PaperDDPG(DDPG):
    """SB3's DDPG with the exploration and the two learning rates of the authors' code.

    With probability epsilon, falling linearly to 0 over the run's episodes, the action is uniformly random; else it is
    the policy's with Gaussian noise of `sigma`. Beyond the paper, a random action may be held for several steps.
    """

    def __init__(
        self,
        *args: Any,
        actor_lr: float = 1e-4,
        critic_lr: float = 2e-4,
        lr_final: float = 1.0,
        epsilon: float = 0.8,
        hold_steps: int = 1,
        sigma: float = 0.1,
        n_episodes: int = 1000,
        **kwargs: Any,
    ) -> None:
        self.actor_lr, self.critic_lr, self.lr_final = actor_lr, critic_lr, lr_final
        self.epsilon_start, self.hold_steps = epsilon, hold_steps
        self.sigma, self.n_episodes = sigma, n_episodes
        self._held = np.zeros((0, 2))
        self.rng = np.random.default_rng(kwargs.get("seed"))
        super().__init__(*args, **kwargs)

    @property
    def remaining(self) -> float:
        """Share of the run's episodes that are still to come."""
        return max(0.0, 1.0 - self._episode_num / self.n_episodes)

    @property
    def epsilon(self) -> float:
        """Probability of a random action now."""
        return self.epsilon_start * self.remaining

    def _update_learning_rate(self, optimizers: Any) -> None:
        """Give actor and critic each its own rate, where SB3 gives both the same."""
        share = self.lr_final + (1.0 - self.lr_final) * self.remaining
        for optimizer, rate in ((self.actor.optimizer, self.actor_lr), (self.critic.optimizer, self.critic_lr)):
            for group in optimizer.param_groups:
                group["lr"] = share * rate

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Explore; the action space is [-1, 1], so the action and what the buffer stores are the same."""
        if self.num_timesteps < learning_starts:
            action = self.rng.uniform(-1.0, 1.0, (n_envs, 2))
        else:
            assert self._last_obs is not None  # SB3 resets the environments before the first rollout
            policy, _ = self.predict(self._last_obs, deterministic=True)
            noisy = np.clip(policy + self.rng.normal(0.0, self.sigma, policy.shape), -1.0, 1.0)
            explores = self._hold_random_actions(n_envs)
            action = np.where(explores, self._held, noisy)
        return action.astype(np.float32), action.astype(np.float32)

    def _hold_random_actions(self, n_envs: int) -> NDArray[np.bool_]:
        """Return (n_envs, 1), which environments act randomly now; `_held` (n_envs, 2) says how."""
        if len(self._held) != n_envs:
            self._held, self._hold_left = np.zeros((n_envs, 2)), np.zeros((n_envs, 1), dtype=int)
        mean_hold = 0.5 * (1 + self.hold_steps)
        begins = (self._hold_left == 0) & (
            self.rng.random((n_envs, 1)) < self.epsilon / (mean_hold - self.epsilon * (mean_hold - 1.0))
        )
        self._held = np.where(begins, self.rng.uniform(-1.0, 1.0, (n_envs, 2)), self._held)
        self._hold_left = np.where(begins, self.rng.integers(1, self.hold_steps + 1, (n_envs, 1)), self._hold_left)
        explores = self._hold_left > 0
        self._hold_left = np.maximum(self._hold_left - 1, 0)
        return explores


class MirrorReplayBuffer(NStepReplayBuffer):
    """Replay of which half of each batch is seen mirrored left to right; scales the reward too."""

    def __init__(
        self, *args: Any, observation: ObservationSpec, mirror: bool, reward_scale: float, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.observation, self.mirror, self.reward_scale = observation, mirror, reward_scale

    def _get_samples(self, batch_inds: NDArray[np.int64], env: Any = None) -> ReplayBufferSamples:
        samples = super()._get_samples(batch_inds, env)
        half = len(batch_inds) // 2 if self.mirror else 0  # indices are drawn at random, so the first half is random
        for observations in (samples.observations, samples.next_observations):
            observations[:half] = torch.from_numpy(self.observation.mirror(observations[:half].numpy()))
        samples.actions[:half, 1] *= -1.0
        return samples._replace(rewards=samples.rewards * self.reward_scale)


def build_ddpg(config: TrainConfig, env: Any, observation: ObservationSpec) -> PaperDDPG:
    """Return an untrained learner for a vectorised environment."""
    model = PaperDDPG(
        "MlpPolicy",
        env,
        actor_lr=config.actor_lr,
        critic_lr=config.critic_lr,
        lr_final=config.lr_final,
        epsilon=config.epsilon,
        hold_steps=config.hold_steps,
        sigma=config.sigma,
        n_episodes=config.episodes,
        buffer_size=config.buffer_size,
        replay_buffer_class=MirrorReplayBuffer,
        replay_buffer_kwargs={
            "observation": observation,
            "mirror": config.mirror,
            "reward_scale": config.reward_scale,
            "n_steps": config.n_step,
            "gamma": config.gamma,
        },
        learning_starts=config.warmup_steps,
        batch_size=config.batch_size,
        gamma=config.gamma,
        tau=config.tau,
        train_freq=1,
        gradient_steps=-1,
        policy_kwargs={
            "net_arch": list(config.hidden),
            "n_critics": config.n_critics,
            "optimizer_kwargs": {"fused": config.fused_adam},
        },
        seed=config.seed,
        device="cpu",
    )
    # SB3's DDPG is its TD3 with these switched off; a clip of 0 is no noise, but the sigma itself must be above 0.
    model.policy_delay = config.policy_delay
    model.target_policy_noise = config.target_noise or model.target_policy_noise
    model.target_noise_clip = 2.5 * config.target_noise
    return model


def actor_to_agent(model: DDPG, name: str, observation: ObservationSpec, provenance: dict[str, object]) -> PolicyAgent:
    """Return the actor as a policy that runs without torch."""
    linear = [module for module in model.actor.mu if isinstance(module, torch.nn.Linear)]
    layers = [(layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in linear]
    return PolicyAgent(name, layers, observation, provenance)
