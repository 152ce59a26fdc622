"""The reward terms against numbers worked out by hand from the paper's equations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from zebrat_bullet.config import REWARD_PRESETS, RewardConfig, SafetyRegionConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.safety_region import SafetyRegion, make_region
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.rewards import TERMS, RewardInput, weighted_terms
from zebrat_bullet.types import Commands
from zebrat_bullet.world import load_world

SUM_6 = sum(0.9**k for k in range(6))
SUM_13 = sum(0.9**k for k in range(13))


@pytest.fixture(scope="module")
def region() -> SafetyRegion:
    return make_region(load_robot(), SafetyRegionConfig(), 360)


def step(region: SafetyRegion, obs: np.ndarray, speed: float = 0.0, **settings: object) -> RewardInput:
    """Return what the terms look at for one car."""
    clearance = region.clearances(obs.astype(np.float32)[None])
    none = np.zeros(1)
    return RewardInput(clearance, region, np.array([speed]), Commands(none, none), RewardConfig(**settings), none)


def test_forward_term_counts_both_sides_of_ahead_with_measured_speed(region):
    terms = weighted_terms(step(region, np.full(32, 2.0), speed=0.5))
    assert terms["F"] == pytest.approx(0.5 * 4.0 * SUM_6, rel=1e-6)


def test_forward_term_looks_ahead_and_not_behind(region):
    obs = np.zeros(32)
    obs[region.back] = 6.0
    assert weighted_terms(step(region, obs, speed=0.5))["F"] == 0.0
    obs[region.front] = 3.0
    assert weighted_terms(step(region, obs, speed=0.5))["F"] == pytest.approx(0.5 * 6.0)


def test_reversing_is_paid_negatively(region):
    assert weighted_terms(step(region, np.full(32, 2.0), speed=-0.5))["F"] < 0.0


def test_obstacle_term_is_base_10_over_the_13_smallest_gaps(region):
    obs = region.range_m + 0.1
    assert weighted_terms(step(region, obs))["O"] == pytest.approx(-SUM_13, rel=1e-4)
    natural = weighted_terms(step(region, obs, log_base=math.e))["O"]
    assert natural == pytest.approx(-SUM_13 * math.log(10.0), rel=1e-4)


def test_obstacle_term_weights_the_smallest_gap_most(region):
    obs = region.range_m + 1.0  # log10(1) = 0
    obs[5] = region.range_m[5] + 0.01
    assert weighted_terms(step(region, obs))["O"] == pytest.approx(-2.0, rel=1e-3)


def test_obstacle_term_stays_finite_inside_the_outline(region):
    assert weighted_terms(step(region, np.zeros(32)))["O"] == pytest.approx(-3.0 * SUM_13)


def test_middle_term_is_zero_when_both_sides_are_the_same_and_runs_backwards(region):
    obs = np.full(32, 1.0)
    assert weighted_terms(step(region, obs))["M"] == 0.0
    obs[region.right - 1] = 3.0  # one bearing behind abeam
    assert weighted_terms(step(region, obs))["M"] == pytest.approx(-0.9 * 2.0)
    obs = np.full(32, 1.0)
    obs[region.left + 2] = 3.0  # two behind abeam on the other side
    assert weighted_terms(step(region, obs))["M"] == pytest.approx(-0.81 * 2.0)
    obs = np.full(32, 1.0)
    obs[region.right + 1] = 3.0  # ahead of abeam: not looked at
    assert weighted_terms(step(region, obs))["M"] == 0.0


def test_presets_are_ablations(region):
    obs = region.range_m + np.linspace(0.1, 1.0, 32)
    full = weighted_terms(step(region, obs, speed=0.3))
    without_m = weighted_terms(step(region, obs, speed=0.3, weights=REWARD_PRESETS["fot"].weights))
    assert without_m["M"] == 0.0 and without_m["F"] == full["F"] and without_m["O"] == full["O"]
    ft = weighted_terms(step(region, obs, speed=0.3, weights=REWARD_PRESETS["ft"].weights))
    assert ft["O"] == 0.0 and ft["T"] == -1.0


def test_an_unknown_term_is_refused_with_the_valid_ones():
    with pytest.raises(ConfigError, match=r"unknown reward term 'X'; valid terms are: F, O, M, T, W"):
        Drive(TaskConfig(reward=RewardConfig(weights={"X": 1.0})), load_world("track_1"))


@pytest.mark.parametrize(
    ("term", "said"),
    [
        (lambda step: -1.0, "reward term 'S' returned a float; a term returns one number a car"),
        (lambda step: step.speed_mps.mean(), r"returned a float64 of shape \(\)"),
        (lambda step: step.speed_mps[:, None], r"a ndarray of shape \(1, 1\) .* here an array of shape \(1,\)"),
        (lambda step: np.zeros(5), r"returned a ndarray of shape \(5,\)"),
        (lambda step: None, "returned a NoneType"),
        (lambda step: np.array(["a"]), "returned a ndarray of shape .* type <U1"),
        (lambda step: np.array([1j]), "type complex128"),
        (lambda step: [0.0], "returned a list"),
        (lambda step: step.speed_mps * math.nan, "reward term 'S' is nan for car 0; a term returns one finite number"),
        (lambda step: step.speed_mps + math.inf, "reward term 'S' is inf for car 0"),
        (
            lambda step: step.speeds,
            "reward term 'S' fails: AttributeError: .*'speeds'; it is a function of a RewardInput",
        ),
        (3, "reward term 'S' fails: TypeError: 'int' object is not callable"),
    ],
)
def test_a_term_that_is_not_one_finite_number_a_car_is_refused_by_its_name(region, monkeypatch, term, said):
    monkeypatch.setitem(TERMS, "S", term)
    with pytest.raises(ConfigError, match=said):
        weighted_terms(step(region, np.full(32, 2.0), weights={"F": 1.0, "S": 0.5}))


def test_a_term_cannot_change_what_it_sees(region, monkeypatch):
    seen = step(region, np.full(32, 2.0), speed=0.5, weights={"S": 1.0})
    for write in (
        lambda step: step.clearance.obs_m,
        lambda step: step.clearance.range_m,
        lambda step: step.speed_mps,
        lambda step: step.command.steering_rad,
        lambda step: step.nearer_m,
    ):

        def term(step, write=write):
            write(step)[...] = 9.0
            return step.speed_mps

        monkeypatch.setitem(TERMS, "S", term)
        with pytest.raises(ConfigError, match="'S' writes to what it sees"):
            weighted_terms(seen)
    assert seen.speed_mps == 0.5 and (seen.clearance.obs_m == 2.0).all()


def test_a_term_is_paid_in_the_precision_of_the_cars(region, monkeypatch):
    monkeypatch.setitem(TERMS, "S", lambda step: np.array([1]))
    seen = step(region, np.full(32, 2.0), weights={"S": 1})
    assert weighted_terms(replace(seen, speed_mps=np.zeros(1, np.float32)))["S"].dtype == np.float32
