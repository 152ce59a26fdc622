"""A world without an exit is won by its goal, its line, or a lap; that nobody can win one is said before."""

import itertools
import json
import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

import zebrat_bullet  # noqa: F401 (registers the env ids)
from zebrat_bullet.agents import load_agent
from zebrat_bullet.cli import main
from zebrat_bullet.config import EpisodeConfig, TaskConfig
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.evaluation.judge import Judgement, judge, require_winnable_by
from zebrat_bullet.evaluation.records import load_record
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.task.episode import EpisodeRules, Outcome, gates_of
from zebrat_bullet.training.presets import TRAIN_PRESETS
from zebrat_bullet.training.run import train
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, WorldNote, load_world

ROOM = "free_space: [[[0, 0], [8, 0], [8, 4], [0, 4]]]\n"
IN_ROOM = "name: room\n" + ROOM + "start: {pose: [1.5, 2, 0], range_x_m: 0, range_y_m: 0, range_yaw_rad: 0}\n"
# A ring 2 m wide round a block of 6 m x 2 m.
RING = """name: ring
free_space: [[[0, 0], [10, 0], [10, 6], [0, 6]]]
obstacles: [{box: [5, 3], size: [6, 2]}]
start: {pose: [5, 1, 0], range_x_m: 0, range_y_m: 0, range_yaw_rad: 0}
centre_line: [[1, 1], [9, 1], [9, 5], [1, 5], [1, 1]]
"""
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def made(text: str, name: str = "own") -> Path:
        path = tmp_path / f"{name}.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return made


def drive_rules(world: World, robot: RobotModel, path: np.ndarray, library: str) -> list[str | None]:
    """Return the outcome after each step of a (T, 3) path of one car that sees open space all the time."""
    make = np.asarray if library == "numpy" else torch.as_tensor
    rules = EpisodeRules(EpisodeConfig(), robot, make(np.zeros((1, 3))))
    gates = gates_of([world])
    rules.begin(
        np.array([0]),
        make(path[:1]),
        make(np.full((1, 2, 2), np.nan)),
        make(np.array([1000], np.int32)),
        None if gates is None else make(gates),
    )
    no, wide = make(np.zeros(1, bool)), make(np.array([9.0]))
    return [Outcome.of(int(rules.judge(make(pose[None]), no, no, wide)[0])) for pose in path[1:]]


def along(points: list[tuple[float, float]], step_m: float = 0.1) -> np.ndarray:
    """Return (T, 3) poses along a line of points."""
    poses = []
    for a, b in itertools.pairwise(points):
        n = round(math.dist(a, b) / step_m)
        yaw = math.atan2(b[1] - a[1], b[0] - a[0])
        poses += [(a[0] + (b[0] - a[0]) * i / n, a[1] + (b[1] - a[1]) * i / n, yaw) for i in range(n)]
    return np.array([*poses, (*points[-1], poses[-1][2])])


@pytest.mark.parametrize("library", ["numpy", "torch"])
def test_a_goal_is_reached_within_half_a_metre_and_open_space_ends_nothing(
    write: Write, robot: RobotModel, library: str
) -> None:
    world = load_world(write(IN_ROOM + "goal: [6.5, 2]\n"))
    assert world.can_be_won and world.open_line is None
    assert world.waypoints.tolist() == [[6.5, 2.0]]
    outcomes = drive_rules(world, robot, along([(1.5, 2), (7.0, 2)], 0.1), library)
    assert outcomes.index("success") == 44  # 1.5 + 45 * 0.1 = 6.0 m
    assert set(outcomes[:44]) == {None}
    passes_by = drive_rules(world, robot, along([(1.5, 2.6), (7.0, 2.6)]), library)
    assert set(passes_by) == {None}


@pytest.mark.parametrize("library", ["numpy", "torch"])
def test_a_goal_line_is_crossed_between_its_ends(write: Write, robot: RobotModel, library: str) -> None:
    world = load_world(write(IN_ROOM + "goal: [[5.0, 1.0], [5.0, 3.0]]\n"))
    outcomes = drive_rules(world, robot, along([(1.5, 2), (7.0, 2)]), library)
    assert outcomes.index("success") == 34  # on the line at 5.0 m, after 35 steps
    assert set(drive_rules(world, robot, along([(1.5, 3.2), (7.0, 3.2)]), library)) == {None}


