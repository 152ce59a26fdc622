"""RL Zoo trains on our environments with the hyperparameter files that we ship."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from zebrat_bullet.assets import asset_folder, list_assets
from zebrat_bullet.envs.registration import env_id
from zebrat_bullet.training.learner_settings import DDPGConfig, DQNConfig, PPOConfig, SACConfig

PAPER = {"ddpg": DDPGConfig(), "dqn": DQNConfig(), "sac": SACConfig(), "ppo": PPOConfig()}


def conf_file(algo: str) -> Path:
    return asset_folder("rl_zoo") / f"{algo}.yml"


@pytest.mark.parametrize("algo", PAPER)
def test_a_file_holds_what_zebrat_train_has(algo):
    theirs, ours = yaml.safe_load(conf_file(algo).read_text(encoding="utf-8"))["default"], PAPER[algo]
    for name in (
        "buffer_size",
        "batch_size",
        "gamma",
        "tau",
        "n_steps",
        "n_epochs",
        "gae_lambda",
        "clip_range",
        "ent_coef",
    ):
        assert theirs.get(name) == getattr(ours, name, None), name
    assert theirs["learning_rate"] == (ours.actor_lr if algo == "ddpg" else ours.lr)
    assert theirs.get("learning_starts") == getattr(ours, "warmup_steps", None)
    assert theirs.get("noise_std") == getattr(ours, "sigma", None)
    assert str(list(ours.hidden)) in str(theirs["policy_kwargs"])
    if algo == "dqn":
        assert (theirs["exploration_initial_eps"], theirs["exploration_final_eps"]) == (ours.epsilon, 0.0)


def test_there_is_a_file_for_every_algorithm_that_the_zoo_has_of_the_papers():
    assert list_assets("rl_zoo", ".yml") == sorted(PAPER)


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["ddpg", "dqn"])
def test_the_zoo_trains_evaluates_and_saves(algo, tmp_path):
    pytest.importorskip("rl_zoo3")
    env = env_id("track_2", discrete=algo == "dqn")
    command = [sys.executable, "-m", "rl_zoo3.train", "--algo", algo, "--env", env, "--gym-packages", "zebrat_bullet"]
    command += [
        "--conf-file",
        str(conf_file(algo)),
        "--n-timesteps",
        "260",
        "--eval-freq",
        "230",
        "--eval-episodes",
        "1",
    ]
    command += ["--num-threads", "1", "--seed", "0", "--log-folder", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (run,) = (tmp_path / algo).iterdir()
    saved = {path.name for path in run.iterdir()}
    assert {"best_model.zip", f"{env.replace('/', '-')}.zip", "evaluations.npz"} <= saved
    assert "env_kwargs={'caster': 'embree'}" in done.stdout and "n_updates" in done.stdout
    assert np.isfinite(np.load(run / "evaluations.npz")["results"]).all()
    enjoy = [sys.executable, "-m", "rl_zoo3.enjoy", "--gym-packages", "zebrat_bullet", "--no-render"]
    # This script of the zoo imports no packages of others.
    film = 'import runpy, zebrat_bullet; runpy.run_module("rl_zoo3.record_video", run_name="__main__", alter_sys=True)'
    for script in (enjoy, [sys.executable, "-c", film]) if algo == "ddpg" else (enjoy,):
        shown = [*script, "--algo", algo, "--env", env, "-f", str(tmp_path), "--exp-id", "1", "-n", "10"]
        done = subprocess.run(shown, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert len(list(run.glob("videos/*.mp4"))) == (algo == "ddpg")
