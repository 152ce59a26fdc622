"""Settings that are classes are held to the kinds of values that text is."""

import numpy as np
import pytest

from zebrat_bullet.config import (
    DisturbanceConfig,
    DynamicsConfig,
    EpisodeConfig,
    LidarConfig,
    NoiseConfig,
    ObservationConfig,
    RewardConfig,
    TaskConfig,
)
from zebrat_bullet.errors import ConfigError


@pytest.mark.parametrize(
    ("kind", "values", "said"),
    [
        (TaskConfig, {"episode": {"max_steps": 3}}, r"episode must be EpisodeConfig, got \{'max_steps': 3\}"),
        (TaskConfig, {"robot": 3}, "robot must be a text, got 3"),
        (EpisodeConfig, {"max_steps": "5"}, "max_steps must be a whole number, got '5'"),
        (EpisodeConfig, {"max_steps": 2.5}, "max_steps must be a whole number, got 2.5"),
        (EpisodeConfig, {"max_steps": None}, "max_steps must be a whole number, got None"),
        (NoiseConfig, {"range_sigma_m": "a"}, "range_sigma_m must be a number, got 'a'"),
        (NoiseConfig, {"mount_xyz_m": ("a", 0, 0)}, "mount_xyz_m must be a tuple of 3 numbers"),
        (NoiseConfig, {"mount_xyz_m": (0.1,)}, "mount_xyz_m must be a tuple of 3 numbers"),
        (DynamicsConfig, {"delay_s": 0.01}, "delay_s must be a tuple of 2 numbers"),
        (EpisodeConfig, {"max_steps": True}, "max_steps must be a whole number, got True"),
        (ObservationConfig, {"trail_steps": 5}, "trail_steps must be a tuple of numbers, got 5"),
        (RewardConfig, {"stall": "a"}, "stall must be a number or None, got 'a'"),
        (RewardConfig, {"weights": {"F": "1"}}, "weights: F must be a number, got '1'"),
        (ObservationConfig, {"log_gaps": "no"}, "log_gaps must be True or False, got 'no'"),
        (RewardConfig, {"weights": ["F"]}, r"weights must be a mapping, got \['F'\]"),
        (LidarConfig, {"caster": None}, "caster must be a text, got None"),
    ],
)
def test_a_value_of_another_kind_is_refused_by_its_name(kind, values, said):
    with pytest.raises(ConfigError, match=said):
        kind(**values)


def test_numbers_of_numpy_are_numbers_and_a_list_is_a_tuple():
    assert NoiseConfig(range_sigma_m=np.float32(0.5)).range_sigma_m == 0.5
    assert ObservationConfig(trail_steps=np.array([5, 20])).trail_steps == (5, 20)
    assert DynamicsConfig(delay_s=[0, 0.01]).delay_s == [0, 0.01]
    assert EpisodeConfig(max_steps=np.int32(7)).max_steps == 7
    assert EpisodeConfig(max_steps=1e3).max_steps == 1000
    assert DisturbanceConfig(friction=0.5).friction == 0.5
    assert RewardConfig(false_exit=1.0).false_exit == 1.0