@pytest.mark.parametrize("library", ["numpy", "torch"])
def test_a_lap_is_driven_once_round_and_the_way_the_car_looks(write: Write, robot: RobotModel, library: str) -> None:
    world = load_world(write(RING))
    assert world.is_circuit and len(world.gates) == 4 and len(world.waypoints) > 10
    lap = [(5.0, 1.0), (9.0, 1.0), (9.0, 5.0), (1.0, 5.0), (1.0, 1.0), (4.9, 1.0), (5.2, 1.0)]
    outcomes = drive_rules(world, robot, along(lap), library)
    assert "success" not in outcomes[:-4] and "success" in outcomes[-4:]
    backwards = [(5.0, 1.0), (1.0, 1.0), (1.0, 5.0), (9.0, 5.0), (9.0, 1.0), (5.0, 1.0)]
    wrong_way = along([*backwards, *backwards[1:], *backwards[1:]])
    assert set(drive_rules(world, robot, wrong_way, library)) == {None}
    there_and_back = [(5.0, 1.0), (9.0, 1.0), (9.0, 5.0), (9.0, 1.0), (4.0, 1.0)]
    assert set(drive_rules(world, robot, along(there_and_back), library)) == {None}
    turned = load_world(write(RING.replace("[5, 1, 0]", "[5, 1, 180]")))
    assert drive_rules(turned, robot, along([*backwards[:-1], (4.8, 1.0)]), library)[-1] == "success"


def test_a_planner_that_drives_to_a_goal_is_not_judged_on_a_lap(write: Write) -> None:
    path = write(RING)
    what = Judgement(agent="oracle", worlds=(str(path),), episodes=1, workers=1, task=TaskConfig())
    with pytest.raises(WorldError, match=r"won by a lap, and oracle drives to a goal.*--goal"):
        judge(what)
    require_winnable_by(load_agent("oracle", TaskConfig()), load_world(path, goal=(9.0, 5.0)))
    require_winnable_by(load_agent("shipped", TaskConfig()), load_world(path))


def test_no_gates_are_left_from_the_world_before(write: Write, robot: RobotModel) -> None:
    """A car that drove to a goal and then begins in a world without one takes open space for an end again."""
    world = load_world(write(IN_ROOM + "goal: [6.5, 2]\n"))
    rules = EpisodeRules(EpisodeConfig(), robot, np.zeros((1, 3)))
    pose, most = np.array([[6.4, 2.0, 0.0]]), np.array([1000], np.int32)
    line, no = np.full((1, 2, 2), np.nan), np.zeros(1, bool)
    rules.begin(np.array([0]), pose, line, most, gates_of([world]))
    rules.begin(np.array([0]), pose, line, most)
    assert Outcome.of(int(rules.judge(pose, no, no, np.array([9.0]))[0])) == "false_exit"


def test_the_oracle_arrives_in_an_empty_room(write: Write, tmp_path: Path) -> None:
    path = write("name: room\n" + ROOM + "start: {pose: [1.5, 2, 0]}\nwaypoints: [[6.5, 2]]\n")
    what = Judgement(agent="oracle", worlds=(str(path),), episodes=1, workers=1, task=TaskConfig(), records=tmp_path)
    score = judge(what)[str(path)]
    assert score.success == 1.0
    assert load_record(tmp_path / "own" / "episode_0000.npz").pose[-1][0] == pytest.approx(6.0, abs=0.15)


def test_planar_cars_reach_goals_by_the_same_rule(write: Write) -> None:
    goal = write(IN_ROOM + "goal: [6.5, 2]\n")
    envs = PlanarVectorEnv(2, [goal, "track_2"])
    envs.reset(seed=0)
    envs.drive.begin_at(np.array([0, 0], np.int32), [Pose2(5.5, 2.0, 0.0), Pose2(3.0, 2.0, 0.0)])
    names = []
    for _ in range(12):
        *_, info = envs.step(np.tile(np.array([1.0, 0.0], np.float32), (2, 1)))
        names.append(list(info.get("outcome", [None, None])))
    assert [car[0] for car in names].count("success") >= 1
    assert names[0] == [None, None] and names[4][1] is None


def test_a_world_that_nobody_can_win_is_refused_before_anyone_drives(write: Write, tmp_path: Path) -> None:
    path = write("name: aimless\nmap: track_2.yaml\nstart: {pose: [1.5, 0, 0]}\n")
    assert main(["worlds", "track_2", "--map", str(tmp_path), "--quiet"]) == 0
    what = Judgement(agent="random", worlds=(str(path),), episodes=1, workers=1, task=TaskConfig())
    with pytest.raises(WorldError, match=r"goal: nothing can be reached.*--goal"):
        judge(what)
    config = TRAIN_PRESETS["quick"]
    with pytest.raises(WorldError, match="nothing can be reached"):
        train(replace(config, worlds=(str(path),)), tmp_path / "run")
    for command in ("video", "teleop"):
        assert main([command, "--world", str(path), "--out", str(tmp_path / "made"), "--quiet"]) == 2
    assert not (tmp_path / "made").exists()
    with pytest.warns(UserWarning, match="neither exit nor goal"):
        gymnasium.make("ZebraT/BigTrack-v0", world=path).close()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium.make("ZebraT/BigTrack-v0", world=path, goal=(3.5, 0.0)).close()


