"""Figures and tables of training runs: from run folders alone, of every version, and honest about what is missing."""

import csv
import json
import math
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from zebrat_bullet.cli import main
from zebrat_bullet.config import EpisodeConfig, LidarConfig, TaskConfig, with_reward
from zebrat_bullet.config_text import to_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.report.learning import learning_table, write_report
from zebrat_bullet.report.learning_curves import at_grid, progress, training_curve
from zebrat_bullet.report.learning_figures import draw_curves
from zebrat_bullet.report.learning_runs import read_groups, reward_name
from zebrat_bullet.report.learning_stats import estimates, iqm, reward_trap, summarise_group, summarise_run
from zebrat_bullet.training.learner_settings import DDPGConfig
from zebrat_bullet.training.logs import EPISODE_COLUMNS, EVALUATION_COLUMNS
from zebrat_bullet.training.presets import TRAIN_PRESETS, paper_config
from zebrat_bullet.training.run import train
from zebrat_bullet.training.run_folder import summarise
from zebrat_bullet.training.settings import TrainConfig

RESULTS = Path(__file__).parent.parent / "docs" / "results"
TINY = TrainConfig(
    learner=DDPGConfig(hidden=(16, 16), batch_size=16, buffer_size=2000, warmup_steps=20),
    worlds=("track_2",),
    episodes=22,
    eval_every=11,
    eval_episodes=1,
    checkpoint_every=22,
    task=TaskConfig(lidar=LidarConfig(caster="embree", n_channels=4), episode=EpisodeConfig(max_steps=25)),
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Two seeds under one reward, and one under another."""
    folder = tmp_path_factory.mktemp("runs")
    for seed in (0, 1):
        train(replace(TINY, seed=seed), folder / f"fomt-seed{seed}")
    train(replace(TINY, task=with_reward(TINY.task, "ft")), folder / "ft-seed0")
    return folder


def write_run(folder, episodes, evaluations=(), base=None, **changes):
    """Leave the folder of a run with (outcome, return) episodes of 10 steps and 1 s, and (episode, success, best)."""
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(
        to_json(replace(base or paper_config("ddpg", "fomt"), **changes)), encoding="utf-8"
    )
    log, judged = (
        CsvLog(folder / "episodes.csv", EPISODE_COLUMNS),
        CsvLog(folder / "evaluations.csv", EVALUATION_COLUMNS),
    )
    for n, (outcome, earned) in enumerate(episodes, start=1):
        log.append(
            {"episode": n, "total_steps": 10 * n, "wall_s": n, "outcome": outcome, "return": earned, "steps": 10}
        )
    for n, success, best in evaluations:
        row = {
            "episode": n,
            "total_steps": 10 * n,
            "wall_s": n,
            "success": success,
            "collision": 1 - success,
            "fail": 0,
        }
        judged.append(row | {"time_s": 20.0 if success else None, "best": best})


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_report_holds_every_figure_its_data_and_the_table(trained, tmp_path):
    summaries, text = write_report([trained], tmp_path)
    for name in ("training_curve", "per_step", "per_hour", "reached"):
        assert matplotlib.image.imread(tmp_path / f"{name}.png").std() > 0.01
        assert rows_of(tmp_path / f"{name}.csv")
    assert json.loads((tmp_path / "learning.json").read_text(encoding="utf-8")) == summaries
    assert [(at["algo"], at["reward"], len(at["runs"])) for at in summaries] == [("ddpg", "fomt", 2), ("ddpg", "ft", 1)]
    assert "| ddpg | fomt | 2 | 22 ± 0 |" in text and "unfinished" not in text


def test_the_table_says_what_each_run_says_of_itself(trained):
    for group in read_groups([trained]):
        for run in group.runs:
            ours, its = summarise_run(run), summarise(run.folder)
            assert ours["finished"] and ours["steps"] == its["total_steps"] and ours["episodes"] == its["episodes"]
            assert {name: its["best"][name] for name in ("episode", "success", "time_s")} == ours["best_policy"]
            assert ours["wall_s"] == its["wall_s"]


def test_different_rewards_share_no_panel(trained, tmp_path):
    widths = []
    for folder in (trained / "fomt-seed0", trained):
        draw_curves(training_curve(read_groups([folder])), "episode", tmp_path / "curve.png")
        widths.append(matplotlib.image.imread(tmp_path / "curve.png").shape[1])
    assert widths[1] > 1.4 * widths[0]


def test_runs_of_older_versions_are_read():
    (group,) = read_groups([RESULTS / "paper-finetuning.zip"])
    settings = json.loads(
        zipfile.ZipFile(RESULTS / "paper-finetuning.zip").read(f"{group.runs[0].folder.name}/config.json")
    )
    assert settings["learner"]["hold_steps"] == 1 and not hasattr(DDPGConfig(), "hold_steps")
    assert [run.seed for run in group.runs] == [0, 1, 2, 3, 4] and all(run.finished for run in group.runs)
    assert summarise_group(group)["best_success"]["mean"] == 1.0


def test_an_archive_is_read_as_the_folder_that_it_was_made_of(trained, tmp_path):
    archive = Path(shutil.make_archive(str(tmp_path / "runs"), "zip", trained))
    plain, packed = (read_groups([place]) for place in (trained, archive))
    assert [run.folder for group in packed for run in group.runs] == [
        archive / run.folder.relative_to(trained) for group in plain for run in group.runs
    ]
    for one, two in zip(plain, packed, strict=True):
        assert all(
            np.array_equal(ours.episodes["return"], its.episodes["return"]) and ours.finished == its.finished
            for ours, its in zip(one.runs, two.runs, strict=True)
        )


@pytest.mark.parametrize("name", ["../outside/config.json", "/outside/config.json"])
def test_an_archive_that_reaches_out_of_itself_is_refused(name, tmp_path):
    with zipfile.ZipFile(tmp_path / "runs.zip", "w") as archive:
        archive.writestr("run/config.json", "{}")
        archive.writestr(name, "{}")
    with pytest.raises(ConfigError, match="lies outside the archive; nothing was unpacked"):
        read_groups([tmp_path / "runs.zip"])
    assert not (tmp_path.parent / "outside").exists()


def test_a_file_that_is_no_archive_is_refused(tmp_path):
    (tmp_path / "runs.zip").write_text("nothing", encoding="utf-8")
    with pytest.raises(ConfigError, match="no whole zip archive"):
        read_groups([tmp_path / "runs.zip"])


def test_settings_that_differ_name_the_group_and_those_that_change_nothing_do_not_split_it(tmp_path):
    rows = [("collision", -50.0)]
    for seed, changes in enumerate(({"threads": 2}, {"init": "a/best.zip"}, {"init": "b/best.zip"}, {})):
        write_run(tmp_path / f"seed{seed}", rows, seed=seed, **changes)
    assert [(g.variant, [run.seed for run in g.runs]) for g in read_groups([tmp_path])] == [
        ("init=False", [0, 3]),
        ("init=True", [1, 2]),
    ]


def test_groups_that_differ_much_and_share_their_names_are_named_by_where_they_lie():
    names = ("algorithms.zip", "float32.zip", "paper-finetuning.zip")
    groups = [group for group in read_groups([RESULTS / name for name in names]) if group.algo == "ddpg"]
    where = [f"{name}/ddpg-fomt-big_track-seed0" for name in names]
    # Seeds 3 and 4 of the algorithms are runs of an older version, whose settings had other names.
    assert sorted(group.variant for group in groups) == sorted([*where, f"{names[0]}/ddpg-fomt-big_track-seed3"])


def test_a_reward_is_named_by_its_preset_or_by_its_weights():
    def named(task):
        return reward_name(json.loads(to_json(task)))

    plain = TaskConfig()
    assert [named(with_reward(plain, name)) for name in ("fomt", "ft", "wg", "wg_paper")] == [
        "fomt",
        "ft",
        "wg",
        "wg_paper",
    ]
    assert named(replace(plain, reward=replace(plain.reward, log_base=math.e))) == "fomt log_base=2.71828"
    assert named(replace(plain, reward=replace(plain.reward, weights={"T": 1, "F": 0.5, "O": 0}))) == "0.5F+1T"


def test_the_papers_curve_is_the_best_of_every_complete_block_of_20_episodes(tmp_path):
    returns = np.random.default_rng(0).normal(size=1110).tolist()
    write_run(tmp_path / "run", [("collision", earned) for earned in returns])
    (curve,) = training_curve(read_groups([tmp_path]))
    assert len(curve.band.x) == 55 and (curve.band.x[0], curve.band.x[-1]) == (20, 1100)
    assert curve.band.mean[3] == max(returns[60:80]) and curve.band.mean[-1] == max(returns[1080:1100])


def test_a_value_between_two_rows_is_the_earlier_one_and_there_is_none_before_or_after():
    grid = np.array([0.0, 9.9, 10.0, 15.0, 19.9, 20.0, 25.0, 26.0])
    values = at_grid(np.array([10.0, 20.0]), np.array([0.2, 0.8]), grid, end=25.0)
    assert values == pytest.approx([math.nan, math.nan, 0.2, 0.2, 0.2, 0.8, 0.8, math.nan], nan_ok=True)
    assert np.isnan(at_grid(np.array([]), np.array([]), grid, end=25.0)).all()


def test_where_a_seed_has_ended_there_is_no_spread_and_the_mean_says_of_how_many(tmp_path):
    write_run(tmp_path / "seed0", [("collision", -50.0)] * 40, seed=0)
    write_run(tmp_path / "seed1", [("collision", -30.0)] * 20, seed=1)
    groups = read_groups([tmp_path])
    (curve,) = training_curve(groups)
    assert curve.band.n_seeds.tolist() == [2, 1] and curve.band.mean.tolist() == [-40.0, -50.0]
    assert curve.band.std[0] == pytest.approx(math.sqrt(200)) and math.isnan(curve.band.std[1])
    assert (curve.band.low[0], curve.band.high[0]) == (-50.0, -30.0) and math.isnan(curve.band.low[1])
    over_steps = progress(groups, "steps")[2].band
    assert over_steps.n_seeds[over_steps.x > 200].max() == 1 and over_steps.n_seeds[over_steps.x == 200] == 2


def test_over_hours_a_curve_ends_with_the_run(trained):
    curves = progress(read_groups([trained]), "hours")
    longest = max(summarise(path)["wall_s"] for path in trained.iterdir()) / 3600
    assert curves[0].band.x[-1] == pytest.approx(longest)
    success = [curve for curve in curves if "success" in curve.measure]
    assert all(np.nanmin(at.band.mean) >= 0 and np.nanmax(at.band.mean) <= 1 for at in success)


def test_the_interquartile_mean_leaves_out_a_quarter_at_either_end():
    assert iqm(np.array([100.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -100.0])) == 3.5
    assert iqm(np.array([0.0, 0.5, 1.0])) == 0.5  # too few to leave any out


def test_intervals_are_those_worked_out_by_hand():
    # Of five draws from one 0 and four 1, the count of zeros is binomial (5, 0.2); its IQM is 1, 1, 2/3, 1/3, 0, 0, its
    # mean 1 - k/5. P(k >= 4) = 0.0067 < 0.025 < P(k >= 3) = 0.058: the 2.5 % quantile is at k = 3; k = 0 has 0.33.
    at = estimates([0.0, 1.0, 1.0, 1.0, 1.0])
    assert at["iqm"] == 1.0 and at["iqm_ci"] == pytest.approx([1 / 3, 1.0])
    assert at["mean"] == 0.8 and at["mean_ci"] == pytest.approx([0.4, 1.0])
    assert at["sd"] == pytest.approx(math.sqrt(0.2))
    assert estimates([0.7] * 5)["iqm_ci"] == pytest.approx([0.7, 0.7])
    assert estimates([0.7])["iqm_ci"] is None and estimates([])["mean"] is None


def test_the_trap_counts_cars_that_were_paid_for_staying_inside(tmp_path):
    paid = [("success", 60.0), ("success", 100.0), ("timeout", 90.0), ("stall", 70.0), ("false_exit", 55.0)]
    write_run(tmp_path / "seed0", [*paid, ("collision", -50.0)], seed=0)
    write_run(tmp_path / "seed1", [("success", 80.0), ("timeout", 40.0)], seed=1)
    (group,) = read_groups([tmp_path])
    trap = reward_trap(group.runs, group.exit_reward)
    assert (trap["episodes"], trap["median_success"]) == (5, 80.0)
    assert (trap["above_median_success"], trap["above_exit_reward"]) == (1, 3)
    assert trap["largest"] == {"return": 90.0, "outcome": "timeout", "steps": 10, "seed": 0, "episode": 3}
    assert "| 3 / 1 of 5 | +90, timeout after 10 steps |" in learning_table([summarise_group(group)])


def test_the_trap_was_real_in_runs_of_ours():
    (sac,) = [group for group in read_groups([RESULTS / "algorithms.zip"]) if group.algo == "sac"]
    trap = reward_trap(sac.runs, sac.exit_reward)
    assert (trap["above_exit_reward"], trap["episodes"]) == (4386, 5000)
    assert trap["largest"]["outcome"] == "collision" and trap["largest"]["return"] > 500


def test_a_run_without_success_an_evaluation_or_even_an_episode_is_shown_without_a_nan(tmp_path):
    write_run(tmp_path / "runs" / "seed0", [("collision", -50.0)] * 25, [(20, 0.0, 1)], seed=0)
    write_run(tmp_path / "runs" / "seed1", [], seed=1)
    (summary,), text = write_report([tmp_path / "runs"], tmp_path / "out")
    json.dumps(summary, allow_nan=False)
    assert "nan" not in text.lower() and "0 / no success of 25" in text
    assert "- seed1: unfinished, 0 of 1,000 episodes" in text and "0 of 2" in text
    assert not any(
        "nan" in (tmp_path / "out" / f"{name}.csv").read_text(encoding="utf-8") for name in ("per_step", "reached")
    )


def test_a_run_on_planar_cars_is_finished_by_its_summary_alone_and_its_length_is_in_steps(tmp_path):
    """Its log holds the episodes of four cars: more than `episodes` of them say nothing."""
    general = TRAIN_PRESETS["general"]
    for seed, done in ((0, False), (1, True)):
        run = tmp_path / "runs" / f"seed{seed}"
        judged = [(1100 + seed, 0.5, 1)]
        write_run(run, [("success", 50.0)] * 1100, judged, base=replace(general, steps=20_000), seed=seed)
        if done:
            (run / "summary.json").write_text("{}", encoding="utf-8")
    (summary,), text = write_report([tmp_path / "runs"], tmp_path / "out")
    assert "- seed0: unfinished, 11,000 of 20,000 steps" in text and "seed1: unfinished" not in text
    assert summary["unfinished"] == 1
    # The last evaluation may lie behind the last episode of those four.
    assert [run["steps"] for run in summary["runs"]] == [11_000, 11_010]


def test_a_run_under_way_is_read_up_to_its_last_whole_row(trained, tmp_path):
    folder = shutil.copytree(trained / "fomt-seed0", tmp_path / "run")
    (folder / "summary.json").unlink()
    with (folder / "episodes.csv").open() as file:
        text = file.read()
    (folder / "episodes.csv").write_text(text[: text.rindex(",", 0, text.rindex(","))], encoding="utf-8")
    (group,) = read_groups([folder])
    assert len(group.runs[0].episodes["return"]) == 21 and not group.runs[0].finished


def test_folders_that_cannot_be_told_apart_or_hold_no_run_are_refused(trained, tmp_path):
    with pytest.raises(ConfigError, match=r"no training run in .*config\.json and episodes\.csv"):
        read_groups([tmp_path])
    assert len(read_groups([trained, trained / "ft-seed0"])) == 2  # named twice, read once
    shutil.copytree(trained / "ft-seed0", tmp_path / "copy")
    with pytest.raises(ConfigError, match="are the same run, seed 0; name one of them"):
        read_groups([trained, tmp_path])
    (tmp_path / "copy" / "config.json").write_text("{}", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"copy/config\.json: is not the settings of a training run"):
        read_groups([tmp_path])


def test_the_command_prints_the_table_or_one_line_of_json(trained, tmp_path, capfd):
    assert main(["curves", str(trained / "ft-seed0"), "--out", str(tmp_path), "--json"]) == 0
    result = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert result["folder"] == str(tmp_path) and result["groups"][0]["reward"] == "ft"
    assert main(["curves", str(tmp_path / "nothing")]) == 2
    assert "no training run in" in capfd.readouterr().err
