"""The encoder: scaling, raw values, mirroring, and what it refuses."""

import numpy as np
import pytest

from zebrat_bullet.errors import ActionError
from zebrat_bullet.task.observation import DISCRETE_COMMANDS, ObservationSpec
from zebrat_bullet.types import Clearance, Command, FlatScan, Reading

SPEC = ObservationSpec(n_rays=32, range_max_m=6.0, max_speed_mps=0.6, max_steering_rad=0.6)
RAW = ObservationSpec(n_rays=32, range_max_m=6.0, max_speed_mps=0.6, max_steering_rad=0.6, raw=True)


def reading(obs: np.ndarray, command: Command) -> Reading:
    clearance = Clearance(obs.astype(np.float32), np.zeros(32, np.float32), False)
    return Reading(FlatScan(np.zeros(360, np.float32), 6.0), clearance, command, 0.0, 0.0)


def test_ranges_scale_to_minus_one_and_one_and_the_command_to_its_limits():
    obs = np.linspace(0.0, 6.0, 32)
    encoded = SPEC.encode(reading(obs, Command(0.3, -0.6)))
    assert encoded.shape == (34,) and encoded.dtype == np.float32
    assert encoded[0] == -1.0 and encoded[31] == 1.0
    assert encoded[-2:] == pytest.approx([0.5, -1.0])


def test_raw_observations_are_the_papers_values():
    encoded = RAW.encode(reading(np.full(32, 2.5), Command(0.3, -0.6)))
    assert encoded[:32] == pytest.approx(2.5) and encoded[-2:] == pytest.approx([0.3, -0.6])


def test_actions_scale_and_clip():
    assert SPEC.decode([1.0, -0.5]) == Command(pytest.approx(0.6), pytest.approx(-0.3))
    assert SPEC.decode([7.0, -7.0]) == Command(pytest.approx(0.6), pytest.approx(-0.6))
    assert RAW.decode([0.3, 0.3]) == Command(pytest.approx(0.3), pytest.approx(0.3))


@pytest.mark.parametrize("action", [[np.nan, 0.0], [0.0, np.inf], [0.0], [0.0, 0.0, 0.0]])
def test_actions_that_are_not_two_finite_numbers_are_refused(action):
    with pytest.raises(ActionError, match="two finite numbers"):
        SPEC.decode(action)


def test_discrete_actions_are_the_papers_six():
    commands = {SPEC.decode_discrete(i) for i in range(len(DISCRETE_COMMANDS))}
    assert len(commands) == 6
    assert {round(c.speed_mps, 6) for c in commands} == {-0.6, 0.6}
    assert {round(c.steering_rad, 6) for c in commands} == {-0.6, 0.0, 0.6}
    with pytest.raises(ActionError, match=r"0\.\.5"):
        SPEC.decode_discrete(6)


def test_mirroring_keeps_ahead_and_back_swaps_left_and_right_and_undoes_itself():
    observation = np.arange(34, dtype=np.float32)
    mirrored = SPEC.mirror(observation)
    assert mirrored[0] == 0 and mirrored[16] == 16  # back, ahead
    assert mirrored[12] == 20 and mirrored[20] == 12  # right, left
    assert mirrored[32] == 32 and mirrored[33] == -33  # speed stays, steering turns round
    assert np.array_equal(SPEC.mirror(mirrored), observation)
