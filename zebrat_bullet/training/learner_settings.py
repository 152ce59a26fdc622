"""Settings of the five learners: frozen, validated once, varied by `dataclasses.replace`."""

from dataclasses import dataclass
from typing import Literal

from zebrat_bullet.config import at_least_one, shares, within
from zebrat_bullet.errors import ConfigError

_RATE = (0.0, 1000.0)


@dataclass(frozen=True, kw_only=True)
class DDPGConfig:
    """DDPG; the defaults are the paper's (III-C, IV-B, and the authors' code).

    Attributes:
        hidden: units of each hidden layer.
        actor_lr, critic_lr: learning rates.
        buffer_size, batch_size, gamma, tau: replay and targets.
        warmup_steps: uniformly random steps before the first update.
        epsilon: probability of a uniformly random action at the start; falls linearly to 0 over the run.
        sigma: Gaussian noise on the action otherwise, as a fraction of the limits.
        critic_first_steps: environment steps from the start in which the policy drives, instead of a random one, and
            the critic alone learns; for fine-tuning (`init`), so that the policy meets a critic that knows it.
        cloning: weight of the mean squared distance between the policy's actions and the replay's, against Q as a share
            of its mean size (TD3+BC's 1 / alpha); for fine-tuning: 0 lets the actor go wherever the critic points.
        precision: "bf16" computes the products of two hidden layers in bfloat16 (twice as fast where the processor has
            it), "fp32" as plain Stable-Baselines3 does. Weights and the rest are float32 either way.
    """

    algo: Literal["ddpg"] = "ddpg"
    hidden: tuple[int, ...] = (512, 512)
    actor_lr: float = 1e-4
    critic_lr: float = 2e-4
    buffer_size: int = 200_000
    batch_size: int = 64
    gamma: float = 0.99
    tau: float = 0.005
    warmup_steps: int = 200
    epsilon: float = 0.8
    sigma: float = 0.1
    critic_first_steps: int = 0
    cloning: float = 0.0
    precision: Literal["fp32", "bf16"] = "bf16"

    def __post_init__(self) -> None:
        at_least_one(self, "buffer_size", "batch_size", "warmup_steps")
        shares(self, "gamma", "tau", "epsilon")
        if self.sigma < 0:
            raise ConfigError(f"sigma must be at least 0, got {self.sigma}")
        within(self, sigma=(0.0, 100.0), actor_lr=_RATE, critic_lr=_RATE, cloning=(0.0, 1e6))
        within(self, critic_first_steps=(0, 10**12))
        _bound_replay(self)


@dataclass(frozen=True, kw_only=True)
class DQNConfig:
    """DQN over the paper's six discrete actions; what the paper leaves open is as in its DDPG.

    Attributes:
        hidden, buffer_size, batch_size, gamma, tau, warmup_steps: as in `DDPGConfig`.
        lr: learning rate.
        epsilon: probability of a random action at the start; falls linearly to 0 over the run.
    """

    algo: Literal["dqn"] = "dqn"
    hidden: tuple[int, ...] = (512, 512)
    lr: float = 1e-4
    buffer_size: int = 200_000
    batch_size: int = 64
    gamma: float = 0.99
    tau: float = 0.005
    warmup_steps: int = 200
    epsilon: float = 0.8

    def __post_init__(self) -> None:
        at_least_one(self, "buffer_size", "batch_size", "warmup_steps")
        shares(self, "gamma", "tau", "epsilon")
        within(self, lr=_RATE)
        _bound_replay(self)


@dataclass(frozen=True, kw_only=True)
class SACConfig:
    """SAC with a learned temperature; what the paper leaves open is as in its DDPG.

    Attributes:
        hidden, buffer_size, batch_size, gamma, tau, warmup_steps: as in `DDPGConfig`.
        lr: learning rate of actor, critics and temperature.
    """

    algo: Literal["sac"] = "sac"
    hidden: tuple[int, ...] = (512, 512)
    lr: float = 1e-4
    buffer_size: int = 200_000
    batch_size: int = 64
    gamma: float = 0.99
    tau: float = 0.005
    warmup_steps: int = 200

    def __post_init__(self) -> None:
        at_least_one(self, "buffer_size", "batch_size", "warmup_steps")
        shares(self, "gamma", "tau")
        within(self, lr=_RATE)
        _bound_replay(self)


@dataclass(frozen=True, kw_only=True)
class PPOConfig:
    """PPO, over the continuous or the six discrete actions; what the paper leaves open is Stable-Baselines3's default.

    Attributes:
        algo: "ppo" or "ppo-discrete".
        hidden: units of each hidden layer, of policy and value alike.
        activation: of the hidden layers.
        lr, batch_size, n_epochs, clip_range, ent_coef: the updates.
        lr_final: the learning rate falls linearly to this share of itself over the run (1: constant).
        n_steps: steps of each environment before them.
        gamma, gae_lambda: returns and advantages.
        reward_scale: factor on the reward that the learner sees; logs keep the task's.
        log_std_init, least_std: standard deviation of the actions, as a fraction of the limits: its logarithm at the
            start, and what it never falls below. Without noise a policy learns to shave walls.
        speeds, steerings: fractions of the limits among which speed and steering are chosen, each by itself; empty for
            continuous ones. A Gaussian has one peak, which between "forward" and "back" stands still.
    """

    algo: Literal["ppo", "ppo-discrete"] = "ppo"
    hidden: tuple[int, ...] = (512, 512)
    activation: Literal["relu", "tanh"] = "relu"
    lr: float = 3e-4
    lr_final: float = 1.0
    n_steps: int = 2048
    batch_size: int = 64
    n_epochs: int = 10
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    ent_coef: float = 0.0
    reward_scale: float = 1.0
    log_std_init: float = 0.0
    least_std: float = 0.0
    speeds: tuple[float, ...] = ()
    steerings: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        at_least_one(self, "n_steps", "batch_size", "n_epochs")
        within(self, speeds=(-1.0, 1.0), steerings=(-1.0, 1.0))
        if bool(self.speeds) != bool(self.steerings) or (self.speeds and self.algo != "ppo"):
            raise ConfigError("name both speeds and steerings, of ppo, or neither")
        shares(self, "gamma", "gae_lambda", "lr_final", "least_std")
        within(self, lr=_RATE, n_steps=(1, 10**6), batch_size=(1, 10**7), n_epochs=(1, 1000), clip_range=(0.0, 100.0))
        within(self, ent_coef=(-100.0, 100.0), reward_scale=(-1e6, 1e6), log_std_init=(-20.0, 20.0))
        _bound_network(self)


Learner = DDPGConfig | DQNConfig | SACConfig | PPOConfig


def _bound_network(config: DDPGConfig | DQNConfig | SACConfig | PPOConfig) -> None:
    within(config, hidden=(1, 8192))
    if len(config.hidden) > 16:
        raise ConfigError(f"hidden names at most 16 layers, got {len(config.hidden)}")


def _bound_replay(config: DDPGConfig | DQNConfig | SACConfig) -> None:
    _bound_network(config)
    within(config, buffer_size=(1, 10**7), batch_size=(1, 10**6), warmup_steps=(1, 10**9))
