"""The fast gradient step does what Stable-Baselines3's own does."""

from dataclasses import replace

import numpy as np
import torch
from stable_baselines3 import DDPG

from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.training.ddpg_update import DDPGUpdate
from zebrat_bullet.training.learners import build_learner
from zebrat_bullet.training.presets import TRAIN_PRESETS

PAPER = TRAIN_PRESETS["paper"]


def learner(precision, cloning=0.0):
    """Return a learner with 300 made-up transitions."""
    settings = replace(PAPER.learner, precision=precision, cloning=cloning, hidden=(64, 64, 64), buffer_size=1000)
    env = ZebratEnv("track_2", task=PAPER.task)
    model = build_learner(replace(PAPER, learner=settings), env)
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


def test_in_float32_it_ends_in_the_weights_of_stable_baselines():
    ours, theirs = learner("fp32"), learner("fp32")
    assert torch.equal(weights(ours), weights(theirs))
    before = weights(ours)
    np.random.seed(1)
    ours.train(20, batch_size=32)
    np.random.seed(1)
    DDPG.train(theirs, 20, batch_size=32)
    moved = (weights(theirs) - before).abs().max()
    assert moved > 1e-3
    assert (weights(ours) - weights(theirs)).abs().max() < 0.02 * moved


def test_in_bfloat16_it_goes_the_same_way():
    ours, theirs = learner("bf16"), learner("fp32")
    before = weights(ours)
    np.random.seed(1)
    ours.train(20, batch_size=32)
    np.random.seed(1)
    DDPG.train(theirs, 20, batch_size=32)
    one, two = weights(ours) - before, weights(theirs) - before
    assert torch.nn.functional.cosine_similarity(one, two, dim=0) > 0.98


def test_a_saved_learner_goes_on_from_its_own_weights(tmp_path):
    ours = learner("bf16")
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


def test_cloning_draws_the_actor_to_the_actions_of_the_replay_as_td3_bc_does():
    model = learner("fp32", cloning=3.0)
    batch = model.replay_buffer.sample(64)
    action = model.actor(batch.observations)
    values = model.critic.q1_forward(batch.observations, action)
    apart = torch.nn.functional.mse_loss(action, batch.actions)
    loss = 3.0 * values.detach().abs().mean() * apart - values.mean()
    expected = torch.autograd.grad(loss, list(model.actor.mu.parameters()))
    DDPGUpdate(model, "fp32", cloning=3.0).actor_step(batch)
    for parameter, gradient in zip(model.actor.mu.parameters(), expected, strict=True):
        assert torch.allclose(parameter.grad, gradient, rtol=1e-4, atol=1e-6 * gradient.abs().max())


def test_a_learner_that_clones_strongly_ends_nearer_to_the_actions_of_its_replay():
    def distance(cloning):
        model = learner("fp32", cloning)
        np.random.seed(1)
        model.train(100, batch_size=64)
        batch = model.replay_buffer.sample(300)
        return (model.actor(batch.observations) - batch.actions).square().mean()

    assert distance(1000.0) < 0.9 * distance(0.0)
