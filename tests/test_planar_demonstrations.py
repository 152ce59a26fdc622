"""Demonstrations by the thousand: the oracle on planar cars, disturbed while it labels; clones and DAgger."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from zebrat_bullet.agents import oracle
from zebrat_bullet.agents.policy import load_policy
from zebrat_bullet.cli.main import main
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError, PlanError, ZebratError
from zebrat_bullet.evaluation.planar_policy import cars_for
from zebrat_bullet.imitation import places, planar_demonstrations
from zebrat_bullet.imitation.cloning import CloneConfig
from zebrat_bullet.imitation.demonstration import read_demonstrations, save_demonstrations
from zebrat_bullet.imitation.demonstrations import load_demonstrations
from zebrat_bullet.imitation.planar_demonstrations import Demonstrating, demonstrate_generated, drive_seeds
from zebrat_bullet.imitation.run import imitate, iterations, resume_imitation
from zebrat_bullet.imitation.settings import ImitationConfig
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.training.settings import VALIDATION_SEED
from zebrat_bullet.world import HELD_OUT_SEED, generate_tracks

TASK = TaskConfig()
HOW = Demonstrating(families=("corridors", "curves"), task=TASK)
LEARNER = str(Path(__file__).parent.parent / "docs/results/policies/bullet-general.safetensors")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Six tracks, undisturbed."""
    path = tmp_path_factory.mktemp("data") / "six"
    done = demonstrate_generated(HOW, 6, path)
    assert done["success"] == 6 and done["tracks"] == 6
    return path


def test_undisturbed_the_oracle_drives_what_it_labels_and_the_file_holds_it_as_it_was(folder):
    found = load_demonstrations(folder)
    assert [each.world for each in found] == [f"{('corridors', 'curves')[seed % 2]}-{seed}" for seed in range(6)]
    for each in found:
        assert (each.last_command[0] == 0.0).all()
        assert np.array_equal(each.last_command[1:], each.labels[:-1])
        assert each.labels[:, 0].max() == pytest.approx(0.6)
    again = drive_seeds(HOW, range(6)).demonstrations
    for a, b in zip(found, again, strict=True):
        assert np.array_equal(a.obs_m, b.obs_m) and np.array_equal(a.labels, b.labels)


