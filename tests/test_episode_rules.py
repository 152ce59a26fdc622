"""When an episode is over, for many cars at once: the rules against paths written down by hand.

The open-space line crosses the x axis at 5 m, from y = -0.5 to 0.5, and the way out is along x. The lidar of ZebraT
stands 0.4 m ahead of its middle, so a car that looks along x has it on the line at x = 4.6.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from zebrat_bullet.arrays import Array, on_host
from zebrat_bullet.config import EpisodeConfig
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.task.episode import EpisodeRules, Outcome

LINE = np.array([[5.0, -0.5], [5.0, 0.5]])
NARROW_M, WIDE_M = 1.5, 8.1
Path = list[tuple[float, float, float]]
Judge = Callable[..., list[list[str | None]]]


@pytest.fixture(params=["numpy", "torch"])
def judge(request: pytest.FixtureRequest, robot: RobotModel) -> Judge:
    """Returns the outcome of each car after each step of its path, the first pose of which is where it begins."""
    make: Callable[[np.ndarray], Array] = np.asarray if request.param == "numpy" else torch.as_tensor

    def run(*paths: Path, width_m: float = NARROW_M, line: np.ndarray = LINE, **rules: float) -> list[list[str | None]]:
        config, n = EpisodeConfig(**rules), len(paths)
        poses = np.array(paths, float)
        watch = EpisodeRules(config, robot, make(np.zeros((n, 3))))
        most = np.full(n, config.max_steps, np.int32)
        watch.begin(np.arange(n), make(poses[:, 0]), make(np.tile(line, (n, 1, 1))), make(most))
        no, width = make(np.zeros(n, bool)), make(np.full(n, width_m))
        codes = [on_host(watch.judge(make(poses[:, t]), no, no, width)) for t in range(1, poses.shape[1])]
        return [[Outcome.of(int(code)) for code in car] for car in np.transpose(codes)]

    return run


def along(*xs: float, y: float = 0.0) -> Path:
    return [(x, y, 0.0) for x in xs]


def test_the_lidar_six_tenths_past_the_line_is_out_whatever_it_sees(judge: Judge) -> None:
    assert judge(along(4.5, 4.7, 5.0, 5.19, 5.21)) == [[None, None, None, "success"]]
    assert judge(along(4.5, 4.7, 4.79, 4.81), out_m=0.2) == [[None, None, "success"]]


def test_who_sees_open_space_is_out_once_past_the_line_and_mistaken_before(judge: Judge) -> None:
    assert judge(along(4.5, 4.59, 4.61), width_m=WIDE_M) == [["false_exit", "success"]]
    assert judge(along(4.5, 4.61), width_m=8.0) == [[None]]  # above 8 m is open, 8 m is not


def test_the_line_counts_for_the_lidar_and_not_for_the_middle_of_the_car(judge: Judge) -> None:
    backwards = [(x, 0.0, math.pi) for x in (4.9, 5.1, 5.39, 5.41)]
    assert judge(backwards, width_m=WIDE_M) == [["false_exit", "false_exit", "success"]]


def test_a_leg_beside_the_exit_does_not_lead_out_across_the_lines_extension(judge: Judge) -> None:
    beside = along(4.5, 5.0, 6.0, 7.0, y=2.0)
    assert judge(beside) == [[None, None, None]]
    assert judge(beside, width_m=WIDE_M) == [["false_exit"] * 3]
    margin = [along(4.5, 5.3, y=y) for y in (0.59, 0.61, -0.59, -0.61)]  # the line ends at 0.5
    assert judge(*margin) == [["success"], [None], ["success"], [None]]


def test_a_car_that_comes_back_is_in_again(judge: Judge) -> None:
    assert judge(along(4.5, 4.8, 4.5, 4.5), width_m=WIDE_M) == [["success", "false_exit", "false_exit"]]
    assert judge(along(4.5, 4.8, 4.5, 4.8, 5.3)) == [[None, None, None, "success"]]


def test_without_a_line_nothing_is_ever_out(judge: Judge) -> None:
    nowhere = np.full((2, 2), math.nan)
    assert judge(along(4.5, 6.0, 9.0), line=nowhere) == [[None, None]]
    assert judge(along(4.5, 6.0), line=nowhere, width_m=WIDE_M) == [["false_exit"]]


def test_a_car_that_gains_less_than_the_stall_distance_between_two_checks_stalls(judge: Judge) -> None:
    creeping = along(*(0.02 * t for t in range(7)))
    assert judge(creeping, stall_steps=3, stall_distance_m=0.05) == [[None] * 6]
    assert judge(creeping, stall_steps=3, stall_distance_m=0.07) == [[None, None, "stall"] * 2]
    circling = along(0.0, 0.1, 0.2, 0.1, 0.0)
    assert judge(circling, stall_steps=4, stall_distance_m=0.05) == [[None, None, None, "stall"]]


def test_the_last_step_is_a_time_out(judge: Judge) -> None:
    assert judge(along(0.0, 1.0, 2.0, 3.0), max_steps=3) == [[None, None, "timeout"]]


def test_the_graver_end_comes_first(robot: RobotModel) -> None:
    """Collision before success before a stall before a time-out, all in the same step."""
    rules = EpisodeRules(EpisodeConfig(max_steps=1, stall_steps=1), robot, np.zeros((5, 3)))
    start = np.tile([4.59, 0.0, 0.0], (5, 1))
    rules.begin(np.arange(5), start, np.tile(LINE, (5, 1, 1)), np.full(5, 1, np.int32))
    yes, width = np.array([True, False, False, False, False]), np.array([9.0, 9.0, 9.0, 1.0, 1.0])
    poses = start + np.array([[0.02, 0, 0], [0.02, 0, 0], [0.0, 0, 0], [0.0, 0, 0], [-0.3, 0, 0]])
    codes = rules.judge(poses, yes, np.zeros(5, bool), width)
    names = [Outcome.of(int(code)) for code in codes]
    assert names == ["collision", "success", "false_exit", "stall", "timeout"]
    assert Outcome.of(int(rules.judge(poses, ~yes, yes, width)[0])) == "collision"  # a scan within the outline too


def test_cars_at_different_steps_do_not_touch_each_other(robot: RobotModel) -> None:
    """One car begins anew at every step; the others must not notice."""
    config = EpisodeConfig(max_steps=9, stall_steps=4)
    no, width = np.zeros(3, bool), np.full(3, NARROW_M)
    rules = EpisodeRules(config, robot, np.zeros((3, 3)))
    lines, most = np.tile(LINE, (3, 1, 1)), np.full(3, 9, np.int32)
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [3.8, 0.0, 0.0]])
    rules.begin(np.arange(3), poses, lines, most)
    found = []
    for _ in range(9):
        poses = poses + np.array([[0.2, 0.0, 0.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]])
        found.append([Outcome.of(int(code)) for code in rules.judge(poses, no, no, width)])
        rules.begin(np.array([1]), poses[1:2], lines[:1], most[:1])
    first, second, third = zip(*found, strict=True)
    assert first == (*[None] * 8, "timeout")
    assert second == (None,) * 9
    assert third == (*[None] * 4, *["success"] * 4, "success")  # 3.8 + 5 * 0.3 + 0.4 = 5.7 m
