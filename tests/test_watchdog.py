"""The watchdog: every collapse is driven for real and named, and nothing else is."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from zebrat_bullet.agents import Agent, load_agent
from zebrat_bullet.config import REWARD_PRESETS, EpisodeConfig, LidarConfig, TaskConfig, with_reward
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.evaluation.records import EpisodeRecord, load_record, save_record
from zebrat_bullet.evaluation.rollout import replay_episode, run_episode
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.training.collapses import COLLAPSES, WatchdogConfig
from zebrat_bullet.training.watchdog import WATCHDOG_COLUMNS, CriticProbe, Watchdog
from zebrat_bullet.types import Command, Reading
from zebrat_bullet.world import World, load_world

TASK = TaskConfig(lidar=LidarConfig(caster="embree", n_channels=4), episode=EpisodeConfig(max_steps=320))
ROOM = """
name: room
description: a room of 4.0 x 3.4 m to circle in, with a bent way out
free_space:
  - [[0, -1.7], [4, -1.7], [4, -0.7], [6, -0.7], [6, 3], [4.6, 3], [4.6, 0.7], [4, 0.7], [4, 1.7], [0, 1.7]]
centre_line: [[0, 0], [5.3, 0], [5.3, 4]]
open_line: [[4.6, 3], [6, 3]]
start: {pose: [2, -0.86, 0], range_x_m: 0.05, range_y_m: 0.05, range_yaw_rad: 0.05}
"""
STRAIGHT = """
name: straight
description: a passage without a turn
segments:
  - {straight: 5.0, width: 1.4}
"""


@dataclass
class Script:
    """Drives by a rule: (speed, steering) as shares of 0.6 by the number of the step."""

    rule: Callable[[int], tuple[float, float]]
    name: str = "script"
    privileged: frozenset[str] = frozenset()

    def reset(self, seed: int) -> None:
        self._step = 0

    def act(self, reading: Reading) -> Command:
        speed, steering = self.rule(self._step)
        self._step += 1
        return Command(0.6 * speed, 0.6 * steering)


@dataclass
class StopsAfter:
    """Another agent that stops for good after 60 steps."""

    agent: Agent
    name: str = "stops"
    privileged: frozenset[str] = frozenset()

    def reset(self, seed: int) -> None:
        self.agent.reset(seed)

    def act(self, reading: Reading) -> Command:
        return self.agent.act(reading) if reading.time_s < 12.0 else Command(0.0, 0.0)


STRAIGHT_ON = Script(lambda step: (1.0, 0.0))
FULL_LOCK = Script(lambda step: (1.0, 1.0))
NOTHING = Script(lambda step: (0.0, 0.0))
TO_AND_FRO = Script(lambda step: (1.0 if step % 20 < 10 else -1.0, 0.0))
ROCKING = Script(lambda step: (1.0 if step % 8 < 4 else -1.0, 0.0))

CASES: dict[str, tuple[Agent | str, str, set[str]]] = {
    "full lock in a room": (FULL_LOCK, "room", {"one_action", "circling", "paid_to_stay"}),
    "full lock in a passage": (FULL_LOCK, "track_2", {"one_action", "crashing_at_once"}),
    "straight on into a bend": (STRAIGHT_ON, "track_2", {"one_action", "crashing_at_once"}),
    "straight on where there is no bend": (STRAIGHT_ON, "straight", set()),
    "no motion": (NOTHING, "track_2", {"one_action", "standing_still"}),
    "rocking on the spot": (ROCKING, "track_2", {"standing_still"}),
    "to and fro in a passage": (TO_AND_FRO, "track_2", {"circling"}),
    "random commands": ("random", "track_2", set()),
    "a policy that drives out": ("shipped", "track_2", set()),
    "a policy that drives out of a long passage": ("shipped", "big_track", set()),
    "a policy that wanders before it leaves": ("shipped", "track_7", set()),
    "a policy that drives straight on and crashes": ("il", "track_4", {"crashing_at_once"}),
    "a policy that drives on and then crashes": ("il", "track_6", set()),
    "a planner that knows the map": ("oracle", "track_4", set()),
}


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], World]:
    """Loads a shipped world or one of this file's."""
    folder = tmp_path_factory.mktemp("worlds")
    own = {"room": folder / "room.yaml", "straight": folder / "straight.yaml"}
    own["room"].write_text(ROOM, encoding="utf-8")
    own["straight"].write_text(STRAIGHT, encoding="utf-8")
    return lambda name: load_world(own.get(name, name))


