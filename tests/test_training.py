"""Training: the paper's two rates and exploration, the run folder, and a killed run that goes on."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import EpisodeConfig, LidarConfig, TaskConfig, to_json, with_overrides
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError, PolicyError, ZebratError
from zebrat_bullet.training.checkpoint import load_checkpoint
from zebrat_bullet.training.ddpg import actor_to_agent, build_ddpg
from zebrat_bullet.training.logs import EPISODE_COLUMNS, CsvLog
from zebrat_bullet.training.presets import TRAIN_PRESETS, TrainConfig
from zebrat_bullet.training.run import resume, summarise, train

TINY = TrainConfig(
    worlds=("track_2",),
    episodes=8,
    hidden=(16, 16),
    batch_size=16,
    buffer_size=2000,
    warmup_steps=20,
    eval_every=4,
    eval_episodes=1,
    checkpoint_every=2,
    task=TaskConfig(lidar=LidarConfig(caster="embree", n_channels=4), episode=EpisodeConfig(max_steps=60)),
)


@pytest.fixture
def learner():
    env = ZebratEnv("track_2", task=TINY.task)
    yield build_ddpg(TINY, env, env.spec_observation), env
    env.close()


def test_the_paper_preset_is_the_papers():
    paper = TRAIN_PRESETS["paper"]
    assert (paper.actor_lr, paper.critic_lr, paper.hidden) == (1e-4, 2e-4, (512, 512))
    assert (paper.buffer_size, paper.batch_size, paper.gamma, paper.tau) == (200_000, 64, 0.99, 0.005)
    assert (paper.epsilon, paper.sigma, paper.episodes) == (0.8, 0.1, 1000)
    assert paper.n_critics == paper.policy_delay == paper.n_step == 1 and not paper.mirror


def test_actor_and_critic_keep_their_own_rates(learner):
    model, _ = learner
    model._update_learning_rate([model.actor.optimizer, model.critic.optimizer])
    assert model.actor.optimizer.param_groups[0]["lr"] == 1e-4
    assert model.critic.optimizer.param_groups[0]["lr"] == 2e-4


def test_epsilon_falls_linearly_over_the_episodes_to_zero(learner):
    model, _ = learner
    seen = []
    for model._episode_num in (0, 4, 8, 9):
        seen.append(model.epsilon)
    assert seen == pytest.approx([0.8, 0.4, 0.0, 0.0])


def test_exploration_is_uniform_with_probability_epsilon_and_else_near_the_policy(learner):
    model, env = learner
    observation, _ = env.reset(seed=0)
    model._last_obs = np.repeat(observation[None], 2000, axis=0)
    model.num_timesteps, model._episode_num = 1000, 4
    policy, _ = model.predict(observation)
    actions, stored = model._sample_action(20, n_envs=2000)
    near = (np.abs(actions - policy) < 0.5).all(axis=1).mean()
    assert np.array_equal(actions, stored) and np.abs(actions).max() <= 1.0
    assert 0.6 + 0.4 * 0.2 < near < 0.6 + 0.4 * 0.35  # a uniform action is as near in about 0.25 of all cases


def test_the_exported_policy_acts_as_the_actor_does(learner, tmp_path):
    model, env = learner
    agent = actor_to_agent(model, "x", env.spec_observation, {})
    for seed in range(5):
        observation = np.random.default_rng(seed).uniform(-1, 1, 34).astype(np.float32)
        with torch.no_grad():
            expected = model.actor(torch.from_numpy(observation)[None])[0].numpy()
        assert agent.action(observation) == pytest.approx(expected, abs=1e-5)


def test_a_mirrored_batch_is_half_mirrored(learner):
    model, _ = learner
    config = replace(TINY, mirror=True, reward_scale=0.1)
    buffer = build_ddpg(config, model.env, ZebratEnv("track_2", task=TINY.task).spec_observation).replay_buffer
    row = np.arange(34, dtype=np.float32)[None]
    for _ in range(40):
        buffer.add(row, row, np.array([[0.5, 0.5]], np.float32), np.array([10.0]), np.array([False]), [{}])
    samples = buffer.sample(10)
    assert (samples.actions[:5, 1] == -0.5).all() and (samples.actions[5:, 1] == 0.5).all()
    assert (samples.observations[:5, 12] == 20).all() and (samples.observations[5:, 12] == 12).all()
    assert torch.allclose(samples.rewards, torch.tensor(1.0))


def test_a_run_leaves_all_that_is_needed_to_trust_it(tmp_path):
    folder = tmp_path / "run"
    train(TINY, folder)
    rows = CsvLog(folder / "episodes.csv", EPISODE_COLUMNS).rows()
    assert [int(row["episode"]) for row in rows] == list(range(1, 9))
    assert all((folder / name).exists() for name in ("best.safetensors", "best.zip", "last.safetensors", "tensorboard"))
    versions = json.loads((folder / "versions.json").read_text())
    assert versions["versions"]["torch"] == torch.__version__
    assert summarise(folder)["episodes"] == 8
    assert load_agent(str(folder), TaskConfig()).provenance["config"]["episodes"] == 8
    with pytest.raises(ConfigError, match="holds a run already"):
        train(TINY, folder)


def kill_after_episode(folder, config, episode: int) -> None:
    """Train in a process of its own and kill it without warning once so many episodes are logged."""
    code = (
        "import sys; from pathlib import Path; from zebrat_bullet.config import from_json; "
        "from zebrat_bullet.training.presets import TrainConfig; from zebrat_bullet.training.run import train; "
        "train(from_json(TrainConfig, sys.argv[1]), Path(sys.argv[2]))"
    )
    process = subprocess.Popen([sys.executable, "-c", code, to_json(config), str(folder)], stderr=subprocess.DEVNULL)
    log = folder / "episodes.csv"
    while process.poll() is None:
        if log.exists() and len(log.read_text().splitlines()) > episode:
            break
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()


def test_a_killed_run_resumes_and_ends_in_the_same_weights_as_one_never_killed(tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    config = replace(TINY, episodes=12)
    train(config, whole)
    kill_after_episode(killed, config, 5)
    logged = len(CsvLog(killed / "episodes.csv", EPISODE_COLUMNS).rows())
    assert 5 <= logged < 12
    resume(killed)
    rows = CsvLog(killed / "episodes.csv", EPISODE_COLUMNS).rows()
    assert [int(row["episode"]) for row in rows] == list(range(1, 13))
    one, two = load_file(whole / "last.safetensors"), load_file(killed / "last.safetensors")
    assert all(np.array_equal(one[key], two[key]) for key in one)


def test_several_environments_feed_one_learner(tmp_path):
    train(replace(TINY, n_envs=2, episodes=6), tmp_path / "run")
    rows = CsvLog(tmp_path / "run" / "episodes.csv", EPISODE_COLUMNS).rows()
    assert {row["env"] for row in rows} == {"0", "1"}


def test_what_cannot_be_resumed_says_why(tmp_path):
    with pytest.raises(ConfigError, match="holds no training run"):
        resume(tmp_path)
    with pytest.raises(ZebratError, match="no checkpoint was written yet"):
        load_checkpoint(tmp_path / "checkpoint", None)


def test_a_lopsided_car_is_not_trained_on_mirrored_transitions(tmp_path):
    lopsided = replace(TINY, mirror=True, task=replace(TINY.task, robot="hexagon"))
    with pytest.raises(ConfigError, match="'hexagon' is not: set mirror=false"):
        train(lopsided, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_overrides_reach_nested_settings_and_refuse_unknown_ones():
    config = with_overrides(TINY, ["batch_size=128", "task.reward.log_base=2.5", "task.reward.weights.M=0"])
    assert config.batch_size == 128 and config.task.reward.log_base == 2.5 and config.task.reward.weights["M"] == 0
    with pytest.raises(ConfigError, match=r"cannot set 'bach_size=1'.*batch_size"):
        with_overrides(TINY, ["bach_size=1"])
    with pytest.raises(ConfigError, match="tau must be in"):
        with_overrides(TINY, ["tau=3"])


def test_a_file_that_is_no_policy_is_refused(tmp_path):
    (tmp_path / "x.safetensors").write_bytes(b"nothing at all")
    with pytest.raises(PolicyError, match="not a safetensors file"):
        load_agent(str(tmp_path / "x.safetensors"), TaskConfig())


def test_fine_tuning_begins_with_the_networks_of_the_best_model(tmp_path):
    train(replace(TINY, episodes=4), tmp_path / "first")
    first = load_file(tmp_path / "first" / "best.safetensors")
    config = replace(TINY, episodes=1, seed=9, warmup_steps=1000, init=str(tmp_path / "first" / "best.zip"))
    train(config, tmp_path / "second")  # one random episode: nothing is learned, so the networks are as they began
    second = load_file(tmp_path / "second" / "last.safetensors")
    assert all(np.array_equal(first[key], second[key]) for key in first)


def test_held_random_actions_stay_the_same_for_several_steps_and_keep_the_share_epsilon(learner):
    _, env = learner
    model = build_ddpg(replace(TINY, hold_steps=8, epsilon=0.3), learner[0].env, env.spec_observation)
    explores, held = [], []
    for _ in range(4000):
        explores.append(bool(model._hold_random_actions(1)[0, 0]))
        held.append(tuple(model._held[0]) if explores[-1] else None)
    lengths = [len(list(steps)) for action, steps in groupby(held) if action is not None]
    assert np.mean(explores) == pytest.approx(0.3, abs=0.04)
    assert max(lengths) == 8 and np.mean(lengths) == pytest.approx(4.5, abs=0.5)


def test_learning_rates_fall_to_their_final_share(learner):
    _, env = learner
    model = build_ddpg(replace(TINY, lr_final=0.1), learner[0].env, env.spec_observation)
    model._episode_num = TINY.episodes
    model._update_learning_rate([])
    assert model.actor.optimizer.param_groups[0]["lr"] == pytest.approx(1e-5)