def test_training_from_anywhere_on_a_world_without_a_centre_line_is_refused_once(write: Write, tmp_path: Path) -> None:
    path = write(IN_ROOM + "goal: [6.5, 2]\n")
    config = TRAIN_PRESETS["general"]
    with pytest.raises(ConfigError, match=r"has no centre line.*--set task\.episode\.start=start"):
        train(replace(config, worlds=(str(path),)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        ("[1.7, 2.2]", "already begins within"),
        ("[20, 2]", "no way as wide"),
        ("[[5, 1.8], [5, 2.0]]", "shorter than the car"),
    ],
)
def test_a_goal_that_is_none_is_refused(write: Write, goal: str, said: str) -> None:
    with pytest.raises(WorldError, match=f"goal: .*{said}"):
        load_world(write(IN_ROOM + f"goal: {goal}\n"))


def test_a_goal_that_ends_nothing_is_told_at_the_line_that_named_it() -> None:
    said = r"its exit decides, so reaching the goal \(2.6, 0\) ends nothing"
    with pytest.warns(WorldNote, match=said) as told:
        ZebratEnv("track_2", goal=(2.6, 0.0)).close()
    assert [each.filename for each in told] == [__file__]


def test_a_goal_behind_a_gap_too_narrow_for_the_car_is_refused(write: Write) -> None:
    shut = IN_ROOM + "obstacles: [{box: [4, 0.85], size: [0.2, 1.75]}, {box: [4, 3.15], size: [0.2, 1.75]}]\n"
    with pytest.raises(WorldError, match="no way as wide as the car"):
        load_world(write(shut + "goal: [6.5, 2]\n"))
    assert load_world(write(shut.replace("3.15", "3.3") + "goal: [6.5, 2]\n")).can_be_won


def test_a_corridor_too_wide_for_the_open_space_rule_is_won_by_its_goal(write: Write) -> None:
    wide = "name: wide\nsegments: [{straight: 8, width: 4.5}]\n"
    with pytest.raises(WorldError, match="already seen"):
        load_world(write(wide))
    with pytest.warns(UserWarning, match="reaching the goal is success"):
        world = load_world(write(wide + "goal: [7, 0]\n"))
    assert world.open_line is None and world.gates.tolist() == [[[7.0, 0.0], [7.0, 0.0]]]
    narrow = load_world(write("name: narrow\nsegments: [{straight: 4, width: 1.5}]\nwaypoints: [[5, 0]]\n"))
    assert narrow.open_line is not None and not len(narrow.gates)


def test_an_exit_without_a_centre_line_leads_away_from_the_start(write: Write, tmp_path: Path) -> None:
    main(["worlds", "track_2", "--map", str(tmp_path), "--quiet"])
    track = load_world("track_2")
    ends = track.open_line.tolist()
    assert track.open_line is not None
    for exit in (ends, ends[::-1]):
        world = load_world(tmp_path / "track_2.yaml", start=track.start.pose, exit=exit)
        assert world.open_line is not None and np.allclose(world.open_line, track.open_line)
        assert np.allclose(world.waypoints[-1], track.waypoints[-1], atol=0.01)
    with pytest.raises(WorldError, match="does not part the way out"):
        load_world(tmp_path / "track_2.yaml", start=track.start.pose, exit=[[3.0, 0.0], [3.1, 0.0]])


def test_start_and_goal_on_the_command_line_are_those_of_the_keywords_and_of_the_record(
    write: Write, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write(IN_ROOM + "goal: [6.5, 2]\n")
    out = tmp_path / "out"
    options = ["--start", "2.0", "3.0", "-90", "--goal", "2", "1"]
    assert main(["evaluate", "--agent", "oracle", "--worlds", str(path), "--episodes", "1", "--workers", "1",
                 "--out", str(out), "--json", "--quiet", *options]) == 0  # fmt: skip
    assert json.loads(capfd.readouterr().out)[str(path)]["success"] == 1.0
    record = load_record(out / "records" / "own" / "episode_0000.npz")
    assert record.pose[0] == pytest.approx([2.0, 3.0, -math.pi / 2], abs=1e-6)
    again = load_world(record.world)
    named = load_world(path, start=(2.0, 3.0, -math.pi / 2), goal=(2.0, 1.0))
    assert again.start.pose == named.start.pose and again.source == named.source == record.world
    assert main(["replay", str(out / "records" / "own" / "episode_0000.npz"), "--quiet"]) == 0
    env = gymnasium.make("ZebraT/BigTrack-v0", world=path, start=Pose2(2.0, 3.0, -math.pi / 2), goal=(2, 1))
    assert env.unwrapped.drive.world.start.pose == named.start.pose
    env.close()
    assert main(["evaluate", "--agent", "oracle", "--worlds", "track_1", "track_2", "--goal", "1", "2"]) == 2
    assert "one world, got 2" in capfd.readouterr().err


@pytest.mark.parametrize("start", [(1.0, 2.0), (1.0, 2.0, math.nan), "abc", (1e9, 0.0, 0.0), 3])
def test_a_start_that_is_no_pose_is_refused(start: object) -> None:
    with pytest.raises(WorldError, match="start: takes"):
        load_world("track_1", start=start)  # type: ignore[arg-type]
