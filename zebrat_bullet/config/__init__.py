"""Every setting of the car, its senses and its task: frozen, validated once, varied by `dataclasses.replace`."""

from zebrat_bullet.config.car import (
    ENGINES,
    FOOTPRINTS,
    RANDOM_DYNAMICS,
    DisturbanceConfig,
    DynamicsConfig,
    PhysicsConfig,
)
from zebrat_bullet.config.checks import MOST_SEED, Range, at_least_one, none_negative, shares, within
from zebrat_bullet.config.senses import (
    CASTERS,
    VLP16_NOISE,
    FlattenConfig,
    LidarConfig,
    NoiseConfig,
    SafetyRegionConfig,
)
from zebrat_bullet.config.task import (
    MOST_TRAIL_STEPS,
    REWARD_PRESETS,
    EpisodeConfig,
    ObservationConfig,
    RewardConfig,
    TaskConfig,
    require_planar_cars,
    with_engine,
    with_reward,
)

__all__ = [
    "CASTERS",
    "ENGINES",
    "FOOTPRINTS",
    "MOST_SEED",
    "MOST_TRAIL_STEPS",
    "RANDOM_DYNAMICS",
    "REWARD_PRESETS",
    "VLP16_NOISE",
    "DisturbanceConfig",
    "DynamicsConfig",
    "EpisodeConfig",
    "FlattenConfig",
    "LidarConfig",
    "NoiseConfig",
    "ObservationConfig",
    "PhysicsConfig",
    "Range",
    "RewardConfig",
    "SafetyRegionConfig",
    "TaskConfig",
    "at_least_one",
    "none_negative",
    "require_planar_cars",
    "shares",
    "with_engine",
    "with_reward",
    "within",
]
