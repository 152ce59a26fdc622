"""Training: the paper's two rates and exploration, the run folder, and a killed run that goes on."""

import base64
import contextlib
import io
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from own_cars import OwnCar
from safetensors.numpy import load_file

from zebrat_bullet.agents import load_agent
from zebrat_bullet.assets import find_asset
from zebrat_bullet.cli import main
from zebrat_bullet.config import EpisodeConfig, LidarConfig, TaskConfig
from zebrat_bullet.config_text import from_json, overrides_of, to_json, with_overrides
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError, PolicyError, ZebratError
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.evaluation.records import load_record
from zebrat_bullet.task.observation import DISCRETE_COMMANDS
from zebrat_bullet.training.checkpoint import load_checkpoint
from zebrat_bullet.training.collapses import WatchdogConfig
from zebrat_bullet.training.learner_settings import DDPGConfig
from zebrat_bullet.training.learners import DISCRETE, build_learner
from zebrat_bullet.training.logs import EPISODE_COLUMNS, EVALUATION_COLUMNS
from zebrat_bullet.training.networks import to_agent
from zebrat_bullet.training.presets import ALGORITHMS, TRAIN_PRESETS, paper_config
from zebrat_bullet.training.run import resume, train
from zebrat_bullet.training.run_folder import evaluations, is_finished, summarise
from zebrat_bullet.training.settings import PlanarConfig, TrainConfig
from zebrat_bullet.training.tensors import begin_with
from zebrat_bullet.training.watchdog import WATCHDOG_COLUMNS
from zebrat_bullet.world import load_world

TINY = TrainConfig(
    learner=DDPGConfig(hidden=(16, 16), batch_size=16, buffer_size=2000, warmup_steps=20),
    worlds=("track_2",),
    episodes=8,
    eval_every=4,
    eval_episodes=1,
    checkpoint_every=2,
    task=TaskConfig(lidar=LidarConfig(caster="embree", n_channels=4), episode=EpisodeConfig(max_steps=60)),
)


def tiny(algo: str) -> TrainConfig:
    """Return a run of another algorithm, as small."""
    small = {"hidden": (16, 16), "batch_size": 16} | (
        {"n_steps": 50} if algo.startswith("ppo") else {"buffer_size": 2000, "warmup_steps": 20}
    )
    return replace(TINY, learner=replace(ALGORITHMS[algo], **small))


@pytest.fixture
def learner():
    env = ZebratEnv("track_2", task=TINY.task)
    yield build_learner(TINY, env), env
    env.close()


def test_the_paper_preset_is_the_papers():
    run = TRAIN_PRESETS["paper"]
    paper = run.learner
    assert run == paper_config("ddpg", "fomt")
    assert (paper.actor_lr, paper.critic_lr, paper.hidden) == (1e-4, 2e-4, (512, 512))
    assert (paper.buffer_size, paper.batch_size, paper.gamma, paper.tau) == (200_000, 64, 0.99, 0.005)
    assert (paper.epsilon, paper.sigma, run.episodes) == (0.8, 0.1, 1000)
    assert all(learner.hidden == (512, 512) and learner.algo == name for name, learner in ALGORITHMS.items())


def test_actor_and_critic_keep_their_own_rates(learner):
    model, _ = learner
    model._update_learning_rate([model.actor.optimizer, model.critic.optimizer])
    assert model.actor.optimizer.param_groups[0]["lr"] == 1e-4
    assert model.critic.optimizer.param_groups[0]["lr"] == 2e-4


def test_epsilon_falls_linearly_over_the_episodes_to_zero(learner):
    model, _ = learner
    seen = []
    for model._episode_num in (0, 4, 8, 9):
        model._update_current_progress_remaining(100, 10**9)
        seen.append(model.epsilon)
    assert seen == pytest.approx([0.8, 0.4, 0.0, 0.0])


def test_a_length_in_steps_ends_the_schedules_too(learner):
    model, _ = learner
    model.n_steps_of_run = 400
    seen = []
    for steps in (100, 300, 400):
        model._update_current_progress_remaining(steps, 10**9)
        seen.append(model.epsilon)
    assert seen == pytest.approx([0.6, 0.2, 0.0])


