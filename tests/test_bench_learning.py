"""Learning is timed side by side with Stable-Baselines3's own."""

from dataclasses import replace

import pytest

from zebrat_bullet.bench.learning import bench_learning, bench_planar_learning
from zebrat_bullet.config import LidarConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.training.learner_settings import DDPGConfig
from zebrat_bullet.training.presets import paper_config
from zebrat_bullet.training.settings import TrainConfig

TINY = TrainConfig(
    learner=DDPGConfig(hidden=(16, 16), batch_size=16, buffer_size=2000, warmup_steps=20),
    worlds=("track_2",),
    task=TaskConfig(lidar=LidarConfig(caster="embree", n_channels=4)),
)


def test_each_way_of_learning_is_timed_and_compared_with_the_fastest_plain_one():
    result = bench_learning(TINY, n_steps=40, rounds=1)
    plain = [at for name, at in result.items() if name.startswith("Stable-Baselines3")]
    assert len(plain) == 2 and len(result) == 5 and max(at["times_plain"] for at in plain) == 1.0
    for at in result.values():
        assert at["update_ms"] > 0 and at["rest_ms"] > 0
        assert at["steps_per_s"] == pytest.approx(1e3 / (at["update_ms"] + at["rest_ms"]))


def test_what_cannot_be_timed_is_refused():
    with pytest.raises(ConfigError, match=r"only DDPG can be timed.*'sac'"):
        bench_learning(paper_config("sac", "fomt"), 10, 1)
    with pytest.raises(ConfigError, match="must be at least 1, got 0 and 1"):
        bench_learning(replace(TINY, seed=1), 0, 1)


def test_learning_on_planar_cars_is_timed_with_each_number_of_threads():
    result = bench_planar_learning(8, "cpu", rounds=1, seed=0)
    assert "1 thread" in result
    for at in result.values():
        assert at["steps_per_s"] == pytest.approx(1e6 / (at["update_us"] + at["rest_us"]))