@pytest.fixture(scope="module")
def drive() -> Iterator[Drive]:
    made = Drive(TASK, load_world("track_2"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def evaluate(drive: Drive, worlds: Callable[[str], World]) -> Callable[[str], list[EpisodeRecord]]:
    """Drives two episodes of a case, once."""
    driven: dict[str, list[EpisodeRecord]] = {}

    def make(case: str) -> list[EpisodeRecord]:
        if case not in driven:
            agent, world, _ = CASES[case]
            agent = load_agent(agent, TASK) if isinstance(agent, str) else agent
            driven[case] = [run_episode(drive, agent, 0, episode, worlds(world)) for episode in range(2)]
        return driven[case]

    return make


def examine(records: list[EpisodeRecord], **config: float) -> dict[str, str]:
    """Return what a new watchdog measures, by the name of the collapse."""
    findings = Watchdog(WatchdogConfig(**config)).examine(records, None, share=1.0)
    return {finding.name: finding.measured for finding in findings}


@pytest.mark.parametrize("case", CASES)
def test_each_way_of_driving_is_named_and_nothing_else_is(case, evaluate) -> None:
    assert set(examine(evaluate(case))) == CASES[case][2]


def test_what_was_measured_is_said_in_numbers(evaluate) -> None:
    crashing = examine(evaluate("straight on into a bend"))
    assert "2 of 2 episodes, as track_2 0: collision after 1" in crashing["crashing_at_once"]
    assert "+0.60 m/s (spread 0.0% of the limit) and +0.00 rad (spread 0.0%)" in crashing["one_action"]
    standing = examine(evaluate("no motion"))["standing_still"]
    assert "stall after 70 steps and 0.0 m, the last 70 within 0.01 m" in standing
    assert "no more than the -50 of a crash" in standing


def test_a_circle_is_measured_as_driven(evaluate) -> None:
    measured = examine(evaluate("full lock in a room"))
    # In 60 s at 0.6 m/s the rear axle drives 36 m on a radius of 0.819 m, so 7.0 turns. The body's centre is 0.271 m
    # before it and runs on a radius of 0.863 m: 37.9 m, in a box of 2.44 m diagonal.
    numbers = re.search(r"drove (.*) m within (.*) m and turned (.*) times, then timeout", measured["circling"])
    assert [float(number) for number in numbers.groups()] == pytest.approx([37.9, 2.44, 7.0], rel=0.02)
    assert "the exit is worth +50" in measured["paid_to_stay"]


@pytest.mark.parametrize(("reward", "pay"), [("fomt", 1.1), ("fot", 8.7), ("ft", 9.1)])
def test_circling_pays_where_there_is_the_space_for_it(reward: str, pay: float, worlds) -> None:
    task = replace(TASK, reward=REWARD_PRESETS[reward], episode=EpisodeConfig(max_steps=135))  # three circles
    drive = Drive(task, worlds("room"))
    record = run_episode(drive, FULL_LOCK, 0, 0)
    drive.close()
    assert record.reward.mean() == pytest.approx(pay, abs=0.1)


@pytest.mark.parametrize(("case", "pay"), [("no motion", -4.4), ("to and fro in a passage", -5.2)])
def test_staying_in_a_passage_costs(case: str, pay: float, evaluate) -> None:
    assert evaluate(case)[0].reward.mean() == pytest.approx(pay, abs=0.2)


def test_a_car_that_drove_well_and_then_stopped_stands_still_but_was_not_paid_to_stay() -> None:
    drive = Drive(replace(TASK, reward=REWARD_PRESETS["ft"]), load_world("track_2"))
    record = run_episode(drive, StopsAfter(load_agent("shipped", TASK)), 0, 0)
    drive.close()
    assert record.outcome == "stall" and record.reward.sum() > 50.0
    findings = examine([record])
    assert set(findings) == {"standing_still"}
    assert re.search(r"stall after 1\d\d steps and \d\.\d m, the last 70 within 0\.\d\d m", findings["standing_still"])


def test_a_car_that_waypoints_pay_until_it_is_cut_off_is_not_paid_to_stay() -> None:
    task = replace(with_reward(TASK, "wg"), episode=EpisodeConfig(max_steps=100))
    drive = Drive(task, load_world("big_track"))
    record = run_episode(drive, load_agent("shipped", TASK), 0, 0)
    drive.close()
    assert record.outcome == "timeout" and record.reward.sum() > 50.0 and record.reward[-70:].mean() > 0
    assert "paid_to_stay" not in examine([record])


def test_standing_is_said_to_pay_where_it_does(evaluate) -> None:
    (record,) = evaluate("no motion")[:1]
    paid = replace(record, reward=np.full_like(record.reward, 0.1))
    measured = examine([paid])["standing_still"]
    assert "these paid 7, more than the -50 of a crash" in measured


def test_most_episodes_must_show_it(evaluate) -> None:
    crashed, left = evaluate("straight on into a bend"), evaluate("a policy that drives out")
    assert "crashing_at_once" in examine([*crashed, crashed[0], left[0]])
    assert examine([*crashed, *left]) == {}


def test_a_collapse_is_confirmed_once_it_has_lasted_and_not_early_in_the_run(evaluate) -> None:
    dog = Watchdog(WatchdogConfig(patience=2, min_share=0.5))
    crashing, driving = evaluate("straight on into a bend"), evaluate("a policy that drives out")
    for records, share, in_a_row, confirmed in [
        (crashing, 0.1, [1, 1], None),
        (crashing, 0.2, [2, 2], None),
        (crashing, 0.5, [3, 3], "one_action"),
        (driving, 0.6, [], None),
        (crashing, 0.7, [1, 1], None),
        (crashing, 0.8, [2, 2], "one_action"),
    ]:
        findings = dog.examine(records, None, share)
        assert [finding.in_a_row for finding in findings] == in_a_row
        assert (dog.confirmed.name if dog.confirmed else None) == confirmed
        assert dog.confirmed is None or dog.confirmed in findings


def test_a_resumed_run_goes_on_where_the_watchdog_was(evaluate) -> None:
    config, records = WatchdogConfig(patience=2), evaluate("no motion")
    probe = CriticProbe(np.linspace(-1.0, 1.0, 16))
    dog = Watchdog(config)
    dog.examine(records, probe, 1.0)
    again = Watchdog(config, json.loads(json.dumps(dog.state())))
    findings = again.examine(records, probe, 1.0)
    assert [(finding.name, finding.in_a_row) for finding in findings] == [
        ("frozen_critic", 1),
        ("one_action", 2),
        ("standing_still", 2),
    ]
    assert again.confirmed is not None and again.confirmed.name == "one_action"


def critic_findings(records: list[EpisodeRecord], *values: np.ndarray) -> list[list[str]]:
    """Return the findings about critics that one watchdog sees one after the other."""
    dog = Watchdog(WatchdogConfig())
    return [
        [finding.measured for finding in dog.examine(records, CriticProbe(now), 1.0) if finding.name == "frozen_critic"]
        for now in values
    ]


def test_a_critic_that_no_longer_moves_is_frozen_and_one_that_learns_is_not(evaluate) -> None:
    records = evaluate("a policy that drives on and then crashes")
    values = np.random.default_rng(0).normal(-20.0, 5.0, 64)
    first, learns, stays, creeps = critic_findings(records, values, 1.05 * values, 1.05 * values, 1.0503 * values)
    assert first == learns == []
    assert "moved by 0 since the last evaluation" in stays[0] and "moved by 0.006" in creeps[0]


def test_a_critic_that_says_the_same_of_everything_is_frozen(evaluate) -> None:
    records = evaluate("a policy that drives on and then crashes")
    outlier = np.full(64, 101.7)
    outlier[5] = -222_393.0  # as seen of DDPG with a critic's learning rate of 20
    near = 80 + np.linspace(0, 0.1, 64)
    dead, nearly, mostly, alive = critic_findings(records, np.full(64, 100.8), near, outlier, np.arange(64.0))
    assert dead == ["half of the critic's 64 values lie between 100.8 and 100.8, whatever it sees"]
    assert len(nearly) == len(mostly) == 1 and alive == []
    assert critic_findings(records, np.zeros(64)) != [[]]


def test_critics_are_compared_on_the_same_sample_only(evaluate) -> None:
    values = np.linspace(-1.0, 1.0, 64)
    records = evaluate("a policy that drives out")
    assert critic_findings(records, values, values[::2]) == [[], []]


def test_a_critic_that_stands_still_where_the_policy_succeeds_is_listed_but_no_collapse(evaluate) -> None:
    dog, probe = Watchdog(WatchdogConfig(patience=1)), CriticProbe(np.linspace(-1.0, 1.0, 16))
    for _ in range(3):
        findings = dog.examine(evaluate("a policy that drives out"), probe, 1.0)
    assert [finding.name for finding in findings] == ["frozen_critic"] and dog.confirmed is None
    findings = dog.examine(evaluate("no motion"), probe, 1.0)
    assert dog.confirmed is findings[0] and findings[0].record.outcome == "stall"


def test_a_finding_can_be_filmed_and_logged(evaluate, drive, worlds, tmp_path: Path) -> None:
    dog = Watchdog(WatchdogConfig())
    findings = dog.examine(evaluate("full lock in a room"), None, 1.0)
    log = CsvLog(tmp_path / "watchdog.csv", WATCHDOG_COLUMNS)
    for finding in findings:
        log.append(finding.row(40))
    assert [row["name"] for row in log.rows()] == ["one_action", "circling", "paid_to_stay"]
    assert {row["episode"] for row in log.rows()} == {"40"} and set(COLLAPSES) >= {row["name"] for row in log.rows()}
    save_record(findings[1].record, tmp_path / "circling.npz")
    record = load_record(tmp_path / "circling.npz")
    assert replay_episode(drive, record, load_world(record.world)).outcome == "timeout"


@pytest.mark.parametrize("setting", [{"patience": 0}, {"most": 0.0}, {"min_share": 1.5}, {"circling_ratio": 1.0}])
def test_settings_that_make_no_sense_are_refused(setting: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=f"watchdog {next(iter(setting))} must be"):
        WatchdogConfig(**setting)


@pytest.mark.parametrize("values", [np.array([1.0]), np.array([[1.0, 2.0]]), np.array([1.0, np.nan])])
def test_a_critic_probe_is_a_row_of_finite_values(values: np.ndarray) -> None:
    with pytest.raises(ConfigError, match="row of at least 2 finite values"):
        CriticProbe(values)
