"""Named training runs; vary one by `dataclasses.replace`."""

from dataclasses import replace

from zebrat_bullet.config import with_reward
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.training.settings import DDPGConfig, DQNConfig, Learner, PPOConfig, SACConfig, TrainConfig

ALGORITHMS: dict[str, Learner] = {
    "ddpg": DDPGConfig(),
    "dqn": DQNConfig(),
    "sac": SACConfig(),
    "ppo": PPOConfig(),
    "ppo-discrete": PPOConfig(algo="ppo-discrete"),
}
"""The five algorithms of the paper, with its networks and parameters."""


def paper_config(algo: str, reward: str) -> TrainConfig:
    """Return the paper's run of an algorithm under a reward: 1,000 episodes on big_track.

    Raises:
        ConfigError: there is no such algorithm or reward.
    """
    if algo not in ALGORITHMS:
        raise ConfigError(f"unknown algorithm {algo!r}; valid are: {', '.join(ALGORITHMS)}")
    config = TrainConfig(learner=ALGORITHMS[algo])
    return with_task(config, config.task.robot, reward)


def with_task(config: TrainConfig, robot: str, reward: str) -> TrainConfig:
    """Return the run with another car and reward.

    Raises:
        ConfigError: there is no such reward.
    """
    return replace(config, task=with_reward(replace(config.task, robot=robot), reward))


TRAIN_PRESETS = {"paper": TrainConfig()}
"""`paper`: the paper's."""
