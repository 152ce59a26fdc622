"""The judge: rates that add up, the same starts for every agent, records that replay exactly."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
import torch

from zebrat_bullet.agents import load_agent
from zebrat_bullet.assets import asset_folder
from zebrat_bullet.config import LidarConfig, NoiseConfig, TaskConfig
from zebrat_bullet.config_text import from_json
from zebrat_bullet.errors import AssetError, ConfigError, WorldError, ZebratError
from zebrat_bullet.evaluation.judge import Judgement, judge, record_path
from zebrat_bullet.evaluation.metrics import score, wilson_interval
from zebrat_bullet.evaluation.records import load_record, save_record
from zebrat_bullet.evaluation.rollout import replay_episode, run_episode
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command, Reading
from zebrat_bullet.world import generate_spec, load_world, write_spec

EMBREE = TaskConfig(lidar=LidarConfig(caster="embree"))


class Straight:
    """Drives straight ahead at full speed, and remembers the last reading it was shown."""

    name = "straight"
    privileged: frozenset[str] = frozenset()

    def __init__(self, privileged: frozenset[str] = frozenset()) -> None:
        self.privileged = privileged

    def reset(self, seed: int) -> None:
        pass

    def act(self, reading: Reading) -> Command:
        self.reading = reading
        return Command(0.6, 0.0)


@pytest.fixture(scope="module")
def drive():
    made = Drive(EMBREE, load_world("track_2"))
    yield made
    made.close()


def test_wilson_interval_of_63_in_70_is_81_to_95_percent():
    low, high = wilson_interval(63, 70)
    assert (round(low, 2), round(high, 2)) == (0.81, 0.95)


def test_rates_add_up_and_time_counts_successes_only(drive):
    record = run_episode(drive, Straight(), 0, 0)
    records = [replace(record, outcome=o) for o in ("success", "collision", "stall", "false_exit")]
    records[0] = replace(records[0], time_s=np.array([0.0, 12.0]))
    result = score(records)
    assert result.success + result.collision + result.fail == 1.0
    assert (result.success, result.collision, result.fail, result.time_s) == (0.25, 0.25, 0.5, 12.0)
    assert score(records[1:]).time_s is None


def test_every_agent_meets_the_same_starts(drive):
    random = load_agent("random", EMBREE)
    for episode in range(3):
        one, two = run_episode(drive, Straight(), 7, episode), run_episode(drive, random, 7, episode)
        assert np.array_equal(one.pose[0], two.pose[0])
    other = run_episode(drive, Straight(), 8, 0)
    assert not np.array_equal(other.pose[0], run_episode(drive, Straight(), 7, 0).pose[0])


def test_only_declared_privileges_are_shown(drive):
    fair, guided = Straight(), Straight(frozenset({"pose", "map", "goal"}))
    run_episode(drive, fair, 0, 0)
    run_episode(drive, guided, 0, 0)
    assert (fair.reading.state, fair.reading.walls, fair.reading.goal_world) == (None, None, None)
    assert guided.reading.state is not None and guided.reading.walls is drive.world.walls
    assert np.array_equal(guided.reading.goal_world, drive.world.waypoints[-1])
    with pytest.raises(
        ConfigError, match="no privilege \\['future'\\]; there are \\['goal', 'map', 'pose', 'waypoint'\\]"
    ):
        run_episode(drive, Straight(frozenset({"future"})), 0, 0)


def test_a_driver_cannot_write_to_what_it_is_shown(drive):
    guided = Straight(frozenset({"pose", "map", "goal", "waypoint"}))
    run_episode(drive, guided, 0, 0)
    shown = dict(_arrays("reading", guided.reading))
    assert len(shown) == 6
    for name, array in shown.items():
        with pytest.raises(ValueError, match="read-only"):
            array += 0.05
        assert not array.flags.writeable, name


def test_the_region_that_reward_terms_see_cannot_be_written_to(drive):
    for array in (drive.region.range_m, drive.region.indices, drive.region.outline_lidar):
        with pytest.raises(ValueError, match="read-only"):
            array += 1


def _arrays(name, value):
    if isinstance(value, np.ndarray):
        yield name, value
    for field in fields(value) if is_dataclass(value) else ():
        yield from _arrays(f"{name}.{field.name}", getattr(value, field.name))


@pytest.mark.parametrize("number", [np.float32, torch.tensor])
def test_a_record_of_single_precision_commands_replays_exactly(drive, number):
    class Single(Straight):
        def reset(self, seed):
            self.rng = np.random.default_rng(seed)

        def act(self, reading):
            return Command(number(self.rng.uniform(0.3, 0.7)), number(self.rng.uniform(-0.7, 0.7)))

    record = run_episode(drive, Single(), 0, 0)
    assert record.command.dtype == np.float64 and np.abs(record.command).max() <= 0.6
    replay_episode(drive, record, drive.world)


@pytest.mark.parametrize("caster", ["embree", "bullet"])
def test_a_saved_record_replays_exactly_with_noise(tmp_path, caster):
    task = replace(EMBREE, lidar=LidarConfig(caster=caster), noise=NoiseConfig(range_sigma_m=0.01, dropout=0.01))
    world = load_world("track_2")
    drive = Drive(task, world)
    record = run_episode(drive, load_agent("random", task), 3, 1)
    drive.close()
    save_record(record, tmp_path / "episode.npz")
    loaded = load_record(tmp_path / "episode.npz")
    assert loaded.outcome == record.outcome and np.array_equal(loaded.pose, record.pose)
    fresh = Drive(from_json(TaskConfig, loaded.task), world)
    again = replay_episode(fresh, loaded, world)
    assert np.array_equal(again.scan_m, record.scan_m)
    with pytest.raises(ZebratError, match="left the recorded path"):
        replay_episode(fresh, replace(loaded, command=-loaded.command), world)
    fresh.close()


def test_a_file_that_is_no_record_is_refused(tmp_path):
    (tmp_path / "x.npz").write_bytes(b"nothing")
    with pytest.raises(ZebratError, match="no whole zip archive"):
        load_record(tmp_path / "x.npz")


def test_the_judge_writes_every_record_and_workers_do_not_change_the_result(tmp_path):
    def run(workers: int):
        what = Judgement(
            agent="random", worlds=("track_1", "track_2"), episodes=6, workers=workers, records=tmp_path, task=EMBREE
        )
        return judge(what)

    one, two = run(1), run(2)
    assert one == two
    assert all(record_path(tmp_path, world, k).is_file() for world in one for k in range(6))


def test_records_of_an_earlier_judgement_are_not_left_beside_the_scores(tmp_path):
    what = Judgement(agent="random", worlds=("track_1",), episodes=2, workers=1, records=tmp_path, task=EMBREE)
    judge(what)
    kept = [tmp_path / "track_1" / name for name in ("mine.npz", "episode_0001.csv", "episode_best.npz")]
    kept.append(record_path(tmp_path, "track_2", 1))  # of a world that is not judged now
    for path in kept:
        path.parent.mkdir(exist_ok=True)
        path.touch()
    with pytest.raises(AssetError):
        judge(replace(what, agent="nobody", episodes=1))
    assert record_path(tmp_path, "track_1", 1).is_file()
    judge(replace(what, episodes=1))
    assert record_path(tmp_path, "track_1", 0).is_file() and not record_path(tmp_path, "track_1", 1).exists()
    assert all(path.is_file() for path in kept)


def test_a_missing_agent_or_world_is_named_before_anything_is_driven(tmp_path):
    what = Judgement(agent="nobody", worlds=("track_1",), episodes=1, task=EMBREE)
    with pytest.raises(AssetError, match="no agent 'nobody': name one of random"):
        judge(what)
    with pytest.raises((AssetError, WorldError), match="track_1"):
        judge(replace(what, agent="random", worlds=("nowhere",)))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"episodes": "2"}, "episodes must be a whole number, 1 to 1000000, got '2'"),
        ({"episodes": 1.5}, "episodes must be a whole number"),
        ({"episodes": True}, "episodes must be a whole number"),
        ({"seed": 1.5}, "seed must be a whole number"),
        ({"seed": -1}, "seed must be at least 0, got -1"),
        ({"agent": None}, "agent must be a str, got None; name one, a policy file or a run folder"),
        ({"task": {}}, r"task must be a TaskConfig, got {}; give TaskConfig\(...\)"),
        ({"worlds": "track_2"}, "worlds must be names or files of worlds, in a list, got 'track_2'"),
        ({"worlds": (load_world("track_2"),)}, r"in a list, got \(World.{,70}; .* by write_spec\(generate_spec"),
    ],
)
def test_what_cannot_be_judged_is_refused_with_what_can(change, said):
    what = Judgement(agent="random", worlds=("track_1",), episodes=np.int64(2), task=EMBREE)
    with pytest.raises(ConfigError, match=said):
        replace(what, **change)


def test_workers_that_are_no_number_are_refused():
    with pytest.raises(ConfigError, match="workers must be a whole number, 1 to 256, got 'a'"):
        judge(Judgement(agent="random", worlds=("track_1",), episodes=1, workers="a", task=EMBREE))


def test_a_generated_track_is_judged_by_the_file_that_it_was_saved_as(tmp_path):
    path = write_spec(generate_spec(3), tmp_path)
    scores = judge(Judgement(agent="random", worlds=[path], episodes=1, workers=1, task=EMBREE))
    assert list(scores) == [path]


def test_a_driver_that_is_none_is_told_what_it_lacks(drive):
    with pytest.raises(ConfigError, match=r"'oracle' lacks name, privileged, reset, act; load_agent\(NAME, task\)"):
        run_episode(drive, "oracle", 0, 0)
    tuples = Straight()
    tuples.act = lambda reading: (0.6, 0.0)
    with pytest.raises(ConfigError, match=r"act must return a Command, got \(0.6, 0.0\); return Command"):
        run_episode(drive, tuples, 0, 0)


def test_a_record_from_a_users_own_world_names_the_file_it_can_be_loaded_from(tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text((asset_folder("worlds") / "track_2.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    drive = Drive(EMBREE, load_world(mine))
    record = run_episode(drive, load_agent("random", EMBREE), 0, 0)
    assert replay_episode(drive, record, load_world(record.world)).outcome == record.outcome
    drive.close()
    assert record.world == str(mine) and load_world("track_2").source == "track_2"