def test_exploration_is_uniform_with_probability_epsilon_and_else_near_the_policy(learner):
    model, env = learner
    observation, _ = env.reset(seed=0)
    model._last_obs = np.repeat(observation[None], 2000, axis=0)
    model.num_timesteps, model._current_progress_remaining = 1000, 0.5
    policy, _ = model.predict(observation)
    actions, stored = model._sample_action(20, n_envs=2000)
    near = (np.abs(actions - policy) < 0.5).all(axis=1).mean()
    assert np.array_equal(actions, stored) and np.abs(actions).max() <= 1.0
    assert 0.6 + 0.4 * 0.2 < near < 0.6 + 0.4 * 0.35  # a uniform action is as near in about 0.25 of all cases


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_the_exported_policy_acts_as_the_learner_predicts(algo):
    env = ZebratEnv("track_2", task=TINY.task, discrete=algo in DISCRETE)
    model = build_learner(tiny(algo), env)
    if algo.startswith("ppo"):  # its last layer begins so small that no clip shows
        with torch.no_grad():
            model.policy.action_net.weight.mul_(300.0)
    agent = to_agent(model, "x", env.spec_observation, {})
    for seed in range(5):
        observation = np.random.default_rng(seed).uniform(-1, 1, 34).astype(np.float32)
        expected, _ = model.predict(observation, deterministic=True)
        assert agent.action(observation) == pytest.approx(
            DISCRETE_COMMANDS[int(expected)] if algo in DISCRETE else expected, abs=1e-5
        )
    env.close()


def test_a_run_leaves_all_that_is_needed_to_trust_it(tmp_path):
    folder = tmp_path / "run"
    train(TINY, folder)
    rows = CsvLog(folder / "episodes.csv", EPISODE_COLUMNS).rows()
    assert [int(row["episode"]) for row in rows] == list(range(1, 9))
    assert all((folder / name).exists() for name in ("best.safetensors", "best.zip", "last.safetensors", "tensorboard"))
    versions = json.loads((folder / "versions.json").read_text(encoding="utf-8"))
    assert versions["versions"]["torch"] == torch.__version__
    assert summarise(folder)["episodes"] == 8
    assert load_agent(str(folder), TaskConfig()).provenance["config"]["episodes"] == 8
    with pytest.raises(ConfigError, match="holds a run already"):
        train(TINY, folder)


