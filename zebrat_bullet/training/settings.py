"""Settings of a training run and of its learner: frozen, validated once, varied by `dataclasses.replace`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from zebrat_bullet.config import LidarConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.training.watchdog import WatchdogConfig


@dataclass(frozen=True, kw_only=True)
class DDPGConfig:
    """DDPG; the defaults are the paper's (III-C, IV-B, and the authors' code).

    Attributes:
        hidden: units of each hidden layer.
        actor_lr, critic_lr: learning rates at the start.
        lr_final: both fall linearly to this share of themselves over the run (1: constant, as in the paper).
        buffer_size, batch_size, gamma, tau: replay and targets.
        n_critics: critics, of whose targets the smallest counts (1: DDPG, 2: as in TD3).
        policy_delay: critic updates to an actor update (1: DDPG, 2: as in TD3).
        target_noise: Gaussian smoothing of the target action (0: DDPG, 0.2: TD3), clipped at 2.5 sigma.
        warmup_steps: uniformly random steps before the first update.
        epsilon: probability of a uniformly random action at the start; falls linearly to 0 over the run.
        hold_steps: a random action is kept for up to so many steps (1: DDPG of the paper); epsilon stays the share of
            random steps. Single random steps of 0.2 s never swing wide before a tight corner; held ones do.
        sigma: Gaussian noise on the action otherwise, as a fraction of the limits.
        mirror: half of each batch is seen left-right mirrored (the car and its reward are symmetric).
        reward_scale: factor on the reward the learner sees; logs and records keep the paper's.
        standardise: the networks see each number of the observation less its mean, over its deviation, both taken once
            from the warm-up; an exported policy has it in its first layer. In a narrow passage most ranges differ by
            few centimetres, of the 6 m that the observation spans.
        average: evaluations also judge the actor with its weights averaged, exponentially over so many actor updates,
            and the better of the two counts (0: they do not). At constant rates the average drives where others fail.
        precision: "bf16" computes the products of two hidden layers in bfloat16 (twice as fast where the processor has
            it), "fp32" as plain Stable-Baselines3 does. Weights and the rest are float32 either way.
    """

    algo: Literal["ddpg"] = "ddpg"
    hidden: tuple[int, ...] = (512, 512)
    actor_lr: float = 1e-4
    critic_lr: float = 2e-4
    lr_final: float = 1.0
    buffer_size: int = 200_000
    batch_size: int = 64
    gamma: float = 0.99
    tau: float = 0.005
    n_critics: int = 1
    policy_delay: int = 1
    target_noise: float = 0.0
    warmup_steps: int = 200
    epsilon: float = 0.8
    hold_steps: int = 1
    sigma: float = 0.1
    mirror: bool = False
    reward_scale: float = 1.0
    standardise: bool = False
    average: int = 0
    precision: Literal["fp32", "bf16"] = "bf16"

    def __post_init__(self) -> None:
        _at_least_one(self, "buffer_size", "batch_size", "n_critics", "policy_delay", "warmup_steps", "hold_steps")
        _not_negative(self, "average", "sigma", "target_noise")
        _shares(self, "lr_final", "gamma", "tau", "epsilon")


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
        _at_least_one(self, "buffer_size", "batch_size", "warmup_steps")
        _shares(self, "gamma", "tau", "epsilon")


@dataclass(frozen=True, kw_only=True)
class SACConfig:
    """SAC with a learned temperature; what the paper leaves open is as in its DDPG.

    Attributes:
        hidden, buffer_size, batch_size, gamma, tau, warmup_steps, mirror, reward_scale: as in `DDPGConfig`.
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
    mirror: bool = False
    reward_scale: float = 1.0

    def __post_init__(self) -> None:
        _at_least_one(self, "buffer_size", "batch_size", "warmup_steps")
        _shares(self, "gamma", "tau")


@dataclass(frozen=True, kw_only=True)
class PPOConfig:
    """PPO, over the continuous or the six discrete actions; what the paper leaves open is Stable-Baselines3's default.

    Attributes:
        algo: "ppo" or "ppo-discrete".
        hidden: units of each hidden layer, of policy and value alike.
        lr, batch_size, n_epochs, clip_range, ent_coef: the updates.
        n_steps: steps of each environment before them.
        gamma, gae_lambda: returns and advantages.
    """

    algo: Literal["ppo", "ppo-discrete"] = "ppo"
    hidden: tuple[int, ...] = (512, 512)
    lr: float = 3e-4
    n_steps: int = 2048
    batch_size: int = 64
    n_epochs: int = 10
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    ent_coef: float = 0.0

    def __post_init__(self) -> None:
        _at_least_one(self, "n_steps", "batch_size", "n_epochs")
        _shares(self, "gamma", "gae_lambda")


