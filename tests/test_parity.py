"""The planar car held against PyBullet: bounds a little above what `zebrat parity` measures."""

import json

import numpy as np
import pytest

from zebrat_bullet.agents.policy import load_policy
from zebrat_bullet.cli import main
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.parity.study import Parity, ParityStudy, measure

WORLDS = ("track_4", "real_1", "track_2")


@pytest.fixture(scope="module")
def parity() -> Parity:
    return measure(ParityStudy(worlds=WORLDS, drives=8, poses=60, episodes=4, workers=2, task=TaskConfig()))


def test_the_same_commands_move_both_cars_alike(parity):
    for driver, median_mm, p95_mm in (("random", 2.0, 8.0), ("smooth", 1.6, 4.5), ("policy", 4.0, 22.0)):
        row = parity.driver_row(driver)
        assert row["drives_1s"] >= 10
        assert row["apart_1s_median_mm"] < median_mm and row["apart_1s_p95_mm"] < p95_mm, row


def test_both_see_the_same_from_the_same_pose(parity):
    row = parity.row()
    assert row["rays"] > 20_000
    assert row["rays_differing"] <= 1e-4 * row["rays"], row
    assert row["rays_median_mm"] < 0.001 and row["rolling_rays_p95_mm"] < 0.5


def test_both_touch_a_wall_where_the_polygons_do(parity):
    row = parity.row()
    assert 0.3 < row["poses_touching"] / row["poses"] < 0.7
    assert row["planar_wrong_clear"] == row["bullet_wrong_clear"] == 0, row


def test_episodes_of_a_policy_end_alike(parity):
    row = parity.row()
    assert row["episodes"] == 12
    assert row["episodes_alike"] >= 11, parity.episodes
    assert row["duration_apart_median_s"] < 1.0


def test_a_policy_acts_on_many_observations_as_on_each():
    policy = load_policy("shipped")
    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (100, policy.observation.size)).astype(np.float32)
    each = np.array([policy.action(observation) for observation in observations])
    assert each.shape == (100, 2)
    assert policy.action(observations) == pytest.approx(each, abs=1e-5)


def test_only_an_unguided_policy_drives_planar_cars():
    with pytest.raises(ConfigError, match="unguided policy, 'random' is none"):
        measure(ParityStudy(worlds=("track_2",), agent="random", task=TaskConfig()))


def test_the_command_leaves_tables_and_a_figure(tmp_path, capfd):
    few = ("--drives", "1", "--poses", "5", "--episodes", "1", "--workers", "1")
    assert main(["parity", "--worlds", "track_2", *few, "--out", str(tmp_path), "--json", "--quiet"]) == 0
    answer = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert answer["all"]["episodes"] == answer["worlds"]["track_2"]["episodes"] == 1
    assert (tmp_path / "parity.png").stat().st_size > 10_000
    assert (tmp_path / "table.md").read_text(encoding="utf-8").count("| track_2 |") == 1
    assert len((tmp_path / "worlds.csv").read_text(encoding="utf-8").splitlines()) == 3
