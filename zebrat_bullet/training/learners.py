"""The five algorithms on Stable-Baselines3: settings in, an untrained learner out."""

from typing import Any

import torch
from numpy.typing import NDArray
from stable_baselines3 import DQN, PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from zebrat_bullet.training.budget import RunBudget
from zebrat_bullet.training.ddpg import PaperDDPG
from zebrat_bullet.training.learner_settings import DDPGConfig, DQNConfig, Learner, PPOConfig, SACConfig
from zebrat_bullet.training.ppo import GridActions, RunPPO, ScaledRewards
from zebrat_bullet.training.settings import TrainConfig


class PaperDQN(RunBudget, DQN):
    """SB3's DQN, whose epsilon falls over the run."""

    @property
    def epsilon(self) -> float:
        """Probability of a random action now."""
        return self.exploration_rate


LEARNERS: dict[str, type[BaseAlgorithm]] = {
    "ddpg": PaperDDPG,
    "dqn": PaperDQN,
    "sac": SAC,
    "ppo": RunPPO,
    "ppo-discrete": RunPPO,
}
ROLLOUT_STEPS = 16
"""Steps between two visits of the callback that evaluates and saves; SB3 does some work of its own at each, too."""
DISCRETE = frozenset({"dqn", "ppo-discrete"})
"""Algorithms that choose among the six discrete actions."""
OFF_POLICY = frozenset({"ddpg", "dqn", "sac"})
"""Algorithms that learn from a replay."""
WITHOUT_END = 10**12
"""Steps or episodes of a run that something else ends."""


def build_learner(config: TrainConfig, env: Any) -> BaseAlgorithm:
    """Return an untrained learner for a vectorised environment."""
    settings = config.learner
    common = {"env": env, "seed": config.seed, "device": "cpu", "gamma": settings.gamma}
    common["batch_size"] = settings.batch_size
    network = {"net_arch": list(settings.hidden), "activation_fn": nn.ReLU, "optimizer_kwargs": {"fused": True}}
    if isinstance(settings, PPOConfig):
        if settings.activation == "tanh":
            network["activation_fn"] = nn.Tanh
        common["env"] = GridActions(env, settings) if settings.speeds else env
        common["env"] = scaled(common["env"], settings)
        return RunPPO(
            "MlpPolicy",
            **common,
            settings=settings,
            policy_kwargs=network | {"log_std_init": settings.log_std_init},
            learning_rate=settings.lr,
            n_steps=settings.n_steps,
            n_epochs=settings.n_epochs,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip_range,
            ent_coef=settings.ent_coef,
        )
    common |= {
        "buffer_size": settings.buffer_size,
        "learning_starts": settings.warmup_steps,
        "tau": settings.tau,
        "train_freq": ROLLOUT_STEPS,
        "gradient_steps": 0,  # they are done while the environments step: see vec_env.py
    }
    model = _build_off_policy(settings, common, network)
    if isinstance(model, RunBudget):
        # Thousands of planar cars have driven any number of episodes at once: their runs are counted in steps.
        model.n_episodes = WITHOUT_END if config.planar else config.episodes
        model.n_steps_of_run = config.steps
    return model


def scaled(env: Any, settings: Learner) -> Any:
    """Return a vectorised environment whose rewards are scaled as a learner wants them."""
    scale = settings.reward_scale if isinstance(settings, PPOConfig) else 1.0
    return env if scale == 1.0 else ScaledRewards(env, scale)


def _build_off_policy(
    settings: DDPGConfig | DQNConfig | SACConfig, common: dict[str, Any], network: dict[str, Any]
) -> BaseAlgorithm:
    if isinstance(settings, DQNConfig):
        return PaperDQN(
            "MlpPolicy",
            **common,
            policy_kwargs=network,
            learning_rate=settings.lr,
            target_update_interval=1,
            exploration_initial_eps=settings.epsilon,
            exploration_final_eps=0.0,
            exploration_fraction=1.0,
        )
    if isinstance(settings, SACConfig):
        return SAC("MlpPolicy", **common, policy_kwargs=network, learning_rate=settings.lr)
    return PaperDDPG("MlpPolicy", **common, policy_kwargs=network, settings=settings)


def exploration(model: BaseAlgorithm) -> float | None:
    """Return the probability of a random action now; None for an algorithm that explores otherwise."""
    return model.epsilon if isinstance(model, PaperDDPG | PaperDQN) else None


@torch.no_grad()
def critic_values(model: BaseAlgorithm, observations: NDArray) -> NDArray:
    """Return (n,) what the learner believes its policy will earn from each of (n, size) observations."""
    seen = torch.from_numpy(observations)
    if isinstance(model, PaperDDPG):
        values = model.critic.q1_forward(seen, model.actor(seen))
    elif isinstance(model, SAC):
        values = model.critic(seen, model.actor(seen, deterministic=True))[0]
    elif isinstance(model, PaperDQN):
        values = model.q_net(seen).amax(1)
    else:
        assert isinstance(model, PPO)
        values = model.policy.predict_values(seen)
    return values.flatten().numpy()
