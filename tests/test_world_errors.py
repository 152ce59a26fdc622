"""A bad world file is refused with its name, the field at fault and what to do."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zebrat_bullet.errors import AssetError, WorldError
from zebrat_bullet.report.sketch import draw_sketches
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import WorldNote, load_world, sketch_world

HEAD = "name: bad\n"
GOOD = HEAD + "segments:\n  - {straight: 4.0, width: 1.5}\n"
LOOP = """segments:
  - {straight: 4.0, width: 1.4}
  - {turn: 90}
  - {straight: 3.0, width: 1.4}
  - {turn: 90}
  - {straight: 2.5, width: 1.4}
  - {turn: 90}
  - {straight: 4.0, width: 1.4}
"""
HALL = """free_space:
  - [[0, -1], [5, -1], [5, -7], [9, -7], [9, 7], [5, 7], [5, 1], [0, 1]]
  - [[9, -1], [12, -1], [12, 1], [9, 1]]
centre_line: [[0, 0], [14, 0]]
open_line: [[12, -1], [12, 1]]
start: {pose: [1.5, 0, 0]}
"""
BOW_TIE = """free_space: [[[0, -1], [4, 1], [4, -1], [0, 1]]]
centre_line: [[0, 0], [6, 0]]
open_line: [[4, -1], [4, 1]]
start: {pose: [1.5, 0, 0]}
"""
CASES = {
    "walls that cross": (HEAD + LOOP, "segments[6]", "lengthen"),
    "a free space that crosses itself": (HEAD + BOW_TIE, "free_space[0]", "reorder"),
    "a start in a wall": (GOOD + "start: {at_m: 0.4}\n", "start:", "move the start"),
    "a start range that reaches a wall": (GOOD + "start: {range_y_m: 0.5}\n", "start:", "smaller"),
    "a buttress past the end": (
        GOOD + "obstacles:\n  - {buttress: left, at_m: 50, length: 0.3, depth: 0.2}\n",
        "obstacles[0].at_m: 50.0 m is past the end at 4.00 m",
        "lower it",
    ),
    "a start past the end": (GOOD + "start: {at_m: 9}\n", "start.at_m", "lower"),
    "a passage narrower than the car": (
        GOOD + "  - {straight: 1.0, width: 0.55}\n  - {straight: 1.0, width: 1.5}\n",
        "0.55 m wide",
        "widen",
    ),
    "a passage narrower than the car, where it starts": (
        HEAD + "segments:\n  - {straight: 4.0, width: 0.4}\n",
        "0.40 m wide and the car 0.60 m",
        "widen",
    ),
    "an obstacle that blocks the way": (
        GOOD + "obstacles:\n  - {post: [3.0, 0.0], radius: 0.3}\n",
        "width:",
        "move the obstacle",
    ),
    "a low wall": (GOOD + "wall: {height_m: 0.5}\n", "wall.height_m", "0.8"),
    "an undeclared low obstacle": (
        GOOD + "obstacles:\n  - {box: [3, 0.5], size: [0.2, 0.2], height_m: 0.3}\n",
        "obstacles[0]",
        "low: true",
    ),
    "open space before the end": (HEAD + HALL, "open_line", "narrow the passage"),
    "an exit beside a wall": (
        GOOD + "obstacles:\n  - {box: [5.5, 1.2], size: [3, 0.2]}\n  - {box: [5.5, -1.2], size: [3, 0.2]}\n",
        "open_line",
        "away from the exit",
    ),
    "a blocked exit": (GOOD + "obstacles:\n  - {box: [4.6, -0.05], size: [0.2, 0.3]}\n", "open_line", "open the exit"),
    "an obstacle that touches itself": (
        GOOD + "obstacles:\n  - {polygon: [[3, 0.4], [3, 0.4], [3.2, 0.4], [3.2, 0.6]]}\n",
        "mesh",
        "not watertight; move a corner",
    ),
    "an unknown field": (GOOD + "colour: red\n", "colour", "remove it"),
    "a missing width": (HEAD + "segments:\n  - {straight: 4.0}\n", "segments[0].width", "add it"),
    "a negative length": (HEAD + "segments:\n  - {straight: -4.0, width: 1}\n", "segments[0].straight", "greater"),
    "a segment of no kind": (HEAD + "segments:\n  - {length: 4.0}\n", "segments[0]", "`straight` or `turn`"),
    "no geometry": (HEAD, "segments, free_space, mesh, map", "give exactly one"),
    "a radius under half the width": (
        GOOD + "  - {turn: 90, radius: 0.5, width: 1.5}\n  - {straight: 2.0, width: 1.5}\n",
        "segments[1].radius",
        "enlarge",
    ),
    "a straight shorter than its corners": (
        GOOD + "  - {turn: 90}\n  - {straight: 0.5, width: 1.5}\n",
        "segments[2].straight",
        "lengthen",
    ),
    "a sharp turn at the end": (GOOD + "  - {turn: 90}\n", "segments[1]", "add one"),
    "no mapping": ("- 1\n- 2\n", "list", "name:"),
    "no YAML": ("name: [\n", "not readable as YAML", "mend"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_bad_world_is_refused_with_file_field_and_remedy(case: str, tmp_path: Path) -> None:
    text, field, remedy = CASES[case]
    path = tmp_path / "bad.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(WorldError) as caught:
        load_world(path)
    message = str(caught.value)
    assert str(path) in message
    assert field in message
    assert remedy in message


def test_the_plain_track_that_the_bad_ones_vary_is_good(tmp_path: Path) -> None:
    path = tmp_path / "good.yaml"
    path.write_text(GOOD, encoding="utf-8")
    assert load_world(str(path)).name == "bad"


def test_an_unknown_name_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(AssetError, match="big_track"):
        load_world("no_such_track")


def test_a_start_in_python_that_is_no_number_is_refused_in_its_own_unit() -> None:
    with pytest.raises(WorldError, match="start: takes 3 numbers, x, y in m and yaw in rad, got"):
        load_world("track_2", start=(float("nan"), 0.0, 0.0))


@pytest.mark.parametrize(("start", "is_free"), [("at_m: 2.0", True), ("at_m: 0.2", False)])
def test_a_sketch_shows_where_the_car_would_be_free_only_if_it_is_not_where_it_starts(
    tmp_path: Path, start: str, is_free: bool
) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(GOOD + f"start: {{{start}}}\n", encoding="utf-8")
    draw_sketches([sketch_world(str(path))], tmp_path / "own.png", load_robot("zebrat").footprint_base)
    picture = np.asarray(Image.open(tmp_path / "own.png").convert("RGB")).reshape(-1, 3)
    violet = (np.abs(picture.astype(int) - (0x7A, 0x4F, 0xD0)) < 3).all(axis=1)
    assert violet.any() != is_free


def test_a_start_that_is_said_twice_is_noted_and_its_pose_taken(tmp_path):
    (tmp_path / "w.yaml").write_text(GOOD + "start: {pose: [1.5, 0, 0], at_m: 2}\n", encoding="utf-8")
    with pytest.warns(WorldNote, match="start: pose says where the car begins, so at_m says nothing"):
        assert load_world(tmp_path / "w.yaml").start.pose.x == 1.5
