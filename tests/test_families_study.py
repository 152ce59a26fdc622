"""Policies judged on every family: what is counted, what is drawn, what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from zebrat_bullet.cli import main
from zebrat_bullet.config import EpisodeConfig, TaskConfig
from zebrat_bullet.errors import ConfigError, PolicyError
from zebrat_bullet.evaluation.endings import longest_way_back
from zebrat_bullet.evaluation.families import judge_families
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.planar.trial import drive_out
from zebrat_bullet.report.families import draw_families, families_table
from zebrat_bullet.world import load_world


def test_a_reversal_is_a_change_of_sign_however_long_the_car_stands_between() -> None:
    # By car: forward and back at every step; forward, standing, forward; back, standing, forward; always standing.
    speeds = np.array([[1, -1, 1, -1, 1, -1], [1, 0, 0, 1, 1, 1], [-1, 0, 0, 1, 1, 1], [0] * 6], dtype=np.float32)
    drive = PlanarDrive(TaskConfig(episode=EpisodeConfig(max_steps=6)), [load_world("track_2")], 4)
    steps = iter(speeds.T)
    where = np.zeros(4, dtype=np.int32)
    trial = drive_out(
        drive, lambda seen: np.stack([0.2 * next(steps), np.zeros(4, np.float32)], 1), where, drive.starts[0, :4]
    )
    assert trial.n_steps.tolist() == [6] * 4
    assert trial.n_reversals.tolist() == [5, 0, 1, 0]


def test_how_far_planar_cars_back_up_is_what_their_poses_say_to_the_end_of_their_episodes() -> None:
    """Cars go to and fro; one whose episode ends drives on in another, which does not count."""
    rng, n, most = np.random.default_rng(0), 32, 40
    task, world = TaskConfig(episode=EpisodeConfig(max_steps=most)), load_world("track_2")
    actions = rng.uniform([-1.0, -1.0], [1.0, 1.0], (most, n, 2)).astype(np.float32).cumsum(0).clip(-1.0, 1.0)
    where = np.zeros(n, dtype=np.int32)
    asked = iter(actions)
    drive = PlanarDrive(task, [world], n)
    starts = drive.starts[0, :n]
    trial = drive_out(drive, lambda seen: next(asked), where, starts)
    twin = PlanarDrive(task, [world], n)
    twin.begin_at(where, starts)
    poses = [twin.poses()]
    for i, action in enumerate(actions):
        step = twin.step(action)
        now = twin.poses()
        now[step.ended] = step.last_pose
        over = trial.n_steps <= i
        poses.append(np.where(over[:, None], poses[-1], now))
    ways = [longest_way_back(np.stack(poses)[:, car]) for car in range(n)]
    assert trial.backed_m == pytest.approx(ways, abs=1e-9)
    assert (trial.n_steps < most).sum() > 5 and max(ways) > 0.5 > min(ways)


def test_policies_are_judged_on_the_same_tracks_of_each_family(tmp_path: Path) -> None:
    scores = judge_families(["shipped", "il"], TaskConfig(), families=("corridors", "deadends"), tracks=3, starts=2)
    shipped = scores["shipped"]["corridors"]
    assert shipped.score.success == 1.0 and shipped.score.tracks == 3 and shipped.reversals == 0.0
    assert scores["il"]["deadends"].score.success < 0.5
    table = families_table(scores)
    assert table.splitlines()[2].startswith("| shipped | 100.0 / 100, 0.0 |")
    draw_families(scores, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 5000


def test_the_command_writes_table_figure_and_scores(tmp_path: Path) -> None:
    options = ["--agent", "shipped", "--families", "corners", "--tracks", "2", "--episodes", "1"]
    assert main(["families", *options, "--out", str(tmp_path)]) == 0
    score = json.loads((tmp_path / "families.json").read_text(encoding="utf-8"))["shipped"]["corners"]
    assert sum(score["causes"].values()) == 2 and "by_track" not in score
    assert {path.name for path in tmp_path.iterdir()} == {"families.json", "families.md", "families.png"}


def test_what_cannot_be_judged_is_refused_before_anything_drives() -> None:
    with pytest.raises(PolicyError, match="'oracle' is none"):
        judge_families(["oracle"], TaskConfig())
    with pytest.raises(ConfigError, match="no family of tracks 'corner'"):
        judge_families(["shipped"], TaskConfig(), families=("corner",))
    with pytest.raises(ConfigError, match="at least 1 track"):
        judge_families(["shipped"], TaskConfig(), tracks=0)