Learner = DDPGConfig | DQNConfig | SACConfig | PPOConfig


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training run.

    Attributes:
        learner: the algorithm and its settings.
        worlds: worlds of the training episodes, by name or file; each episode draws one.
        n_generated: so many generated tracks join them.
        tightness: share of tight turns among the generated tracks' turns.
        episodes: length of the run; schedules end with it.
        steps: length in environment steps, None for no such limit; whichever limit comes first ends run and schedules.
        max_minutes: wall-clock limit, None for none; the run ends early and keeps what it has.
        init: an SB3 zip (a run's best.zip) whose networks to begin with, for fine-tuning (paper: 500 episodes from the
            best model); empty to begin anew. It is judged first (which ends the run if it reaches `stop_at`), and
            stays the best policy unless one is found that is no worse. Zips unpickle: name only files of your own.
        attempts: the run is so many runs, of seeds drawn from its own, side by side on the cores there are; the first
            to reach `stop_at` ends it, and the best is the result. Each has the length that `episodes` and `steps`
            say, all together that of `max_minutes`.
        seed: of networks, exploration, generated tracks and start poses.
        n_envs: environments stepped side by side; each adds one transition and one gradient step.
        retries: an episode that ended in a collision or a stall is tried so many times again, from a pose that the car
            had 1 to 5 s before; each try counts as an episode.
        overlap: step the environments in processes of their own while the learner updates. The result is the same to
            the last bit; it pays where a second core is idle.
        threads: torch threads.
        eval_every, eval_episodes: a noise-free evaluation every so many episodes, with so many in each world. PPO is
            judged and saved between two rollouts only, so it waits for the end of one (2,048 steps).
        eval_failures: after so many failed episodes the rest of an evaluation counts as failed, undriven; None: never.
            With 1, a run can afford to look often for a policy that never fails.
        eval_worlds: where; empty for the training worlds' first.
        n_generated_eval: so many generated tracks, never trained on, join them.
        eval_task: the task of the evaluations, where it is another than that of the training; from the start always.
        stop_at: the run ends with the first evaluation of this success rate; None for never.
        checkpoint_every: episodes between checkpoints, the most a killed run loses.
        watchdog: when a run that does not learn is named.
        task: the task driven.
    """

    learner: Learner = field(default_factory=DDPGConfig)
    worlds: tuple[str, ...] = ("big_track",)
    n_generated: int = 0
    tightness: float = 0.6
    episodes: int = 1000
    steps: int | None = None
    max_minutes: float | None = None
    init: str = ""
    attempts: int = 1
    seed: int = 0
    n_envs: int = 1
    retries: int = 0
    overlap: bool = False
    threads: int = 1
    eval_every: int = 50
    eval_episodes: int = 4
    eval_failures: int | None = None
    eval_worlds: tuple[str, ...] = ()
    n_generated_eval: int = 0
    eval_task: TaskConfig | None = None
    stop_at: float | None = None
    checkpoint_every: int = 50
    watchdog: WatchdogConfig = field(default_factory=WatchdogConfig)
    task: TaskConfig = field(default_factory=lambda: TaskConfig(lidar=LidarConfig(caster="embree")))

    def __post_init__(self) -> None:
        _at_least_one(
            self, "episodes", "attempts", "n_envs", "threads", "eval_every", "eval_episodes", "checkpoint_every"
        )
        _not_negative(self, "retries", "n_generated", "n_generated_eval")
        _shares(self, "tightness")
        if self.stop_at is not None:
            _shares(self, "stop_at")
        if self.eval_failures is not None:
            _at_least_one(self, "eval_failures")
        judged = self.eval_task or self.task
        if (judged.robot, judged.observation) != (self.task.robot, self.task.observation):
            raise ConfigError("task and eval_task must have the same robot and observation: set both")
        if not self.worlds and not self.n_generated:
            raise ConfigError("nothing to train on: name worlds, or set n_generated above 0")
        if self.steps is not None and self.steps < 1:
            raise ConfigError(f"steps must be at least 1, or null for no such limit; got {self.steps}")
        if self.max_minutes is not None and self.max_minutes <= 0:
            raise ConfigError(f"max_minutes must be above 0, or null for no such limit; got {self.max_minutes}")
        if self.attempts > 1 and self.watchdog.restarts:
            raise ConfigError("a run of several attempts has no use for watchdog.restarts: set one of the two")


def require_init(config: TrainConfig) -> None:
    """Raise unless the model to begin with, if there is to be one, is there.

    Raises:
        ConfigError: it is not.
    """
    if config.init and not Path(config.init).is_file():
        raise ConfigError(f"init must name a run's best.zip, got {config.init!r}, which is no file")


def _at_least_one(config: object, *names: str) -> None:
    for name in names:
        if getattr(config, name) < 1:
            raise ConfigError(f"{name} must be at least 1, got {getattr(config, name)}")


def _not_negative(config: object, *names: str) -> None:
    for name in names:
        if getattr(config, name) < 0:
            raise ConfigError(f"{name} must be at least 0, got {getattr(config, name)}")


def _shares(config: object, *names: str) -> None:
    for name in names:
        if not 0 <= getattr(config, name) <= 1:
            raise ConfigError(f"{name} must be in [0, 1], got {getattr(config, name)}")
