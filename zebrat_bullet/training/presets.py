"""Named training runs; vary one by `dataclasses.replace`."""

from dataclasses import replace

from zebrat_bullet.config import (
    RANDOM_DYNAMICS,
    VLP16_NOISE,
    EpisodeConfig,
    NoiseConfig,
    ObservationConfig,
    RewardConfig,
    SafetyRegionConfig,
    TaskConfig,
    with_reward,
)
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planar.margins import OTHER
from zebrat_bullet.training.learner_settings import DDPGConfig, DQNConfig, Learner, PPOConfig, SACConfig
from zebrat_bullet.training.settings import PlanarConfig, TrainConfig

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


_PPO = PPOConfig(
    hidden=(128, 128),
    activation="tanh",
    lr=1e-3,
    lr_final=0.05,
    n_steps=32,
    batch_size=2048,
    n_epochs=3,
    reward_scale=0.01,
)

_GENERAL = TrainConfig(
    learner=replace(_PPO, gamma=0.98, log_std_init=-0.4, least_std=0.1),
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

_TIGHT = ("narrowing", "manoeuvres", "uneven", "bottlenecks", "corners", "uturns")

_ALLROUND = TrainConfig(
    learner=replace(
        _PPO,
        gamma=0.99,
        ent_coef=0.002,
        # The slowest moves a car 2 cm in a control step: in the narrowest turns it has no more.
        speeds=(-1.0, -0.4, -0.15, 0.15, 0.4, 1.0),
        steerings=(-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0),
    ),
    worlds=(),
    steps=30_000_000,
    threads=1,
    planar=PlanarConfig(
        n_tracks=10_000,
        # The more often, the more there is to learn.
        families=(
            *("mixed", "narrowing", "manoeuvres", "corridors", "narrowing", "boxes", "corners", "manoeuvres"),
            *("uneven", "uturns", "narrowing", "mixed", "bottlenecks", "manoeuvres", "deadends", "niches"),
            *("narrowing", "curves", "boxes", "mixed", "uneven", "narrowing", "bottlenecks", "manoeuvres", "deadends"),
        ),
        curriculum=0.02,
        # Where there is room the car keeps away from the walls; where a turn leaves millimetres it must not.
        margin_m=dict.fromkeys(_TIGHT, 0.003)
        | dict.fromkeys(("narrowing", "manoeuvres"), 0.002)
        | {OTHER: (0.003, 0.03)},
        n_eval_tracks=800,
        n_eval_starts=2,
    ),
    task=TaskConfig(
        # With 32 bearings an inner corner passes between two of them, and ahead they lie 17 degrees apart.
        region=SafetyRegionConfig(resolution_m=0.03, gap_rad=0.07),
        observation=ObservationConfig(log_gaps=True),
        reward=RewardConfig(
            weights={"F": 1.0, "O": 0.1, "T": 1.0}, collision=-400.0, success=400.0, false_exit=-200.0, stall=-400.0
        ),
        episode=EpisodeConfig(start="either", anywhere_yaw_rad=1.2, max_steps=600),
        # Half of what the lidar has: with all of it a centimetre at the wall is not seen.
        noise=NoiseConfig(range_sigma_m=0.004, dropout=0.01),
        dynamics=RANDOM_DYNAMICS,
    ),
)

TRAIN_PRESETS = {"paper": TrainConfig(), "general": _GENERAL, "quick": _QUICK, "allround": _ALLROUND}
"""`paper`: the paper's. `general`: ours, on planar cars by the thousand, drives where it has never been. `quick`: the
same within a few minutes, for a first look. `allround`: on every family of tracks, also those that need reversing."""
