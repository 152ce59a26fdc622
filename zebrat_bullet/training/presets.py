"""Named training runs; vary one by `dataclasses.replace`."""

from dataclasses import replace

from zebrat_bullet.config import (
    RANDOM_DYNAMICS,
    VLP16_NOISE,
    EpisodeConfig,
    ObservationConfig,
    RewardConfig,
    TaskConfig,
    with_reward,
)
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.training.settings import (
    DDPGConfig,
    DQNConfig,
    Learner,
    PlanarConfig,
    PPOConfig,
    SACConfig,
    TrainConfig,
)

ALGORITHMS: dict[str, Learner] = {
    "ddpg": DDPGConfig(),
    "dqn": DQNConfig(),
    "sac": SACConfig(),
    "ppo": PPOConfig(),
    "ppo-discrete": PPOConfig(algo="ppo-discrete"),
}
"""The five algorithms of the paper, with its networks and parameters."""


def learner_of(algo: str) -> Learner:
    """Return an algorithm with the paper's networks and parameters.

    Raises:
        ConfigError: there is no such algorithm.
    """
    if algo not in ALGORITHMS:
        raise ConfigError(f"unknown algorithm {algo!r}; valid are: {', '.join(ALGORITHMS)}")
    return ALGORITHMS[algo]


def paper_config(algo: str, reward: str) -> TrainConfig:
    """Return the paper's run of an algorithm under a reward: 1,000 episodes on big_track.

    Raises:
        ConfigError: there is no such algorithm or reward.
    """
    config = TrainConfig(learner=learner_of(algo))
    return with_task(config, config.task.robot, reward)


def with_task(config: TrainConfig, robot: str, reward: str | None) -> TrainConfig:
    """Return the run with another car and reward; None keeps the run's own.

    Raises:
        ConfigError: there is no such reward.
    """
    task = replace(config.task, robot=robot)
    return replace(config, task=task if reward is None else with_reward(task, reward))


_GENERAL = TrainConfig(
    learner=PPOConfig(
        hidden=(128, 128),
        activation="tanh",
        lr=1e-3,
        lr_final=0.05,
        n_steps=32,
        batch_size=2048,
        n_epochs=3,
        gamma=0.98,
        reward_scale=0.01,
        log_std_init=-0.4,
        least_std=0.1,
    ),
    worlds=(),
    steps=20_000_000,
    # A second thread gains little, and waits for its turn where another process keeps a core busy.
    threads=1,
    planar=PlanarConfig(n_tracks=5000, difficulty=0.8, n_eval_tracks=500),
    task=TaskConfig(
        observation=ObservationConfig(log_gaps=True),
        reward=RewardConfig(weights={"F": 1.0, "O": 0.1, "T": 1.0}, collision=-400.0, success=200.0, false_exit=-200.0),
        episode=EpisodeConfig(start="anywhere", max_steps=600),
        noise=VLP16_NOISE,
        dynamics=RANDOM_DYNAMICS,
    ),
)

_QUICK = replace(
    _GENERAL,
    steps=None,
    max_minutes=4.75,
    planar=PlanarConfig(n_tracks=600, difficulty=0.8, n_eval_tracks=100, eval_every_steps=250_000),
)

TRAIN_PRESETS = {"paper": TrainConfig(), "general": _GENERAL, "quick": _QUICK}
"""`paper`: the paper's. `general`: ours, on planar cars by the thousand, drives where it has never been. `quick`: the
same within a few minutes, for a first look."""
