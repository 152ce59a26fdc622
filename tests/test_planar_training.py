"""Training on planar cars: a run folder like any other, resumed to the last bit, on tracks that are never judged."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.policy import load_policy
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import to_json, with_overrides
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.endings import planar_endings
from zebrat_bullet.evaluation.generated import judge_generated
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.training.learner_settings import PPOConfig
from zebrat_bullet.training.presets import ALGORITHMS, TRAIN_PRESETS
from zebrat_bullet.training.run import resume, train
from zebrat_bullet.training.run_folder import evaluations
from zebrat_bullet.training.settings import VALIDATION_SEED, PlanarConfig, TrainConfig
from zebrat_bullet.world import HELD_OUT_SEED, World, generate_tracks, load_world

STEPS = 16 * 16


def tiny(**changes: object) -> TrainConfig:
    general = TRAIN_PRESETS["general"]
    assert isinstance(general.learner, PPOConfig)
    learner = replace(general.learner, hidden=(16,), n_steps=16, batch_size=64, n_epochs=2)
    planar = PlanarConfig(n_cars=16, n_tracks=6, n_eval_tracks=3, n_eval_starts=2, eval_every_steps=2 * STEPS)
    return replace(general, learner=learner, planar=planar, steps=6 * STEPS, threads=1, **changes)


def dying(after: int) -> Callable[[object], None]:
    """Return what interrupts a run at so many-th news of its progress."""
    seen = []

    def die(progress: object) -> None:
        seen.append(progress)
        if len(seen) == after:
            raise KeyboardInterrupt

    return die


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planar") / "run"
    train(tiny(), folder)
    return folder


def test_a_run_leaves_a_folder_like_any_other(finished: Path):
    names = {path.name for path in finished.iterdir()}
    assert {"config.json", "versions.json", "episodes.csv", "evaluations.csv", "summary.json"} <= names
    # Nothing is judged twice, the end neither.
    assert [int(row["total_steps"]) for row in evaluations(finished)] == [2 * STEPS, 4 * STEPS, 6 * STEPS]
    summary = json.loads((finished / "summary.json").read_text(encoding="utf-8"))
    # Whole rollouts of 16 cars x 16 steps; the run ends at the first step after the sixth.
    assert summary["best"]["total_steps"] % STEPS in (0, 16)
    assert "warp-lang" in json.loads((finished / "versions.json").read_text(encoding="utf-8"))["versions"]


def test_a_run_that_ends_between_two_evaluations_is_judged_at_its_end(tmp_path: Path):
    train(replace(tiny(), steps=5 * STEPS), tmp_path / "run")
    assert [int(row["total_steps"]) for row in evaluations(tmp_path / "run")] == [2 * STEPS, 4 * STEPS, 5 * STEPS]


def test_a_killed_run_ends_in_the_same_weights(finished: Path, tmp_path: Path):
    killed = tmp_path / "killed"
    with pytest.raises(KeyboardInterrupt):
        train(tiny(), killed, dying(after=5))
    assert not (killed / "summary.json").exists()
    resume(killed)
    once, twice = load_file(finished / "last.safetensors"), load_file(killed / "last.safetensors")
    assert once.keys() == twice.keys()
    for name, values in once.items():
        assert np.array_equal(values, twice[name]), name


@pytest.mark.parametrize("algo", ["ddpg", "sac"])
def test_a_learner_with_a_replay_learns_while_the_cars_drive_and_ends_in_the_same_weights_when_killed(
    algo: str, tmp_path: Path
):
    learner = replace(ALGORITHMS[algo], hidden=(16,), batch_size=16, buffer_size=4096, warmup_steps=32)
    config = tiny()
    config = replace(config, learner=learner, planar=replace(config.planar, gradient_steps=2))
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    train(config, whole)
    with pytest.raises(KeyboardInterrupt):
        train(config, killed, dying(4))
    resume(killed)
    networks = {
        name: load_file(run / "checkpoint" / "networks.safetensors")
        for name, run in (("whole", whole), ("killed", killed))
    }
    learner_state = json.loads((whole / "checkpoint" / "state.json").read_text(encoding="utf-8"))["learner"]
    # Two gradient steps for each step of the 16 cars, but for the first three: the replay is empty, then too young.
    assert learner_state["_n_updates"] == 2 * (learner_state["num_timesteps"] // 16 - 3)
    assert networks["whole"].keys() == networks["killed"].keys()
    assert all(np.array_equal(value, networks["killed"][name]) for name, value in networks["whole"].items())


def test_a_policy_of_a_run_drives_in_bullet_and_on_generated_tracks(finished: Path):
    task = replace(TRAIN_PRESETS["general"].task, noise=TrainConfig().task.noise)
    agent = load_agent(str(finished), task)
    assert agent.privileged == frozenset()
    score = judge_generated(str(finished), range(HELD_OUT_SEED, HELD_OUT_SEED + 3), 2, task)
    assert sum(score.causes.values()) == 6
    assert len(score.by_track) == 3


def test_tracks_that_are_judged_are_never_trained_on():
    assert VALIDATION_SEED < HELD_OUT_SEED
    with pytest.raises(ConfigError, match="not kept for judging"):
        PlanarConfig(n_tracks=VALIDATION_SEED + 1)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"families": ("mixed", "corner")}, "no family of tracks 'corner': name one of mixed, corridors"),
        ({"families": ()}, "planar.families is empty"),
        ({"difficulty": 1.2}, "difficulty must be 0 .* got 1.2"),
    ],
)
def test_tracks_that_there_are_not_are_refused(settings: dict[str, object], said: str):
    with pytest.raises(ConfigError, match=said):
        PlanarConfig(**settings)


def test_a_run_may_know_no_track_but_ones_own_and_choose_its_best_policy_there(tmp_path: Path, monkeypatch):
    judged: list[list[str]] = []
    make = PlanarDrive.__init__

    def note(self: PlanarDrive, task: TaskConfig, worlds: list[World], *rest: object, **settings: object) -> None:
        judged.append([world.name for world in worlds])
        make(self, task, worlds, *rest, **settings)

    monkeypatch.setattr("zebrat_bullet.training.run.PlanarDrive", type("Noted", (PlanarDrive,), {"__init__": note}))
    general = tiny()
    planar = replace(general.planar, n_tracks=0, n_eval_tracks=0)
    own = replace(general, worlds=("track_2", "track_4"), planar=planar, steps=STEPS)
    train(own, tmp_path / "own")
    train(replace(own, eval_worlds=("track_5",)), tmp_path / "other")
    train(replace(own, eval_worlds=("track_5",), planar=replace(planar, n_eval_tracks=1)), tmp_path / "both")
    assert judged == [["track_2", "track_4"], ["track_5"], ["track_5", f"generated-{VALIDATION_SEED}"]]
    assert "best" in json.loads((tmp_path / "own" / "summary.json").read_text(encoding="utf-8"))
    with pytest.raises(ConfigError, match="nothing to choose the best policy by: name eval_worlds"):
        replace(general, worlds=(), planar=replace(general.planar, n_eval_tracks=0))


def test_a_term_of_the_reward_that_is_none_is_refused_before_any_track_is_drawn():
    with pytest.raises(ConfigError, match="unknown reward term 'S'; valid terms are: F, O, M, T, W"):
        with_overrides(tiny(), ["task.reward.weights.S=0.5"])


def test_a_run_learns_on_the_families_and_the_difficulty_that_it_names(tmp_path: Path, monkeypatch):
    seen: list[list[World]] = []
    make = PlanarVectorEnv.__init__

    def note(self: PlanarVectorEnv, n_cars: int, worlds: list[World], **settings: object) -> None:
        seen.append(worlds)
        make(self, n_cars, worlds, **settings)

    monkeypatch.setattr(PlanarVectorEnv, "__init__", note)
    config = tiny()
    planar = replace(config.planar, families=("corners", "uturns"), difficulty=0.25)
    train(replace(config, planar=planar, steps=STEPS), tmp_path / "run")
    assert [world.family for world in seen[0]] == ["corners", "uturns"] * 3
    assert {world.difficulty for world in seen[0]} == {0.25}


def test_an_algorithm_with_discrete_actions_is_refused_before_any_track_is_drawn(tmp_path: Path):
    config = replace(tiny(), learner=PPOConfig(algo="ppo-discrete"))
    with pytest.raises(ConfigError, match="continuous"):
        train(config, tmp_path / "run")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"speeds": (-1.0, 1.0)}, "both speeds and steerings"),
        ({"speeds": (-2.0, 1.0), "steerings": (0.0,)}, "speeds must be -1 to 1, got -2.0"),
        ({"speeds": (1.0,), "steerings": (0.0,), "algo": "ppo-discrete"}, "of ppo"),
    ],
)
def test_a_grid_that_cannot_be_chosen_from_is_refused(settings: dict[str, object], said: str):
    with pytest.raises(ConfigError, match=said):
        PPOConfig(**settings)


def test_a_run_on_a_grid_commands_what_is_on_it_and_resumes_to_the_last_bit(tmp_path: Path):
    settings = TRAIN_PRESETS["allround"].learner
    config = tiny()
    config = replace(
        config, learner=replace(config.learner, speeds=settings.speeds, steerings=settings.steerings), steps=4 * STEPS
    )
    train(config, tmp_path / "once")
    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "killed", dying(after=3))
    resume(tmp_path / "killed")
    once, twice = (load_file(tmp_path / name / "last.safetensors") for name in ("once", "killed"))
    assert all(np.array_equal(values, twice[name]) for name, values in once.items())
    agent = load_policy(str(tmp_path / "once/last.safetensors"))
    assert agent.head == "grid" and agent.grid == (settings.speeds, settings.steerings)
    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (500, agent.observation.size)).astype(np.float32)
    speeds, steerings = agent.action(observations).T
    assert set(speeds) <= set(np.float32(settings.speeds)) and set(steerings) <= set(np.float32(settings.steerings))


def test_the_preset_is_unguided_and_knows_no_shipped_world():
    general = TRAIN_PRESETS["general"]
    assert general.worlds == () and not general.task.guided
    assert "big_track" not in to_json(general)


def test_what_a_fine_tuning_begins_with_is_judged_first_and_stays_the_best_unless_one_is_no_worse(
    finished: Path, tmp_path: Path
):
    begun = tiny(init=str(finished / "best.zip"))
    hasty = replace(begun, learner=replace(begun.learner, lr=0.5))
    train(hasty, tmp_path / "spoilt")
    rows = evaluations(tmp_path / "spoilt")
    at_best = json.loads((finished / "summary.json").read_text(encoding="utf-8"))["best"]
    first = {name: float(rows[0][name]) for name in ("success", "collision")}
    assert rows[0]["total_steps"] == "0" and first == {name: at_best[name] for name in first}
    kept = [row for row in rows if row["best"] == "1"][-1]
    ranks = [(float(row["success"]), -float(row["collision"])) for row in rows]
    assert max(ranks) == (float(kept["success"]), -float(kept["collision"]))
    train(replace(begun, stop_at=0.0), tmp_path / "enough")  # good enough as it is: nothing is learned
    (row,) = evaluations(tmp_path / "enough")
    assert row["total_steps"] == "0" and row["best"] == "1"
    # One that is killed goes on, and is not judged from its beginning again.
    with pytest.raises(KeyboardInterrupt):
        train(begun, tmp_path / "killed", dying(after=5))
    resume(tmp_path / "killed")
    assert [row["total_steps"] for row in evaluations(tmp_path / "killed")].count("0") == 1


def test_another_seed_draws_other_noise_and_other_cars_the_same_one_the_same():
    worlds = list(generate_tracks(range(HELD_OUT_SEED, HELD_OUT_SEED + 4), family="corners"))
    policy = load_policy("shipped")
    its, _ = as_trained(TaskConfig(), "shipped", own_robot=True)

    def times(seed: int) -> list[float]:
        found: list[float] = planar_endings(policy, its, worlds, 4, seed=seed, action_noise=0.6).time_s.ravel().tolist()
        return found

    assert times(0) == times(0) and times(0) != times(7)
    how = {"sim": "planar", "action_noise": 0.6}
    seeds = range(HELD_OUT_SEED, HELD_OUT_SEED + 4)
    a, b = (judge_generated("shipped", seeds, 4, its, seed=seed, **how) for seed in (0, 7))
    assert a != b and a == judge_generated("shipped", seeds, 4, its, seed=0, **how)


def test_a_start_range_that_reaches_a_wall_in_between_ends_that_episode_alone(tmp_path):
    (tmp_path / "wide.yaml").write_text(
        "name: wide\nsegments:\n  - {straight: 1.6, width: 1.14}\n  - {straight: 4.0, width: 1.1}\n"
        "start: {at_m: 1.0, range_x_m: 0.0, range_y_m: 0.0, range_yaw_rad: 1.57}\n",
        encoding="utf-8",
    )
    world = load_world(tmp_path / "wide.yaml")
    outcomes = planar_endings(load_agent("shipped", TaskConfig()), TaskConfig(), [world], 30).outcome
    assert outcomes.shape == (1, 30) and Outcome.COLLISION.code in outcomes
