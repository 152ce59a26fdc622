"""The fast gradient step does what Stable-Baselines3's own does."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from stable_baselines3 import TD3

from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.training.learners import build_learner, to_agent
from zebrat_bullet.training.presets import TRAIN_PRESETS

PAPER, GENERAL = TRAIN_PRESETS["paper"], TRAIN_PRESETS["general"]
STANDARDISED = replace(GENERAL, learner=replace(GENERAL.learner, standardise=True))


def learner(config, precision):
    """Return a learner with 300 made-up transitions."""
    settings = replace(
        config.learner, precision=precision, hidden=(64, 64, 64), buffer_size=1000, mirror=False, target_noise=0.0
    )
    env = ZebratEnv("track_2", task=config.task)
    model = build_learner(replace(config, learner=settings), env, env.spec_observation)
    model.set_logger(_Silent())
    rng = np.random.default_rng(0)
    for _ in range(300):
        observation, after = rng.uniform(-1, 1, (2, 1, 34)).astype(np.float32)
        action = rng.uniform(-1, 1, (1, 2)).astype(np.float32)
        model.replay_buffer.add(observation, after, action, rng.normal(size=1), np.array([rng.random() < 0.1]), [{}])
    env.close()
    return model


class _Silent:
    def record(self, *args, **kwargs):
        """Drop it."""


def weights(model):
    return torch.cat([p.detach().flatten() for p in model.policy.parameters()])


def actor_weights(model):
    return torch.cat([p.detach().flatten() for p in model.actor.parameters()])


@pytest.mark.parametrize(
    "config", [PAPER, GENERAL, STANDARDISED], ids=["one critic", "two critics, delayed actor", "standardised"]
)
def test_in_float32_it_ends_in_the_weights_of_stable_baselines(config):
    ours, theirs = learner(config, "fp32"), learner(config, "fp32")
    assert torch.equal(weights(ours), weights(theirs))
    for model in (ours, theirs):
        model.train(0)  # standardises, if it is to
    before = weights(ours)
    np.random.seed(1)
    ours.train(20, batch_size=32)
    np.random.seed(1)
    TD3.train(theirs, 20, batch_size=32)
    moved = (weights(theirs) - before).abs().max()
    assert moved > 1e-3
    assert (weights(ours) - weights(theirs)).abs().max() < 0.02 * moved


def test_in_bfloat16_it_goes_the_same_way():
    ours, theirs = learner(PAPER, "bf16"), learner(PAPER, "fp32")
    before = weights(ours)
    np.random.seed(1)
    ours.train(20, batch_size=32)
    np.random.seed(1)
    TD3.train(theirs, 20, batch_size=32)
    one, two = weights(ours) - before, weights(theirs) - before
    assert torch.nn.functional.cosine_similarity(one, two, dim=0) > 0.98


def test_a_saved_learner_goes_on_from_its_own_weights(tmp_path):
    ours = learner(PAPER, "bf16")
    np.random.seed(1)
    ours.train(5, batch_size=32)
    ours.save(tmp_path / "x.zip")
    loaded = type(ours).load(tmp_path / "x.zip")
    loaded.set_logger(_Silent())
    loaded.replay_buffer = ours.replay_buffer
    for model in (ours, loaded):
        np.random.seed(2)
        model.train(5, batch_size=32)
    assert torch.equal(weights(ours), weights(loaded))


def test_standardised_networks_see_mean_0_and_deviation_1_and_the_exported_policy_needs_no_such_step():
    model = learner(STANDARDISED, "fp32")
    seen = model.replay_buffer.observations[:300, 0]
    seen[:, 3] = 0.001 * seen[:, 3] - 0.7  # nearly constant: not blown up beyond 1 / 0.02
    model.train(5, batch_size=32)
    features = model.critic_target.features_extractor(torch.from_numpy(seen)).numpy()
    others = np.arange(34) != 3
    assert np.abs(features.mean(axis=0)).max() < 1e-4 and np.allclose(features.std(axis=0)[others], 1.0, atol=1e-3)
    assert features.std(axis=0)[3] < 0.05
    agent = to_agent(model, "x", model.replay_buffer.observation, {})
    for observation in seen[:20]:
        assert agent.action(observation) == pytest.approx(model.predict(observation)[0], abs=1e-4)


def test_the_average_follows_the_actor_and_gives_it_back():
    model = learner(replace(PAPER, learner=replace(PAPER.learner, average=10)), "fp32")
    model.train(0)
    expected = actor_weights(model)
    for _ in range(5):
        model.train(1, batch_size=32)
        expected += 0.1 * (actor_weights(model) - expected)
    own = actor_weights(model)
    with model.averaged():
        average = actor_weights(model)
    assert torch.allclose(average, expected, atol=1e-7)
    assert (average - own).abs().max() > 1e-5
    assert torch.equal(actor_weights(model), own)
