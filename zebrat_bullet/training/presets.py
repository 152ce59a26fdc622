"""Named training runs: the paper's, and our own; vary one by `dataclasses.replace`."""

from dataclasses import replace

from zebrat_bullet.config import EpisodeConfig, LidarConfig, PhysicsConfig, TaskConfig, with_reward
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
    """Return the run with another car and reward, in training and evaluation alike.

    Raises:
        ConfigError: there is no such reward.
    """

    def changed(task: TaskConfig) -> TaskConfig:
        return with_reward(replace(task, robot=robot), reward)

    return replace(config, task=changed(config.task), eval_task=config.eval_task and changed(config.eval_task))


_OURS = DDPGConfig(
    hidden=(256, 256),
    actor_lr=3e-4,
    critic_lr=1e-3,
    lr_final=0.05,
    batch_size=128,
    n_critics=2,
    policy_delay=2,
    target_noise=0.1,
    warmup_steps=2000,
    epsilon=0.3,
    hold_steps=8,
    mirror=True,
    reward_scale=0.1,
)
_GENERAL = TrainConfig(
    learner=_OURS,
    worlds=("big_track",) * 20,
    n_generated=300,
    tightness=0.9,
    episodes=2600,
    eval_every=100,
    eval_episodes=1,
    eval_worlds=("big_track",),
    n_generated_eval=30,
    checkpoint_every=200,
    task=TaskConfig(lidar=LidarConfig(caster="embree"), episode=EpisodeConfig(start="anywhere")),
)

TRAIN_PRESETS = {
    "paper": TrainConfig(),
    "general": _GENERAL,
    "finetune": replace(
        _GENERAL,
        learner=replace(
            _OURS,
            actor_lr=5e-5,
            critic_lr=2e-4,
            batch_size=256,
            target_noise=0.05,
            warmup_steps=500,
            epsilon=0.1,
        ),
        worlds=("big_track",) * 60 + ("track_1", "track_2", "track_3") * 10,
        n_generated=210,
        tightness=0.6,
        episodes=700,
        eval_every=50,
        eval_episodes=2,
        eval_worlds=("big_track", "track_1", "track_2", "track_3"),
        checkpoint_every=50,
    ),
    "fast": TrainConfig(
        learner=replace(
            _OURS,
            actor_lr=2e-4,
            critic_lr=6e-4,
            lr_final=1.0,
            gamma=0.98,
            buffer_size=10_000,
            warmup_steps=1000,
            standardise=True,
            average=1500,
        ),
        worlds=("big_track", "big_track", "track_3"),
        episodes=1000,
        steps=8000,
        max_minutes=4.75,
        attempts=30,
        retries=3,
        eval_every=8,
        eval_episodes=60,
        eval_failures=1,
        eval_worlds=("big_track",),
        eval_task=TaskConfig(lidar=LidarConfig(caster="embree")),
        stop_at=1.0,
        checkpoint_every=1000,
        task=TaskConfig(
            physics=PhysicsConfig(rate_hz=80.0),
            lidar=LidarConfig(caster="embree", n_channels=4),
            episode=EpisodeConfig(start="anywhere"),
        ),
    ),
}
"""`paper`: the paper's. `general`: many generated tracks, to drive unseen ones. `finetune`: on from a `general`
run's model (with `init=`). `fast`: big_track from nothing in five minutes on two cores."""
