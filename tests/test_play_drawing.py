"""Strokes and drawings become the segments of a world file, or are refused with the place that is at fault."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import WorldError
from zebrat_bullet.evaluation.rollout import drive_episodes
from zebrat_bullet.files import parse_yaml
from zebrat_bullet.play.check import drawn, opened
from zebrat_bullet.play.drawing import BEHIND_M, Drawing, drawing_of, lay, on_page, parse_drawing
from zebrat_bullet.play.stroke import fit_stroke
from zebrat_bullet.world.elements import Straight, Turn
from zebrat_bullet.world.schema import parse_spec, write_spec


def stroke(*corners: tuple[float, float], trembling_m: float = 0.02) -> list[list[float]]:
    """A hand's line from corner to corner, a point every few centimetres."""
    rng = np.random.default_rng(0)
    parts = [np.linspace(a, b, 80) for a, b in pairwise(corners)]
    line = np.concatenate(parts)
    return (line + rng.normal(0.0, trembling_m, line.shape)).tolist()


def test_a_trembling_right_angle_is_two_legs_and_one_bend(robot):
    fitted = fit_stroke(stroke((0, 0), (4, 0), (4, 4)), 1.4, robot)
    assert len(fitted.points) == 3 and fitted.widths == [1.4, 1.4]
    assert fitted.points[1] == pytest.approx((4, 0), abs=0.2)


def test_a_freehand_curve_is_as_round_as_it_is_drawn(robot):
    turned = np.linspace(0.0, math.pi, 100)
    fitted = fit_stroke(np.column_stack([2 * np.sin(turned), 2 - 2 * np.cos(turned)]).tolist(), 1.2, robot)
    spec, _ = lay(fitted, robot)
    bends = [segment for segment in spec.segments if isinstance(segment, Turn)]
    assert all(bend.radius == pytest.approx(2.0, abs=0.3) for bend in bends)
    assert sum(bend.turn for bend in bends) == pytest.approx(180, abs=30)


def test_a_leg_is_a_straight_and_the_car_begins_where_the_line_does(robot, tmp_path):
    drawing = Drawing(points=[(1, 2), (1, 6), (-3, 6)], widths=[1.4, 1.2], radii=[1.0])
    spec, origin = lay(drawing, robot)
    assert spec.segments == [
        Straight(straight=4 + BEHIND_M - 1.0, width=1.4),  # a round right angle takes its radius of both legs
        Turn(turn=90, radius=1.0, width=1.4),
        Straight(straight=3, width=1.2),
    ]
    track = drawn(drawing.model_dump(), robot, tmp_path)
    start = track.world.start.pose
    assert on_page((start.x, start.y), origin) == pytest.approx((1, 2))
    assert start.yaw + origin.yaw == pytest.approx(math.pi / 2)
    assert on_page(tuple(track.world.open_line.mean(axis=0)), origin) == pytest.approx((-3, 6), abs=0.01)
    assert parse_spec(parse_yaml(track.text, "it", WorldError), "it") == spec


def test_a_world_file_that_was_drawn_can_be_drawn_on(robot, tmp_path):
    drawing = Drawing(points=[(0, 0), (3, 0), (5, 3), (8, 3), (9, 3)], widths=[1.4, 1.3, 1.3, 1.5], radii=[0, 1, 0])
    spec, _ = lay(drawing, robot)
    again = drawing_of(
        parse_spec(parse_yaml(write_spec(spec, tmp_path).read_text(encoding="utf-8"), "it", WorldError), "it")
    )
    assert np.allclose(np.array(again.points) - (BEHIND_M, 0), drawing.points, atol=0.01)
    assert again.widths == drawing.widths and np.allclose(again.radii, [0, 1, 0], atol=0.01)
    assert lay(again, robot)[0] == spec


def test_the_shipped_worlds_open_as_they_are_and_what_a_drawing_cannot_hold_is_not_drawn_on(robot, tmp_path):
    assert opened("track_2", robot, tmp_path).drawing is not None
    buttressed = opened("track_4", robot, tmp_path)
    assert buttressed.drawing is None and buttressed.world is not None


def test_where_the_car_would_take_the_inside_for_open_space_crossing_the_exit_decides(robot, tmp_path):
    wide_s = {"points": [(-3, -1), (0.5, -1), (0.5, 1.5), (3, 1.5)], "widths": [1.4] * 3, "radii": [0.8, 0.8]}
    track = drawn(wide_s, robot, tmp_path)
    assert "once it crosses the exit" in track.note and track.world.open_line is None
    assert np.allclose(track.world.gates[-1].mean(axis=0), track.searched.open_line.mean(axis=0), atol=0.01)
    (record,) = drive_episodes("shipped", TaskConfig(), track.world, seed=0, episodes=[0])
    assert record.outcome == "success"
    assert on_page(record.pose[-1][:2], track.origin)[0] == pytest.approx(3.0, abs=0.15)


