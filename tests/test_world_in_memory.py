"""Worlds made in Python, and given to an environment as they are."""

import re
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import shapely

from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import WorldError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import Start, World, generate_tracks, load_world, load_worlds, validate

TRACK = load_world("track_2")
POSE = TRACK.start.pose
GATES = np.repeat(TRACK.waypoints[:1, None], 2, axis=1)[None]
BROKEN: dict[str, tuple[World, str]] = {
    "start far off": (replace(TRACK, start=Start(Pose2(100, 100, 0))), "start: at (100.00, 100.00) the car stands"),
    "start nan": (replace(TRACK, start=Start(Pose2(np.nan, 0, 0))), "start.pose: must be finite"),
    "range nan": (replace(TRACK, start=Start(POSE, np.nan)), "start: range_x_m, range_y_m and range_yaw_rad"),
    "range negative": (replace(TRACK, start=Start(POSE, 0.0, -1.0)), "must be finite, 0 or more, got (0.0, -1.0, 0.0)"),
    "five gates": (replace(TRACK, open_line=None, gates=np.repeat(GATES[0], 5, axis=0)), "with at most 4 gates"),
    "line turned round": (replace(TRACK, open_line=TRACK.open_line[::-1]), "swap its ends"),  # type: ignore[index]
    "line a point": (replace(TRACK, open_line=np.zeros((2, 2))), "open_line: must be two finite points that differ"),
    "walls without a mesh": (
        replace(TRACK, walls=shapely.MultiPolygon([*TRACK.walls.geoms, shapely.box(20, 20, 21, 21)])),
        "mesh: its outlines are not those of `walls`",
    ),
}


@pytest.mark.parametrize("make", [ZebratEnv, lambda world: PlanarVectorEnv(2, world)], ids=["bullet", "planar"])
@pytest.mark.parametrize("broken", BROKEN)
def test_a_world_that_cannot_be_driven_is_refused_before_anyone_drives(
    broken: str, make: Callable[[World], object]
) -> None:
    world, said = BROKEN[broken]
    with pytest.raises(WorldError, match="track_2: .*" + re.escape(said)):
        make(world)


def test_a_track_drawn_for_one_car_is_checked_for_another() -> None:
    tracks = list(generate_tracks(range(3)))
    assert load_worlds(tracks, robot=load_robot("zebrat")) == tracks
    with pytest.raises(WorldError, match=r"generated-2: open_line: open space .* is already seen"):
        PlanarVectorEnv(3, tracks, robot="long")


def test_a_world_is_checked_once_for_a_car_and_again_where_something_was_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    checked: list[str] = []
    monkeypatch.setattr(validate, "_check_start", lambda world, robot, source: checked.append(source))
    load_worlds([TRACK, *generate_tracks([5])])
    assert checked == ["generated-5"]  # as it was drawn
    load_worlds([replace(TRACK, description="edited")])
    assert checked == ["generated-5", "track_2"]
    load_worlds([TRACK], robot=load_robot("long"))
    assert checked == ["generated-5", "track_2", "track_2"]


@pytest.mark.parametrize("name", ["big_track", "track_5", "real_1"])
def test_a_shipped_world_of_which_a_word_was_replaced_is_as_good_as_before(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_worlds(replace(load_world(name), description="mine"))
