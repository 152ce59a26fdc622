"""Generated tracks are valid, reproducible and as long as asked."""

import numpy as np
import pytest

from zebrat_bullet.errors import WorldError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import generate_track, world_summary
from zebrat_bullet.world.validate import validate_world

ROBOT = load_robot("zebrat")


def test_generated_tracks_are_valid_and_of_the_length_asked_for() -> None:
    rng = np.random.default_rng(0)
    for _ in range(15):
        world = generate_track(rng, robot=ROBOT)
        validate_world(world, ROBOT, "generated")
        # The centre line begins 1.5 m from the closed end and runs 1 m past the open-space line.
        course = np.hypot(*np.diff(world.centre_line, axis=0).T).sum() + 0.5
        assert 6.0 <= course <= 15.0
        assert world.widths_m.min() >= 0.99 and world.widths_m.max() <= 2.0
        assert len(world.turns_deg) >= 1


def test_the_same_random_state_gives_the_same_track() -> None:
    first, again = (generate_track(np.random.default_rng(7), robot=ROBOT) for _ in range(2))
    other = generate_track(np.random.default_rng(8), robot=ROBOT)
    assert np.array_equal(first.mesh.vertices, again.mesh.vertices)
    assert np.array_equal(first.centre_line, again.centre_line) and first.start == again.start
    assert not np.array_equal(first.centre_line, other.centre_line)


def test_tight_corners_and_u_turns_come_often() -> None:
    rng = np.random.default_rng(3)
    turns = [
        turn for _ in range(30) for turn in world_summary(generate_track(rng, tightness=1.0, robot=ROBOT))["turns_deg"]
    ]
    assert {abs(turn) for turn in turns} == {90, 180}
    assert 0.1 < np.mean([abs(turn) == 180 for turn in turns]) < 0.5
    assert 0.3 < np.mean([turn > 0 for turn in turns]) < 0.7


def test_a_length_that_no_track_can_have_is_refused() -> None:
    with pytest.raises(WorldError, match="length_m"):
        generate_track(np.random.default_rng(0), length_m=(1.0, 1.5), robot=ROBOT)