GOOD = {"points": [(0, 0), (3, 0), (3, 3)], "widths": [1.4, 1.4], "radii": [0]}


@pytest.mark.parametrize(
    ("changes", "says", "at"),
    [
        ({"widths": [1.4, 0.62]}, "Too narrow here: the passage is 0.62 m wide and the car 0.60 m", (3, 1.5)),
        ({"points": [(0, 0), (3, 0), (3, 0)]}, "Two corners lie on each other", (3, 0)),
        ({"points": [(0, 0), (3, 0), (0, 0.1)]}, "turns back on itself", (3, 0)),
        ({"points": [(0, 0), (3, 0), (3, 0.5)]}, "bend here is too tight", (3, 0.25)),
        ({"points": [(0, 0), (90, 0), (90, 90)]}, "180 m long; at most 100 m", None),
        ({"points": [(0, 0), (0.72, 0), (0.72, 3)], "widths": [0.8, 0.8], "radii": [0.7]}, "no room to begin", (0, 0)),
        (
            {"points": [(0, 0), (6, 0), (6, 3), (2, 3), (2, -4)], "widths": [1.4] * 4, "radii": [0] * 3},
            "The passage runs into itself here",
            ...,
        ),
    ],
)
def test_what_cannot_be_driven_says_why_and_where(changes, says, at, robot, tmp_path):
    track = drawn(GOOD | changes, robot, tmp_path)
    assert track.world is None and says in track.problem.text
    if at is ...:
        assert track.problem.at is not None
    else:
        assert track.problem.at == (None if at is None else pytest.approx(at, abs=0.02))


@pytest.mark.parametrize(
    "garbage",
    [
        None,
        [],
        "drawing",
        {},
        GOOD | {"points": [(0, 0)]},
        GOOD | {"points": [(0, 0), (3, math.nan), (3, 3)]},
        GOOD | {"points": [(0, 0), (1e9, 0), (3, 3)]},
        GOOD | {"widths": [1.4]},
        GOOD | {"radii": [-1]},
        GOOD | {"points": [(i, 0) for i in range(1000)]},
        GOOD | {"colour": "red"},
    ],
)
def test_what_is_no_drawing_is_refused(garbage):
    with pytest.raises(WorldError, match="this is no drawing"):
        parse_drawing(garbage)


@pytest.mark.parametrize(
    ("garbage", "says"),
    [
        (None, "no stroke"),
        ([[0, 0], [1, "a"]], "no stroke"),
        ([[0, 0], [1, math.nan]], "within 500 m"),
        ([[0, 0], [1e300, 0]], "within 500 m"),
        ([[0, 0]] * 6000, "no stroke"),
        ([[0, 0], [0.1, 0]], "drag on"),
        (stroke((0, 0), (300, 0)), "300 m long"),
        (np.random.default_rng(0).uniform(-0.7, 0.7, (200, 2)).tolist(), "too tangled"),
    ],
)
def test_what_is_no_stroke_is_refused(garbage, says, robot):
    with pytest.raises(WorldError, match=says):
        fit_stroke(garbage, 1.4, robot)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "not readable as YAML"),
        ("[1, 2]", "no world file"),
        ("name: a\nmap: /etc/passwd", "names another one"),
        ("name: a\nmesh: a.stl", "names another one"),
        ("name: a\nsegments: [{straight: .nan, width: 1}]", "segments\\[0\\].straight"),
        ("name: a\nsegments: [" + "{straight: 0.1, width: 1.4}, " * 600 + "]", "too large for the page"),
        ("name: a\nsegments: [{straight: 900, width: 1.4}]", "too large for the page"),
    ],
)
def test_a_file_that_the_page_cannot_take_says_why(text, says, robot, tmp_path: Path):
    with pytest.raises(WorldError, match=says):
        opened(text, robot, tmp_path)


def test_an_opened_world_that_reaches_further_than_any_grid_is_refused(robot, tmp_path):
    far = "name: a\nsegments: [{straight: 9, width: 1.4}]\nobstacles: [{post: [99999, 0], radius: 1}]"
    track = opened(far, robot, tmp_path)
    assert track.world is None and "reaches 100000 m from its origin" in track.problem.text
