"""Imitation: a person's hands, demonstrations as records, behaviour cloning that drives, DAgger that repairs it."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from zebrat_bullet.agents import code_or_weights, load_agent, trained_task
from zebrat_bullet.agents.human import HumanLikeAgent, HumanNoise
from zebrat_bullet.assets import find_asset
from zebrat_bullet.cli import main
from zebrat_bullet.config import EpisodeConfig, LidarConfig, PhysicsConfig, TaskConfig
from zebrat_bullet.config_text import from_json, to_json
from zebrat_bullet.errors import AssetError, ConfigError, ZebratError
from zebrat_bullet.evaluation.records import load_record, save_record
from zebrat_bullet.evaluation.rollout import replay_episode, run_episode
from zebrat_bullet.imitation.cloning import CloneConfig, clone
from zebrat_bullet.imitation.demonstrations import (
    demonstrate,
    encode_pairs,
    labels_path,
    load_demonstrations,
    observation_of,
)
from zebrat_bullet.imitation.places import MixtureAgent
from zebrat_bullet.imitation.run import imitate, iterations, resume_imitation
from zebrat_bullet.imitation.settings import ImitationConfig
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Clearance, Command, FlatScan, Reading
from zebrat_bullet.world import load_world

DRIVER = str(Path(__file__).parent.parent / "docs/results/policies/bullet-general.safetensors")
"""Observes the same 34 numbers as its imitators."""
TASK = TaskConfig(lidar=LidarConfig(caster="embree"))
SMALL = CloneConfig(hidden=(32, 32), epochs=3)


class Steady:
    """Always the same command."""

    name = "steady"
    privileged: frozenset[str] = frozenset()

    def __init__(self, speed_mps: float, steering_rad: float) -> None:
        self.command = Command(speed_mps, steering_rad)

    def reset(self, seed: int) -> None:
        pass

    def act(self, reading: Reading) -> Command:
        return self.command


def reading(last: Command) -> Reading:
    ranges = np.ones(32, np.float32)
    return Reading(FlatScan(ranges, 6.0), Clearance(ranges, 0 * ranges, False), last, 0.0, 0.0)


def drive_blind(agent, n_steps: int, seed: int = 0) -> list[Command]:
    """Let an agent act so many steps without a world."""
    agent.reset(seed)
    commands = [Command(0.0, 0.0)]
    for _ in range(n_steps):
        commands.append(agent.act(reading(commands[-1])))
    return commands[1:]


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory) -> Path:
    """A policy on Track 2, at least 1,000 pairs."""
    folder = tmp_path_factory.mktemp("data") / "shipped"
    done = demonstrate(load_agent(DRIVER, TASK), ["track_2"], 1000, folder, TASK)
    assert done["pairs"] >= 1000 and len(list(folder.rglob("*.npz"))) == done["episodes"]
    return folder


@pytest.fixture(scope="module")
def track_2():
    drive = Drive(TASK, load_world("track_2"))
    yield drive
    drive.close()


def test_a_person_acts_a_step_late_and_presses_the_pedal_gently():
    noise = HumanNoise(delay_steps=2, steering_sigma_rad=0.0, speed_change_mps=0.25)
    commands = drive_blind(HumanLikeAgent(Steady(0.6, 0.3), PhysicsConfig(), noise), 5)
    assert [c.speed_mps for c in commands] == pytest.approx([0.0, 0.0, 0.25, 0.5, 0.6])
    assert [c.steering_rad for c in commands] == [0.0, 0.0, 0.3, 0.3, 0.3]


def test_a_persons_steering_error_drifts_as_its_sigma_and_correlation_time_say():
    noise = HumanNoise(steering_sigma_rad=0.05, steering_time_s=1.0)
    error = np.array(
        [c.steering_rad for c in drive_blind(HumanLikeAgent(Steady(0.6, 0.0), PhysicsConfig(), noise), 20000)]
    )
    assert error.std() == pytest.approx(0.05, rel=0.1)
    assert np.corrcoef(error[:-5], error[5:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.06)  # five steps are 1 s
    again = drive_blind(HumanLikeAgent(Steady(0.6, 0.0), PhysicsConfig(), noise), 50)
    assert [c.steering_rad for c in again] == error[:50].tolist()


def test_a_person_steers_within_the_limits():
    noise = HumanNoise(steering_sigma_rad=0.5)
    commands = drive_blind(HumanLikeAgent(Steady(0.6, 0.6), PhysicsConfig(), noise), 200)
    assert max(c.steering_rad for c in commands) == 0.6


def test_a_pair_is_what_the_driver_saw_and_did(demonstrations, track_2):
    loaded = load_demonstrations(demonstrations)
    pairs = encode_pairs(loaded, observation_of(loaded[0]))
    agent = load_agent(DRIVER, TASK)
    record = load_record(sorted(demonstrations.rglob("*.npz"))[0])
    assert (pairs.episode == 0).sum() == len(record.command)
    for t in (0, 1, 30):  # the policy that was recorded gives the recorded action for the encoded observation
        assert agent.action(pairs.observations[t]) * 0.6 == pytest.approx(record.command[t], abs=1e-5)
    assert pairs.observations[0, -2:].tolist() == [0.0, 0.0]


def test_a_compact_record_has_all_but_the_scans_and_its_replay_has_these_too(demonstrations, track_2, tmp_path):
    demonstrate(load_agent(DRIVER, TASK), ["track_2"], 1, tmp_path / "compact", TASK, compact=True)
    (path,) = (tmp_path / "compact").rglob("*.npz")
    whole = demonstrations / path.relative_to(tmp_path / "compact")
    assert path.stat().st_size < whole.stat().st_size / 4
    (compact,), one = load_demonstrations(tmp_path / "compact"), load_record(whole)
    observation = observation_of(compact)
    pairs = encode_pairs([compact], observation)
    assert np.array_equal(
        pairs.observations, encode_pairs(load_demonstrations(demonstrations)[:1], observation).observations
    )
    again = replay_episode(track_2, load_record(path), load_world("track_2"))
    assert np.array_equal(again.scan_m, one.scan_m)


def test_the_demonstrations_of_this_checkout_are_read_from_their_archive():
    loaded = load_demonstrations(Path(__file__).parent.parent / "docs" / "results" / "demonstrations.zip")
    assert len(loaded) == 68 and sum(len(demonstration.labels) for demonstration in loaded) == 10_049
    assert {demonstration.world for demonstration in loaded} == {"big_track", "track_1", "track_2", "track_3"}


def test_failures_are_kept_but_copied_only_with_an_experts_labels(track_2, tmp_path):
    crash = run_episode(track_2, Steady(0.6, 0.0), 0, 0)
    success = run_episode(track_2, load_agent(DRIVER, TASK), 0, 0)
    assert (crash.outcome, success.outcome) == ("collision", "success")
    save_record(crash, tmp_path / "crash.npz")
    save_record(success, tmp_path / "success.npz")
    assert [len(d.labels) for d in load_demonstrations(tmp_path)] == [len(success.command)]
    np.save(labels_path(tmp_path / "crash.npz"), np.full((len(crash.command), 2), 0.6))
    first, second = load_demonstrations(tmp_path)
    assert (first.labels == 0.6).all() and (second.labels == success.command).all()
    np.save(labels_path(tmp_path / "crash.npz"), np.zeros((3, 2)))
    with pytest.raises(ZebratError, match=r"crash.labels.npy has shape \(3, 2\)"):
        load_demonstrations(tmp_path)


def test_cloning_learns_to_drive_the_track(demonstrations, track_2):
    loaded = load_demonstrations(demonstrations)
    observation = observation_of(loaded[0])
    fitted = clone(encode_pairs(loaded, observation), observation, CloneConfig(), 0, {})
    assert fitted.losses[-1, 1] < 0.5 * fitted.losses[0, 1]
    outcomes = [run_episode(track_2, fitted.agent, 77, episode).outcome for episode in range(4)]
    assert outcomes.count("success") >= 1, outcomes


@pytest.mark.parametrize("last_command", [False, True])
def test_the_last_command_counts_only_where_it_was_asked_for(demonstrations, last_command):
    loaded = load_demonstrations(demonstrations)
    observation = observation_of(loaded[0])
    pairs = encode_pairs(loaded, observation)
    fitted = clone(pairs, observation, replace(SMALL, last_command=last_command), 0, {})
    other = pairs.observations[5].copy()
    other[-2:] *= -1.0
    assert (fitted.agent.action(other) != fitted.agent.action(pairs.observations[5])).any() == last_command


def test_cloning_twice_gives_the_same_weights_and_the_held_out_loss_is_that_of_the_policy(demonstrations):
    loaded = load_demonstrations(demonstrations)
    observation = observation_of(loaded[0])
    pairs = encode_pairs(loaded[:2], observation)
    one, two = (clone(pairs, observation, SMALL, 3, {}) for _ in range(2))
    assert np.array_equal(one.losses, two.losses)
    assert all(
        np.array_equal(a, b)
        for p, q in zip(one.agent.layers, two.agent.layers, strict=True)
        for a, b in zip(p, q, strict=True)
    )
    # Of two episodes one is held out; the policy that is returned has the smallest loss there.
    losses = []
    for episode in (0, 1):
        mine = pairs.episode == episode
        actions = np.array([one.agent.action(o) for o in pairs.observations[mine]])
        losses.append(((actions - pairs.actions[mine]) ** 2).mean())
    best = one.losses[one.best_epoch, 1]
    assert best == one.losses[:, 1].min() and any(best == pytest.approx(loss, rel=1e-4) for loss in losses)


def test_the_expert_labels_every_state_whoever_drives(track_2):
    expert, learner = Steady(0.6, 0.1), Steady(-0.6, 0.0)
    for beta, driven in ((1.0, {0.6}), (0.0, {-0.6}), (0.5, {-0.6, 0.6})):
        agent = MixtureAgent(learner, expert, beta)
        commands = drive_blind(agent, 40)
        assert {c.speed_mps for c in commands} == driven
        assert agent.labels == [Command(0.6, 0.1)] * 40


def test_dagger_labels_aggregates_and_resumes_to_the_same_weights(demonstrations, tmp_path):
    given = tmp_path / "given"
    for path in sorted(demonstrations.rglob("*.npz"))[:3]:
        save_record(load_record(path), given / path.name)
    config = ImitationConfig(
        demonstrations=str(given), iterations=2, expert=DRIVER, pairs=60, eval_episodes=1, clone=SMALL
    )
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    imitate(config, whole)
    rows = iterations(whole)
    n_given = sum(len(d.labels) for d in load_demonstrations(given))
    labelled = [load_demonstrations(whole / f"iteration_{i}" / "records") for i in (1, 2)]
    n_labelled = [sum(len(d.labels) for d in found) for found in labelled]
    assert [row["pairs"] for row in rows] == np.cumsum([n_given, *n_labelled]).tolist()
    shipped = load_agent(DRIVER, TASK)
    observation = observation_of(labelled[0][0])
    pairs = encode_pairs(labelled[0], observation)
    assert [shipped.action(o) for o in pairs.observations[:20]] == pytest.approx(pairs.actions[:20], abs=1e-5)
    assert load_agent(str(whole), TASK).provenance["config"]["expert"] == DRIVER

    # As a kill in iteration 2 leaves it: its labels half gathered, its row not written.
    shutil.copytree(whole, killed)
    (killed / "iterations.csv").write_text(
        "\n".join((whole / "iterations.csv").read_text(encoding="utf-8").splitlines()[:3]) + "\n", encoding="utf-8"
    )
    (killed / "iteration_2" / "policy.safetensors").unlink()
    sorted((killed / "iteration_2").rglob("*.npz"))[-1].unlink()
    resume_imitation(killed)
    assert iterations(killed) == rows
    one, two = (load_file(folder / "iteration_2" / "policy.safetensors") for folder in (whole, killed))
    assert all(np.array_equal(one[key], two[key]) for key in one)
    with pytest.raises(ConfigError, match="holds a run already"):
        imitate(config, whole)


def test_an_agent_that_never_gets_out_demonstrates_nothing(tmp_path):
    task = replace(TASK, episode=EpisodeConfig(max_steps=2))
    with pytest.raises(ZebratError, match="failed in 20 episodes in a row"):
        demonstrate(load_agent("random", task), ["track_2"], 100, tmp_path / "x", task)
    with pytest.raises(ConfigError, match="holds no successful episode"):
        load_demonstrations(tmp_path / "x")


def test_demonstrations_that_were_killed_go_on_and_no_two_sets_mix(demonstrations, tmp_path, monkeypatch):
    killed = tmp_path / "killed"
    shutil.copytree(demonstrations, killed)
    (*_, last) = sorted(killed.rglob("*.npz"))
    whole = load_record(last)
    last.unlink()
    driven = []
    monkeypatch.setattr(
        "zebrat_bullet.imitation.demonstrations.run_episode",
        lambda *given: driven.append(given) or run_episode(*given),
    )
    done = demonstrate(load_agent(DRIVER, TASK), ["track_2"], 1000, killed, TASK)
    assert len(driven) == 1 and np.array_equal(load_record(last).pose, whole.pose)
    assert done == demonstrate(load_agent(DRIVER, TASK), ["track_2"], 1000, demonstrations, TASK) and len(driven) == 1
    for name, other in {"seed": {"seed": 1}, "compact": {"compact": True}, "order": {"worlds": ["real_1"]}}.items():
        given = {"worlds": ["track_2"], "seed": 0, "compact": False} | other
        with pytest.raises(ConfigError, match=f"driven under another {name}; name another --out"):
            demonstrate(load_agent(DRIVER, TASK), given["worlds"], 1, killed, TASK, given["seed"], given["compact"])
    slower = replace(TASK, physics=replace(TASK.physics, max_speed_mps=0.5))
    with pytest.raises(ConfigError, match="another agent, task"):
        demonstrate(load_agent("oracle", slower), ["track_2"], 1, killed, slower)
    for wrapped in (load_agent(DRIVER, TASK, 0.1), HumanLikeAgent(load_agent(DRIVER, TASK), TASK.physics)):
        assert code_or_weights(wrapped) == code_or_weights(load_agent(DRIVER, TASK)) != ""
    with pytest.raises(ConfigError, match="track_2 is named twice"):
        demonstrate(load_agent(DRIVER, TASK), ["track_2", "track_2"], 1, tmp_path / "twice", TASK)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").touch()
    with pytest.raises(ConfigError, match="is not empty; name a new folder"):
        demonstrate(load_agent(DRIVER, TASK), ["track_2"], 1, tmp_path / "mine", TASK)
    with pytest.raises(ConfigError, match="is one record; name the folder that it lies in"):
        load_demonstrations(last)


def test_a_policy_demonstrates_in_the_task_that_it_was_trained_on(tmp_path, capfd):
    options = ["--worlds", "real_1", "--pairs", "1", "--caster", "embree", "--out", str(tmp_path / "out")]
    assert main(["demonstrate", "--agent", "allround", *options]) == 0
    assert "allround drives in the task that it was trained on: task.region.resolution_m=0.03" in capfd.readouterr().err
    assert load_demonstrations(tmp_path / "out")[0].task.region.resolution_m == 0.03


def test_a_clone_knows_the_car_of_its_demonstrations_which_are_of_one(demonstrations, tmp_path):
    shutil.copytree(find_asset("urdf", "zebrat", ".urdf").parent, tmp_path / "urdf")
    mine = str(tmp_path / "urdf" / "zebrat.urdf")
    theirs, ours = sorted(demonstrations.rglob("*.npz"))[:2], tmp_path / "ours"
    for path in theirs:
        record = load_record(path)
        task = replace(from_json(TaskConfig, record.task), robot=mine)
        save_record(replace(record, task=to_json(task)), ours / path.name)
    imitate(ImitationConfig(demonstrations=str(ours), eval_episodes=1, clone=SMALL), tmp_path / "run")
    trained = trained_task(str(tmp_path / "run"))
    assert trained is not None and trained.robot == mine
    shutil.copy(theirs[0], ours / "theirs.npz")
    assert len(load_demonstrations(ours)) == 3  # the same car by another name
    text = Path(mine).read_text(encoding="utf-8")
    Path(mine).write_text(text.replace('velocity="20"', 'velocity="19"'), encoding="utf-8")
    with pytest.raises(ConfigError, match=f"of several cars, {mine}, zebrat; keep those of one"):
        load_demonstrations(ours)


def test_settings_that_cannot_work_are_refused_before_anything_is_driven(demonstrations, tmp_path):
    with pytest.raises(ConfigError, match="name one with --expert"):
        ImitationConfig(demonstrations="x", iterations=1)
    with pytest.raises(ConfigError, match="held_out is a share"):
        CloneConfig(held_out=1.0)
    with pytest.raises(AssetError, match="no agent 'nobody'"):
        imitate(ImitationConfig(demonstrations=str(demonstrations), iterations=1, expert="nobody"), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    with pytest.raises(ConfigError, match="holds no run"):
        resume_imitation(tmp_path)


def test_settings_beside_resume_are_refused(tmp_path, capfd):
    for more in (["--dagger", "3"], ["--expert", "oracle"], ["--set", "clone.epochs=1"], ["--demonstrations", "x"]):
        assert main(["imitate", "--resume", "--out", str(tmp_path), *more]) == 2
        assert f"so {more[0]} cannot change them" in capfd.readouterr().err