def test_what_was_killed_goes_on_and_more_tracks_join(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(planar_demonstrations, "TRACKS_ABREAST", 2)
    whole, killed, driven = tmp_path / "whole", tmp_path / "killed", []

    def drive(how, seeds):
        driven.append(seeds)
        return drive_seeds(how, seeds)

    monkeypatch.setattr(planar_demonstrations, "drive_seeds", drive)
    done = demonstrate_generated(HOW, 6, whole)
    assert demonstrate_generated(HOW, 3, killed)["tracks"] == 3
    driven.clear()
    assert demonstrate_generated(HOW, 6, killed) == done
    assert driven == [range(2, 4), range(4, 6)]
    (killed / "tracks-000004.planar.npz").unlink()
    driven.clear()
    assert demonstrate_generated(HOW, 6, killed) == done and driven == [range(4, 6)]
    for path in whole.glob("*.npz"):
        assert path.read_bytes() == (killed / path.name).read_bytes()
    with pytest.raises(ConfigError, match="driven under another families, episodes; name another --out"):
        demonstrate_generated(replace(HOW, families=("corners",), episodes=2), 6, killed)
    (killed / "tracks.csv").write_text(
        (killed / "tracks.csv").read_text(encoding="utf-8").replace("\n0,2,", "\nx,2,"), encoding="utf-8"
    )
    with pytest.raises(ZebratError, match=r"tracks\.csv: is no table of tracks"):
        demonstrate_generated(HOW, 6, killed)


def test_what_is_seen_first_is_what_a_planar_car_sees_at_the_first_start_of_the_track(folder):
    first = load_demonstrations(folder)[0]
    policy = load_policy(LEARNER)
    drive = cars_for(policy, TASK, list(generate_tracks([0], family="corridors")), 1)
    seen = drive.begin_at(np.zeros(1, np.int32), drive.starts[:, 0])
    assert policy.observation.encode_cars(first.obs_m[:1], np.zeros((1, 2), np.float32)) == pytest.approx(seen)


def test_noise_moves_the_car_and_not_the_label_and_the_oracle_brings_it_back():
    how = replace(HOW, action_noise=0.5, episodes=2)
    driven = drive_seeds(how, range(6))
    assert driven.outcomes.count(Outcome.SUCCESS) >= 9
    errors = [each.last_command[1:] - each.labels[:-1] for each in driven.demonstrations]
    spreads = np.array([error[:, 1].std() / 0.6 for error in errors])  # each has its own
    assert spreads.min() < 0.2 and 0.25 < spreads.max() < 0.6
    assert max(np.abs(each.last_command).max() for each in driven.demonstrations) <= np.float32(0.6)
    other = drive_seeds(replace(how, seed=1, episodes=1), range(2)).demonstrations[0]
    assert not np.array_equal(other.obs_m[:9], driven.demonstrations[0].obs_m[:9])


def test_a_learner_drives_as_it_sees_and_the_oracle_says_what_it_would_have_done():
    learner = load_policy(LEARNER)
    driven = drive_seeds(HOW, range(2), learner, beta=0.0)
    for each in driven.demonstrations:
        seen = learner.observation.encode_cars(each.obs_m, each.last_command)
        assert learner.action(seen)[:-1] * 0.6 == pytest.approx(each.last_command[1:], abs=1e-5)
        assert np.abs(each.labels - each.last_command).max() > 0.05


def test_where_the_oracle_knows_no_way_its_standing_still_is_not_imitated(monkeypatch):
    def no_way(*arguments):
        raise PlanError("")

    monkeypatch.setattr(oracle, "plan_path", no_way)
    driven = drive_seeds(HOW, range(2))
    assert driven.demonstrations == [] and driven.outcomes == [Outcome.STALL] * 2
    assert drive_seeds(HOW, range(2), load_policy(LEARNER), beta=0.0).demonstrations == []


def test_a_crash_counts_only_where_the_oracle_was_disturbed():
    narrow = Demonstrating(families=("manoeuvres",), action_noise=1.5, task=TASK)
    driven = drive_seeds(narrow, range(4))
    crashed = driven.outcomes.count(Outcome.COLLISION)
    assert crashed > 0
    assert len(driven.demonstrations) == crashed + driven.outcomes.count(Outcome.SUCCESS)


def test_a_clone_with_dagger_resumes_to_the_same_weights_and_drives_what_it_sees(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(places, "TRACKS_ABREAST", 2)  # for speed
    config = ImitationConfig(
        demonstrations=str(folder),
        iterations=2,
        expert="oracle",
        beta=0.0,
        pairs=20,
        eval_tracks=4,
        eval_episodes=2,
        clone=CloneConfig(hidden=(32, 32), epochs=30, last_command=True, log_gaps=True),
    )
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    imitate(config, whole)
    rows = iterations(whole)
    n_given = sum(len(each.labels) for each in load_demonstrations(folder))
    labelled = [load_demonstrations(whole / f"iteration_{i}" / "records") for i in (1, 2)]
    n_labelled = [sum(len(each.labels) for each in found) for found in labelled]
    assert [row["pairs"] for row in rows] == np.cumsum([n_given, *n_labelled]).tolist()
    driven = [{int(each.world.rpartition("-")[2]) for each in found} for found in labelled]
    assert min(driven[0]) == 6 and driven[0].isdisjoint(driven[1]) and max(driven[1]) < VALIDATION_SEED
    assert all(sum(float(row[name]) for name in ("success", "collision", "fail")) == pytest.approx(1) for row in rows)
    policy = load_policy(str(whole / "iteration_0" / "policy.safetensors"))
    assert policy.observation.size == 66 and policy.layers[0][0].any(axis=0).all()

    shutil.copytree(whole, killed)
    (killed / "iterations.csv").write_text(
        "\n".join((whole / "iterations.csv").read_text(encoding="utf-8").splitlines()[:3]) + "\n", encoding="utf-8"
    )
    shutil.rmtree(killed / "iteration_2")
    resume_imitation(killed)
    assert iterations(killed) == rows
    one, two = (load_file(at / "iteration_2" / "policy.safetensors") for at in (whole, killed))
    assert all(np.array_equal(one[key], two[key]) for key in one)


def test_a_damaged_file_is_refused(folder, tmp_path):
    (given,) = folder.glob("*.npz")
    good = list(read_demonstrations(given))
    bad = tmp_path / "bad.planar.npz"
    for broken in (replace(good[0], labels=good[0].labels * np.nan), replace(good[0], world="track_2/..")):
        save_demonstrations([broken], bad)
        with pytest.raises(ZebratError, match=r"bad.planar.npz: is no file of demonstrations"):
            load_demonstrations(tmp_path)
    bad.write_bytes(given.read_bytes()[:1000])
    with pytest.raises(ZebratError, match=r"bad\.planar\.npz"):
        load_demonstrations(tmp_path)


def test_tracks_that_choose_or_judge_are_not_demonstrated_on(tmp_path):
    assert VALIDATION_SEED < HELD_OUT_SEED
    with pytest.raises(ConfigError, match=f"1 to {VALIDATION_SEED} generated tracks, got {VALIDATION_SEED + 1}"):
        demonstrate_generated(HOW, VALIDATION_SEED + 1, tmp_path)
    with pytest.raises(ConfigError, match="the oracle demonstrates, 'shipped' is another"):
        replace(HOW, agent="shipped")
    with pytest.raises(ConfigError, match="no family of tracks 'ring'"):
        replace(HOW, families=("ring",))
    (tmp_path / "mine").touch()
    with pytest.raises(ConfigError, match="is not empty"):
        demonstrate_generated(HOW, 2, tmp_path)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--sim", "planar"], "give it, or leave --sim out"),
        (["--sim", "bullet", "--generated", "2"], "planar cars drive generated tracks, got --sim bullet"),
        (["--generated", "2", "--pairs", "100", "--compact"], "--pairs, --compact goes with --worlds"),
        (["--generated", "2", "--agent", "shipped", "--robot", "long"], "'shipped' is another"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, said, tmp_path, capsys):
    assert main(["demonstrate", "--agent", "oracle", "--out", str(tmp_path / "out"), *options]) != 0
    assert said in capsys.readouterr().err


def test_the_command_says_how_all_episodes_ended(tmp_path, capfd):
    out = tmp_path / "out"
    options = ["--generated", "2", "--families", "corridors", "--episodes", "2", "--workers", "1", "--quiet"]
    assert main(["demonstrate", "--out", str(out), *options]) == 0
    pairs = sum(len(each.labels) for each in load_demonstrations(out))
    assert f"{pairs} pairs on 2 tracks (4 success): {out}" in capfd.readouterr().out


def test_what_may_be_the_oracles_own_failure_is_no_demonstration():
    brief = replace(HOW, task=replace(TASK, episode=replace(TASK.episode, max_steps=5)))
    for how in (brief, replace(brief, action_noise=0.1)):
        driven = drive_seeds(how, range(2))
        assert set(driven.outcomes) == {Outcome.TIMEOUT} and not driven.demonstrations
    assert (
        len(drive_seeds(brief, range(2), load_policy(LEARNER), beta=0.0).demonstrations) == 2
    )  # the learner's failures


def test_a_clone_is_judged_on_tracks_that_are_neither_demonstrated_nor_held_out(folder, monkeypatch):
    judged: list[str] = []
    real = places.planar_endings

    def spied(policy, task, worlds, episodes):
        judged.extend(world.name for world in worlds)
        return real(policy, task, worlds, episodes)

    monkeypatch.setattr(places, "planar_endings", spied)
    config = ImitationConfig(demonstrations=str(folder), eval_tracks=3, eval_episodes=1)
    places.GeneratedPlaces(config, load_demonstrations(folder)).evaluate(load_policy(LEARNER))
    seeds = [int(name.rpartition("-")[2]) for name in judged]
    assert len(seeds) == 3 and min(seeds) >= VALIDATION_SEED and max(seeds) < HELD_OUT_SEED
