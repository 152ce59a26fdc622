"""The encoder: scaling, raw values, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from zebrat_bullet.errors import ActionError, ConfigError
from zebrat_bullet.task.observation import DISCRETE_COMMANDS, ObservationSpec
from zebrat_bullet.types import Clearance, Command, FlatScan, Reading, Waypoint

SPEC = ObservationSpec(n_rays=32, range_max_m=6.0, max_speed_mps=0.6, max_steering_rad=0.6)
RAW = replace(SPEC, raw=True)
GUIDED = replace(SPEC, waypoint=True)
GUIDED_PAPER = replace(SPEC, waypoint=True, last_command=False)


def reading(obs: np.ndarray, command: Command, waypoint: Waypoint | None = None) -> Reading:
    clearance = Clearance(obs.astype(np.float32), np.zeros(32, np.float32), False)
    return Reading(FlatScan(np.zeros(360, np.float32), 6.0), clearance, command, 0.0, 0.0, waypoint=waypoint)


def test_ranges_scale_to_minus_one_and_one_and_the_command_to_its_limits():
    obs = np.linspace(0.0, 6.0, 32)
    encoded = SPEC.encode(reading(obs, Command(0.3, -0.6)))
    assert encoded.shape == (34,) and encoded.dtype == np.float32
    assert encoded[0] == -1.0 and encoded[31] == 1.0
    assert encoded[-2:] == pytest.approx([0.5, -1.0])


def test_raw_observations_are_the_papers_values():
    encoded = RAW.encode(reading(np.full(32, 2.5), Command(0.3, -0.6)))
    assert encoded[:32] == pytest.approx(2.5) and encoded[-2:] == pytest.approx([0.3, -0.6])


def test_the_waypoint_comes_last_its_distance_like_a_range_and_its_bearing_by_pi():
    seen = reading(np.full(32, 3.0), Command(0.3, -0.6), Waypoint(1.5, -np.pi / 4))
    assert GUIDED.encode(seen).tolist() == pytest.approx([0.0] * 32 + [0.5, -1.0, -0.5, -0.25])
    assert GUIDED_PAPER.encode(seen).tolist() == pytest.approx([0.0] * 32 + [-0.5, -0.25])
    in_si = replace(GUIDED, raw=True).encode(seen)
    assert in_si.tolist() == pytest.approx([3.0] * 32 + [0.3, -0.6, 1.5, -np.pi / 4])
    assert [spec.size for spec in (SPEC, GUIDED, GUIDED_PAPER)] == [34, 36, 34]


def test_a_waypoint_beyond_the_lidars_reach_is_at_its_reach():
    seen = reading(np.full(32, 3.0), Command(0.0, 0.0), Waypoint(9.0, 0.0))
    assert GUIDED.encode(seen)[-2] == 1.0 and replace(GUIDED, raw=True).encode(seen)[-2] == 6.0


@pytest.mark.parametrize("spec", [SPEC, GUIDED, GUIDED_PAPER], ids=["unguided", "wg", "wg_paper"])
@pytest.mark.parametrize("raw", [False, True], ids=["scaled", "raw"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_extremes_of_every_number_lie_on_the_bounds(spec, raw, sign):
    spec = replace(spec, raw=raw)
    far = sign > 0
    waypoint = Waypoint(99.0 if far else 0.0, sign * np.pi)
    encoded = spec.encode(reading(np.full(32, 6.0 * far), Command(sign * 0.6, sign * 0.6), waypoint))
    assert np.array_equal(encoded, spec.bounds[int(far)]) and spec.bounds.dtype == np.float32


def test_a_guided_observation_of_an_unguided_reading_is_refused():
    with pytest.raises(ConfigError, match="the reading names none; declare the privilege 'waypoint'"):
        GUIDED.encode(reading(np.full(32, 3.0), Command(0.0, 0.0)))


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
