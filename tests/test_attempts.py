"""A run of several attempts: side by side, ended by the first that is good enough, and one run to whoever reads it."""

import os
from dataclasses import replace

import pytest
from test_training import TINY

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import to_json
from zebrat_bullet.errors import ZebratError
from zebrat_bullet.report.learning_runs import read_groups
from zebrat_bullet.training.logs import EPISODE_COLUMNS, EVALUATION_COLUMNS, CsvLog
from zebrat_bullet.training.run import resume, train
from zebrat_bullet.training.run_folder import is_finished, summarise

CONFIG = replace(TINY, attempts=3, episodes=6)


def rows(run, name="episodes"):
    columns = EPISODE_COLUMNS if name == "episodes" else EVALUATION_COLUMNS
    return CsvLog(run / f"{name}.csv", columns).rows()


def test_all_attempts_together_are_one_run(tmp_path):
    run = tmp_path / "run"
    train(CONFIG, run)
    attempts = sorted((run / "attempts").iterdir())
    assert [attempt.name for attempt in attempts] == ["00", "01", "02"] and all(map(is_finished, attempts))
    assert summarise(run)["episodes"] == 18 and [int(row["episode"]) for row in rows(run)] == list(range(1, 19))
    steps = [int(row["total_steps"]) for row in rows(run)]
    assert steps == sorted(steps)
    assert steps[-1] == sum(int(rows(attempt)[-1]["total_steps"]) for attempt in attempts)
    walls = [float(row["wall_s"]) for row in rows(run)]
    assert walls == sorted(walls)
    best = max(attempts, key=lambda attempt: max(float(row["success"]) for row in rows(attempt, "evaluations")))
    assert float(summarise(run)["best"]["success"]) == float(summarise(best)["best"]["success"])
    assert any(
        (run / "best.safetensors").read_bytes() == (attempt / "best.safetensors").read_bytes() for attempt in attempts
    )
    assert load_agent(str(run), CONFIG.task)
    (group,) = read_groups([tmp_path])
    assert [len(found.episodes["episode"]) for found in group.runs] == [18] and group.runs[0].finished


def test_the_seeds_of_the_attempts_differ_and_come_from_that_of_the_run(tmp_path):
    for name, seed in (("one", 0), ("same", 0), ("other", 1)):
        train(replace(CONFIG, seed=seed, attempts=2, episodes=2, eval_every=2), tmp_path / name)
    policies = {
        name: [(tmp_path / name / "attempts" / at / "last.safetensors").read_bytes()[-2000:] for at in ("00", "01")]
        for name in ("one", "same", "other")
    }
    assert policies["one"] == policies["same"]
    assert len({*policies["one"], *policies["other"]}) == 4


def test_the_first_that_is_good_enough_ends_the_run(tmp_path):
    n = len(os.sched_getaffinity(0)) + 30
    train(replace(CONFIG, attempts=n, stop_at=0.0), tmp_path / "run")
    assert is_finished(tmp_path / "run") and len(list((tmp_path / "run" / "attempts").iterdir())) < n


def test_the_clock_is_that_of_the_whole_run(tmp_path):
    with pytest.raises(ZebratError, match="raise max_minutes"):
        train(replace(CONFIG, max_minutes=0.001), tmp_path / "run")


def test_a_killed_run_keeps_the_attempts_that_had_ended(tmp_path):
    run = tmp_path / "run"
    train(replace(CONFIG, attempts=1), run / "attempts" / "01")
    ended = (run / "attempts" / "01" / "episodes.csv").read_bytes()
    (run / "config.json").write_text(to_json(CONFIG))
    resume(run)
    assert is_finished(run) and len(rows(run)) == 18
    assert (run / "attempts" / "01" / "episodes.csv").read_bytes() == ended


def test_an_attempt_that_fails_says_why(tmp_path):
    config = replace(CONFIG, init=str(tmp_path / "nowhere.zip"))
    with pytest.raises(ZebratError, match="nowhere"):
        train(config, tmp_path / "run")