def kill_after_episode(folder, config, episode: int) -> None:
    """Train in a process of its own and kill it without warning once so many episodes are logged."""
    code = (
        "import sys; from pathlib import Path; from zebrat_bullet.config_text import from_json; "
        "from zebrat_bullet.training.presets import TrainConfig; from zebrat_bullet.training.run import train; "
        "train(from_json(TrainConfig, sys.argv[1]), Path(sys.argv[2]))"
    )
    process = subprocess.Popen([sys.executable, "-c", code, to_json(config), str(folder)], stderr=subprocess.DEVNULL)
    log = folder / "episodes.csv"
    while process.poll() is None:
        if log.exists() and len(log.read_text(encoding="utf-8").splitlines()) > episode:
            break
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_a_killed_run_resumes_and_ends_in_the_same_weights_as_one_never_killed(algo, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    config = replace(tiny(algo), episodes=12)
    train(config, whole)
    kill_after_episode(killed, config, 7)
    logged = len(CsvLog(killed / "episodes.csv", EPISODE_COLUMNS).rows())
    assert 7 <= logged < 12 and not is_finished(killed)
    resume(killed)
    assert is_finished(killed)
    rows = [CsvLog(folder / "episodes.csv", EPISODE_COLUMNS).rows() for folder in (whole, killed)]
    assert [int(row["episode"]) for row in rows[1]] == list(range(1, 13))
    assert [row["return"] for row in rows[0]] == [row["return"] for row in rows[1]]
    one, two = load_file(whole / "last.safetensors"), load_file(killed / "last.safetensors")
    assert all(np.array_equal(one[key], two[key]) for key in one)


@pytest.mark.parametrize("algo", ["ddpg", "ppo"])
def test_a_fine_tuning_killed_before_its_first_checkpoint_resumes(algo, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    train(replace(tiny(algo), episodes=2), tmp_path / "first")
    config = replace(tiny(algo), init=str(tmp_path / "first" / "best.zip"), seed=5, checkpoint_every=100)
    train(config, whole)
    kill_after_episode(killed, config, 2)
    assert not is_finished(killed)
    resume(killed)
    assert [row["episode"] for row in evaluations(killed)] == [row["episode"] for row in evaluations(whole)]
    one, two = load_file(whole / "last.safetensors"), load_file(killed / "last.safetensors")
    assert all(np.array_equal(one[key], two[key]) for key in one)


@pytest.mark.parametrize("algo", ["ddpg", "sac"])
def test_environments_in_processes_of_their_own_change_no_number(algo, tmp_path):
    config = replace(tiny(algo), n_envs=2)
    train(config, tmp_path / "one")
    train(replace(config, overlap=True), tmp_path / "several")
    one, two = (load_file(tmp_path / name / "last.safetensors") for name in ("one", "several"))
    assert all(np.array_equal(one[key], two[key]) for key in one)


def test_a_run_resumed_from_another_folder_goes_on_in_its_own_world(tmp_path, monkeypatch):
    text = find_asset("worlds", "track_2", ".yaml").read_text(encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    train(replace(TINY, worlds=("mine.yaml",), eval_worlds=("mine.yaml", "track_1"), episodes=1), Path("run"))
    config = json.loads(Path("run/config.json").read_text(encoding="utf-8"))
    assert config["worlds"] == [f"{tmp_path}/mine.yaml"] and config["eval_worlds"] == [
        f"{tmp_path}/mine.yaml",
        "track_1",
    ]


def test_a_run_whose_world_or_car_was_edited_is_not_resumed(tmp_path):
    car, world = tmp_path / "mine.urdf", tmp_path / "mine.yaml"
    car.write_text(OwnCar().urdf(), encoding="utf-8")
    text = find_asset("worlds", "track_2", ".yaml").read_text(encoding="utf-8")
    world.write_text(text, encoding="utf-8")
    run = tmp_path / "run"
    config = replace(TINY, worlds=(str(world),), task=replace(TINY.task, robot=str(car)), episodes=1)
    train(config, run)
    (run / "summary.json").unlink()  # as if it were not over
    world.write_text(text.replace("{straight: 3.2, width: 1.35}", "{straight: 3.3, width: 1.35}"), encoding="utf-8")
    with pytest.raises(ConfigError, match=rf"cannot be resumed: world {world} changed since it began; put it back"):
        resume(run)
    world.write_text(text + "# a remark changes nothing\n", encoding="utf-8")
    car.write_text(OwnCar(half_base=0.17).urdf(), encoding="utf-8")
    with pytest.raises(ConfigError, match=rf"cannot be resumed: robot {car} changed.*--set init={run / 'best.zip'}$"):
        resume(run)
    (run / "best.zip").unlink()  # there is none before the first evaluation
    with pytest.raises(ConfigError, match=r"put it back as it was, or begin a new run$"):
        resume(run)


def test_a_collapse_is_named_and_its_episode_kept_and_the_run_goes_on(tmp_path):
    run = tmp_path / "run"
    watchdog = WatchdogConfig(patience=1, min_share=0.0, crash_steps=60, still_m=100.0)  # names any failure
    train(replace(TINY, watchdog=watchdog), run)
    found = CsvLog(run / "watchdog.csv", WATCHDOG_COLUMNS).rows()
    assert {row["episode"] for row in found} == {"4", "8"} and summarise(run)["episodes"] == 8
    shown = sorted((run / "collapse").glob("episode_00004_*.npz"))
    assert shown and load_record(shown[0]).outcome != "success"


def test_several_environments_feed_one_learner(tmp_path):
    train(replace(TINY, n_envs=2, episodes=6), tmp_path / "run")
    rows = CsvLog(tmp_path / "run" / "episodes.csv", EPISODE_COLUMNS).rows()
    assert {row["env"] for row in rows} == {"0", "1"}


def test_what_cannot_be_resumed_says_why(tmp_path):
    with pytest.raises(ConfigError, match="holds no training run"):
        resume(tmp_path)
    with pytest.raises(ZebratError, match="no checkpoint was written yet"):
        load_checkpoint(tmp_path / "checkpoint", None)


def test_overrides_reach_nested_settings_and_refuse_unknown_ones():
    config = with_overrides(TINY, ["learner.batch_size=128", "task.reward.log_base=2.5", "task.reward.weights.M=0"])
    assert (
        config.learner.batch_size == 128 and config.task.reward.log_base == 2.5 and config.task.reward.weights["M"] == 0
    )
    with pytest.raises(ConfigError, match=r"cannot set 'learner.bach_size=1'.*batch_size"):
        with_overrides(TINY, ["learner.bach_size=1"])
    with pytest.raises(ConfigError, match="tau must be in"):
        with_overrides(TINY, ["learner.tau=3"])


def test_settings_of_older_versions_are_read_without_what_is_gone():
    settings = json.loads(to_json(TINY)) | {"attempts": 30, "eval_task": None}
    settings["learner"] |= {"mirror": True, "hold_steps": 8}
    settings["watchdog"] |= {"restarts": 2}
    assert from_json(TrainConfig, json.dumps(settings)) == TINY


def test_a_yaml_file_overrides_as_key_value_texts_do(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "episodes: 7\nlearner: {hidden: [8, 8], sigma: 0.2}\ntask: {reward: {weights: {M: 0}}}\n", encoding="utf-8"
    )
    config = with_overrides(TINY, overrides_of(path))
    assert config.episodes == 7 and config.learner == replace(TINY.learner, hidden=(8, 8), sigma=0.2)
    assert config.task.reward.weights == {"F": 1.0, "O": 1.0, "M": 0.0, "T": 1.0}
    path.write_text("planar: {margin_m: {corners: 0.01, other: [0.0, 0.02]}}\n", encoding="utf-8")
    on_planar_cars = replace(TINY, episodes=1000, steps=100, planar=PlanarConfig())
    planar = with_overrides(on_planar_cars, overrides_of(path)).planar
    assert planar is not None and planar.margin_m == {"corners": 0.01, "other": (0.0, 0.02)}
    with pytest.raises(ConfigError, match="no family of tracks 'corner'"):
        with_overrides(on_planar_cars, ["planar.margin_m={corner: 0.01, other: 0.0}"])
    for never in (["steps=null"], ["episodes=3"]):
        with pytest.raises(ConfigError, match="set steps or max_minutes"):
            with_overrides(on_planar_cars, never)
    assert with_overrides(on_planar_cars, ["max_minutes=1", "steps=null"]).steps is None
    path.write_text("- episodes", encoding="utf-8")
    with pytest.raises(ConfigError, match="must hold settings as `key: value`, got list"):
        overrides_of(path)
    with pytest.raises(ConfigError, match="no such file"):
        overrides_of(tmp_path / "none.yaml")


def test_a_file_that_is_no_policy_is_refused(tmp_path):
    (tmp_path / "x.safetensors").write_bytes(b"nothing at all")
    with pytest.raises(PolicyError, match="no whole safetensors file"):
        load_agent(str(tmp_path / "x.safetensors"), TaskConfig())


def test_fine_tuning_begins_with_the_networks_of_the_best_model(tmp_path):
    train(replace(TINY, episodes=4), tmp_path / "first")
    first = load_file(tmp_path / "first" / "best.safetensors")
    config = replace(TINY, episodes=1, seed=9, init=str(tmp_path / "first" / "best.zip"))
    config = replace(config, learner=replace(config.learner, warmup_steps=1000))
    train(config, tmp_path / "second")  # one random episode: nothing is learned, so the networks are as they began
    second = load_file(tmp_path / "second" / "last.safetensors")
    assert all(np.array_equal(first[key], second[key]) for key in first)


def test_fine_tuning_that_finds_nothing_better_keeps_what_it_began_with(tmp_path, learner):
    train(replace(TINY, episodes=1), tmp_path / "first")
    stands, _ = learner
    load_checkpoint(tmp_path / "first" / "checkpoint", stands)
    for parameter in stands.actor.parameters():
        parameter.data.zero_()  # no speed, no collision
    stands.save(tmp_path / "stands.zip")
    config = replace(TINY, episodes=4, init=str(tmp_path / "stands.zip"))
    config = replace(config, learner=replace(config.learner, actor_lr=0.5, warmup_steps=1))  # full speed into a wall
    train(config, tmp_path / "second")
    judged = [(row["episode"], row["collision"], row["best"]) for row in evaluations(tmp_path / "second")]
    assert judged == [("0", "0.0", "1"), ("4", "1.0", "0")]
    kept = load_file(tmp_path / "second" / "best.safetensors")
    assert kept and not any(weights.any() for weights in kept.values())


def test_the_policy_that_is_fine_tuned_drives_while_its_critic_learns_first(tmp_path, learner):
    train(replace(TINY, episodes=4), tmp_path / "first")
    first, init = load_file(tmp_path / "first" / "best.safetensors"), str(tmp_path / "first" / "best.zip")

    def moved(critic_first_steps):
        settings = replace(TINY.learner, critic_first_steps=critic_first_steps, warmup_steps=1)
        folder = tmp_path / str(critic_first_steps)
        train(replace(TINY, episodes=1, init=init, learner=settings), folder)
        model, _ = learner
        load_checkpoint(folder / "checkpoint", model)
        after = [parameter.detach().clone() for parameter in model.critic.parameters()]
        begin_with(model, Path(init))
        assert not all(map(torch.equal, after, model.critic.parameters()))
        last = load_file(folder / "last.safetensors")
        return any(not np.array_equal(first[key], last[key]) for key in first)

    assert not moved(10_000) and moved(5)


def test_no_random_warm_up_where_the_critic_learns_first(learner):
    model, env = learner
    observation, _ = env.reset(seed=0)
    model._last_obs, model.num_timesteps = observation[None], 0
    model.settings = replace(model.settings, sigma=0.0, epsilon=0.0)
    policy, _ = model.predict(observation)
    assert not np.allclose(model._sample_action(20)[0][0], policy, atol=1e-5)
    model.settings = replace(model.settings, critic_first_steps=1)
    assert np.allclose(model._sample_action(20)[0][0], policy, atol=1e-5)


def test_a_model_to_begin_with_must_be_there_and_fit(tmp_path):
    with pytest.raises(ConfigError, match=r"init must name a run.s best\.zip, got .nothing\.zip."):
        train(replace(TINY, init="nothing.zip"), tmp_path / "none")
    train(replace(TINY, episodes=1), tmp_path / "first")
    other = replace(TINY, init=str(tmp_path / "first" / "best.zip"), learner=replace(TINY.learner, hidden=(8, 8)))
    with pytest.raises(ConfigError, match="holds other networks than the settings of this run name"):
        train(other, tmp_path / "second")
    train(replace(other, init=""), tmp_path / "second")  # what failed to begin is no run that is in the way


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"max_minutes": 0.0}, "max_minutes must be above 0, or null"),
        ({"eval_every": 0}, "eval_every must be at least 1"),
        ({"worlds": ()}, "nothing to train on: name at least one world"),
        ({"worlds": "track_2"}, "worlds must be names or files of worlds, in a list, got 'track_2'"),
        ({"eval_worlds": (load_world("track_2"),)}, r"in a list, got \(World.*write_spec"),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(change, message):
    with pytest.raises(ConfigError, match=message):
        replace(TINY, **change)


def test_of_policies_that_are_equally_good_the_longest_trained_is_kept(tmp_path):
    train(TINY, tmp_path)
    first, last = CsvLog(tmp_path / "evaluations.csv", EVALUATION_COLUMNS).rows()
    assert (first["success"], first["collision"]) == (last["success"], last["collision"]) == ("0.0", "1.0")
    kept, trained = (load_file(tmp_path / name) for name in ("best.safetensors", "last.safetensors"))
    assert last["best"] == "1" and all(np.array_equal(kept[key], trained[key]) for key in kept)


def test_a_run_ends_with_the_first_evaluation_that_is_good_enough(tmp_path):
    train(replace(TINY, stop_at=0.0), tmp_path / "run")
    assert [row["episode"] for row in evaluations(tmp_path / "run")] == ["4"] and is_finished(tmp_path / "run")


def test_evaluations_begin_at_the_start_wherever_training_does(tmp_path):
    task = replace(TINY.task, episode=EpisodeConfig(max_steps=5, start="anywhere"))
    watchdog = WatchdogConfig(patience=1, min_share=0.0, still_m=100.0)  # keeps the first episode that it looks at
    train(replace(TINY, task=task, watchdog=watchdog), tmp_path / "run")
    kept = next((tmp_path / "run" / "collapse").glob("*.npz"))
    start = load_world("track_2").start
    assert np.abs(load_record(kept).pose[0, 1] - start.pose.y) <= start.range_y_m + 0.01


def test_ppo_keeps_its_falling_rate_and_its_rewards_scale_over_a_resume(tmp_path):
    config = tiny("ppo")
    config = replace(config, learner=replace(config.learner, lr_final=0.1, reward_scale=0.01))
    train(config, tmp_path / "whole")
    told = []

    def die(progress):
        told.append(progress)
        if len(told) == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "killed", die)
    resume(tmp_path / "killed")
    whole, killed = (load_file(tmp_path / name / "last.safetensors") for name in ("whole", "killed"))
    assert all(np.array_equal(values, killed[name]) for name, values in whole.items())
    train(replace(config, learner=replace(config.learner, lr_final=1.0)), tmp_path / "constant")
    constant = load_file(tmp_path / "constant" / "last.safetensors")
    assert any(not np.array_equal(values, constant[name]) for name, values in whole.items())


