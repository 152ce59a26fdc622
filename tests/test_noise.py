"""The noise model is seeded, has the statistics it is asked for, and invents no returns."""

import numpy as np
import pytest

from zebrat_bullet.config import NoiseConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.sensing.noise import NoiseModel

REACH = 6.0
N = 50_000
SEEN = np.full(N, 3.0, np.float32)
UNSEEN = np.full(N, REACH, np.float32)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_no_noise_changes_nothing_and_draws_nothing() -> None:
    generator = rng()
    assert NoiseModel(NoiseConfig()).apply(SEEN, REACH, generator) is SEEN
    assert generator.random() == rng().random()


def test_range_noise_has_its_sigma_and_no_bias() -> None:
    error = NoiseModel(NoiseConfig(range_sigma_m=0.008)).apply(SEEN, REACH, rng()) - 3.0
    assert error.dtype == np.float32
    assert error.std() == pytest.approx(0.008, rel=0.02)
    assert abs(error.mean()) < 4 * 0.008 / np.sqrt(N)


def test_dropout_loses_its_share_of_returns() -> None:
    ranges = NoiseModel(NoiseConfig(dropout=0.1)).apply(SEEN, REACH, rng())
    assert set(np.unique(ranges)) == {np.float32(3.0), np.float32(REACH)}
    assert (ranges == REACH).mean() == pytest.approx(0.1, abs=4 * np.sqrt(0.1 * 0.9 / N))


def test_noise_invents_no_returns() -> None:
    ranges = NoiseModel(NoiseConfig(range_sigma_m=0.5, dropout=0.5)).apply(UNSEEN, REACH, rng())
    assert (ranges == REACH).all()


def test_noisy_ranges_stay_between_zero_and_the_reach() -> None:
    near_and_far = np.array([0.01, 5.99] * 1000, np.float32)
    ranges = NoiseModel(NoiseConfig(range_sigma_m=0.1)).apply(near_and_far, REACH, rng())
    assert ranges.min() == 0.0 and ranges.max() == REACH


def test_the_same_seed_gives_the_same_noise_and_leaves_the_input_alone() -> None:
    model, kept = NoiseModel(NoiseConfig(range_sigma_m=0.008, dropout=0.05)), SEEN.copy()
    first, again, other = (model.apply(SEEN, REACH, rng(seed)) for seed in (1, 1, 2))
    assert (first == again).all() and (first != other).any() and (kept == SEEN).all()


def test_later_noise_does_not_depend_on_what_was_seen_before() -> None:
    model = NoiseModel(NoiseConfig(range_sigma_m=0.008, dropout=0.05))
    after_seen, after_unseen = rng(), rng()
    model.apply(SEEN, REACH, after_seen)
    model.apply(UNSEEN, REACH, after_unseen)
    assert (model.apply(SEEN, REACH, after_seen) == model.apply(SEEN, REACH, after_unseen)).all()


@pytest.mark.parametrize("wrong", [{"range_sigma_m": -0.1}, {"dropout": 1.5}])
def test_impossible_noise_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        NoiseConfig(**wrong)