class Bomb:
    """Unpickled, it leaves a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_nothing_in_a_folder_of_others_is_unpickled(tmp_path):
    """Each file of a run is replaced in turn by a pickle that would leave a file behind."""
    run, exploded = tmp_path / "run", tmp_path / "exploded"
    train(replace(TINY, episodes=1), run)
    (run / "summary.json").unlink()
    names = [path.relative_to(run) for path in run.rglob("*") if path.is_file() and "tensorboard" not in path.parts]
    assert {path.suffix for path in names} <= {".safetensors", ".npz", ".json", ".csv", ".zip"}
    for name in [*names, Path("checkpoint/model.zip"), Path("checkpoint/replay.pkl")]:
        place = tmp_path / "theirs"
        shutil.copytree(run, place)
        (place / name).write_bytes(pickle.dumps(Bomb(exploded)))
        with contextlib.suppress(ZebratError):
            resume(place)
        for agent in (place, place / "best.zip"):
            with contextlib.suppress(ZebratError):
                load_agent(str(agent), TINY.task)
        assert not exploded.exists(), name
        shutil.rmtree(place)
    (run / "checkpoint" / "model.zip").write_bytes(b"")
    with pytest.raises(ZebratError, match="holds pickles, as earlier versions wrote them"):
        resume(run)


def test_a_model_to_begin_with_gives_its_tensors_and_its_pickles_stay_shut(tmp_path):
    exploded = tmp_path / "exploded"
    train(replace(TINY, episodes=1), tmp_path / "first")
    bomb, saved = pickle.dumps(Bomb(exploded)), io.BytesIO()
    torch.save({"x": Bomb(exploded)}, saved)
    for member, content in (
        ("policy.pth", saved.getvalue()),
        ("data", json.dumps({"policy_class": {":type:": "x", ":serialized:": base64.b64encode(bomb).decode()}})),
        ("policy.pth", bomb),
        ("policy.pth", b""),
        ("pytorch_variables.pth", bomb),
    ):
        with zipfile.ZipFile(tmp_path / "first" / "best.zip") as archive:
            members = {name: archive.read(name) for name in archive.namelist()} | {member: content}
        with zipfile.ZipFile(tmp_path / "init.zip", "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data)
        config = replace(TINY, episodes=1, init=str(tmp_path / "init.zip"))
        refused = member == "policy.pth"
        said = (
            r"init\.zip.*it holds more than weights"
            if content == saved.getvalue()
            else r"init\.zip: its policy\.pth cannot be"
        )
        with pytest.raises(ConfigError, match=said) if refused else contextlib.nullcontext():
            train(config, tmp_path / f"second-{member}")
        shutil.rmtree(tmp_path / f"second-{member}")
        assert not exploded.exists(), member


def test_a_device_that_is_not_there_is_refused_before_tracks_are_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr("zebrat_bullet.training.run.generate_tracks", lambda *_, **__: pytest.fail("drew tracks"))
    with pytest.raises(ConfigError, match="device must be one of cpu"):
        train(TrainConfig(worlds=(), steps=1, planar=PlanarConfig(device="gpu")), tmp_path / "run")


def test_a_summary_counts_the_steps_after_the_last_episode_that_was_logged(tmp_path):
    (tmp_path / "episodes.csv").write_text("episode,total_steps\n1,300\n", encoding="utf-8")
    (tmp_path / "evaluations.csv").write_text(
        ",".join(EVALUATION_COLUMNS) + "\n1,512,2.0,0.5,0.5,0,9.0,1\n", encoding="utf-8"
    )
    assert summarise(tmp_path)["total_steps"] == 512


def test_settings_given_twice_all_count(tmp_path, capfd):
    runs = tmp_path / "runs"
    tiny = [
        "--set",
        "episodes=1",
        "task.episode.max_steps=5",
        "learner.hidden=[8]",
        "--set",
        "task.reward.collision=-77",
    ]
    assert main(["train", "--worlds", "track_2", *tiny, "--out", str(runs / "one")]) == 0
    made = json.loads((runs / "one" / "config.json").read_text(encoding="utf-8"))
    assert (made["episodes"], made["task"]["reward"]["collision"], made["learner"]["hidden"]) == (1, -77.0, [8])
    made_by_sweep = ["sweep", "--worlds", "track_2", *tiny, "--seeds", "0", "--out", str(runs / "sweep"), "--quiet"]
    assert main(made_by_sweep) == 0
    told = json.loads((runs / "sweep" / "manifest.json").read_text(encoding="utf-8"))["set"]
    assert {"episodes=1", "task.reward.collision=-77"} <= set(told)


def test_what_a_run_leaves_may_be_read_by_others(tmp_path):
    before = os.umask(0o022)
    try:
        train(replace(TINY, episodes=1), tmp_path / "run")
    finally:
        os.umask(before)
    files = [path for path in (tmp_path / "run").rglob("*") if path.is_file()]
    assert len(files) > 8 and {path.name: oct(path.stat().st_mode & 0o777) for path in files} == {
        path.name: "0o644" for path in files
    }


def test_a_run_that_ended_before_its_first_checkpoint_is_told_as_what_it_is(tmp_path):
    (tmp_path / "best.safetensors").write_bytes(b"half")
    with pytest.raises(ConfigError, match="ended before its first checkpoint, so it cannot be resumed"):
        train(TINY, tmp_path)


def test_a_run_that_is_interrupted_says_how_it_goes_on(tmp_path, capfd, monkeypatch):
    def interrupted(config, folder, on_progress):
        (folder / "checkpoint").mkdir(parents=True)
        raise KeyboardInterrupt

    monkeypatch.setattr("zebrat_bullet.training.run.train", interrupted)
    assert main(["train", "--out", str(tmp_path / "run")]) == 130
    assert f"`zebrat train --resume --out {tmp_path / 'run'}` goes on from its last" in capfd.readouterr().err
