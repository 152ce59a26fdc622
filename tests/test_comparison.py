"""The comparison: one manifest, resumed after a kill at any point, the same tables from the same outputs."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from zebrat_bullet.cli.main import main
from zebrat_bullet.comparison.cells import cells
from zebrat_bullet.comparison.estimate import forecast
from zebrat_bullet.comparison.gather import gather
from zebrat_bullet.comparison.manifest import SHIPPED, read_manifest
from zebrat_bullet.comparison.policies import Place, best_model, best_policy, best_run
from zebrat_bullet.comparison.steps import Judge, Step, Train, steps
from zebrat_bullet.comparison.tables import COLUMNS, read_tables, table_of, write_tables
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.csv_log import read_rows
from zebrat_bullet.evaluation.endings import count_reversals, longest_way_back
from zebrat_bullet.evaluation.set_episodes import SCHEMA
from zebrat_bullet.evaluation.track_set import read_set
from zebrat_bullet.report.comparison.settings import asked_runs
from zebrat_bullet.training.archive import as_folder
from zebrat_bullet.training.run_folder import has_checkpoint, is_finished

ROOT = Path(__file__).parent.parent
TRACKS = ["big_track", *(f"track_{i}" for i in range(1, 9))]
TINY = """
trainings:
  short:
    study: paper
    asked: 8 episodes
    rewards: [ft]
    set: [episodes=8, 'learner.hidden=[16,16]', learner.batch_size=16, learner.buffer_size=2000, eval_every=4,
          eval_episodes=1, checkpoint_every=1, task.lidar.n_channels=4, task.episode.max_steps=40]
judgements:
  learned: {trainings: [short], worlds: [track_2], episodes: 2, options: [--caster, embree]}
  random:
    {drivers: [{method: random, agent: random}], worlds: [track_2], episodes: 12, options: [--caster, embree]}
  held-out:
    {drivers: [{method: ours, agent: shipped}], sets: [reversals-5], tracks: 3, sim: planar, episodes: 2}
budgets:
  all:
    about: all of it
    seeds: [0]
    trainings: {short: []}
    judgements: {learned: {}, random: {}, held-out: {}}
  more:
    about: what the other leaves out
    seeds: [0, 1]
    trainings: {short: []}
    judgements: {learned: {}, random: {}, held-out: {}}
"""
LOST = """class Lost:
    name, privileged = "lost", frozenset()
    act, reset = lambda self, reading: 1 / 0, lambda self, seed: None

    def __init__(self, task):
        pass
"""
SPEED = {"train ddpg, PyBullet": 50.0, "a policy": 1.0, "random": 0.5, "start": 4.0, "a set": 10.0}


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    (tmp_path / "manifest.yaml").write_text(TINY, encoding="utf-8")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "speed.json").write_text(json.dumps(SPEED), encoding="utf-8")  # measured before, so not again
    return tmp_path


def place(folder: Path, budget: str = "all") -> Place:
    manifest = read_manifest(folder / "manifest.yaml")
    return Place(manifest=manifest, budget=budget, out=folder / "out", checkout=ROOT)


def reproduce(folder: Path, *options: str) -> subprocess.Popen[str]:
    code = "import sys; from zebrat_bullet.cli import main; sys.exit(main())"
    call = ["reproduce", "--manifest", folder / "manifest.yaml", "--budget", "all", "--out", folder / "out", "--json"]
    command = [sys.executable, "-c", code, *map(str, call), *options]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def kill_when(process: subprocess.Popen[str], reached: Callable[[], bool]) -> None:
    """Kill a process as soon as something is reached; everything that it started must be gone soon after."""
    while not reached():
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    family = psutil.Process(process.pid).children(recursive=True)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    gone, alive = psutil.wait_procs(family, timeout=60)
    assert not alive and gone


@pytest.mark.slow
def test_killed_twice_it_goes_on_loses_a_cell_a_core_and_drives_nothing_finished_again(tiny: Path):
    here = place(tiny)
    train, learned, random, held_out = steps(here)
    assert isinstance(train, Train) and isinstance(random, Judge)
    (run,) = here.runs("short")

    kill_when(reproduce(tiny), lambda: has_checkpoint(run))
    assert not is_finished(run) and not train.is_done()

    records = random.folder / "records" / "track_2"
    kill_when(reproduce(tiny), lambda: learned.is_done() and any(records.glob("*.npz")))
    assert train.is_done() and learned.is_done() and not random.is_done() and not held_out.is_done()
    partial = gather(here)
    assert {row["place"] for row in partial["episodes"].to_pylist() if row["run"]} == {"track_2"}
    n_partial = partial["episodes"].num_rows
    assert 2 < n_partial < 14
    before = {path: path.stat().st_mtime_ns for path in (run / "summary.json", learned.folder / "scores.json")}

    last = reproduce(tiny)
    said, errors = last.communicate()
    assert last.returncode == 0, errors
    result = json.loads(said.splitlines()[-1])
    assert result["failed"] == {} and result["rows"]["episodes"] == 2 + 12 + 3 * 2
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert all(step.is_done() for step in steps(here))

    # The same outputs, the same bytes; and each column as the schema has it.
    assert Path(result["report"]).is_file()
    first = {path.name: path.read_bytes() for path in Path(result["tables"]).glob("*.parquet")}
    write_tables(gather(here), tiny / "again")
    assert {path.name: path.read_bytes() for path in (tiny / "again").iterdir()} == first
    tables = read_tables(Path(result["tables"]))
    assert {name: table.column_names for name, table in tables.items()} == {n: list(c) for n, c in COLUMNS.items()}
    rows = tables["episodes"].to_pylist()
    policy = "runs/comparison/training/short/ddpg-ft-big_track-seed0/best.safetensors"
    (one, _) = [row for row in rows if row["method"] == "RL_FT"]
    assert (one["agent"], one["run"]) == (policy, "short/ddpg-ft-big_track-seed0")
    assert one["min_gap_m"] is not None and one["distance_m"] > 0.0 and one["family"] is None
    on_set = [row for row in rows if row["sim"] == "planar"]
    assert {row["reversals"] for row in on_set} == {5} and all(row["min_gap_m"] is None for row in on_set)
    assert all(2 <= len(row["x"]) == len(row["y"]) <= 64 for row in tables["paths"].to_pylist())
    (trained,) = tables["runs"].to_pylist()
    assert trained["state"] == "complete" and trained["episodes"] == 8
    assert trained["command"].startswith(
        "zebrat sweep --algos ddpg --rewards ft --seeds 0 --preset paper --set episodes=8"
    )
    assert trained["command"].endswith("--out runs/comparison/training/short")


def test_kept_runs_of_seeds_that_a_budget_does_not_train_are_in_its_tables_each_with_its_own_command(tmp_path: Path):
    here = Place(manifest=read_manifest(SHIPPED), budget="smoke", out=tmp_path, checkout=ROOT)
    tables = gather(here)
    rows = {row["run"]: row for row in tables["runs"].to_pylist()}
    kept = rows["paper-fomt/ddpg-fomt-big_track-seed4"]
    assert kept["command"] == (
        "zebrat sweep --algos ddpg --rewards fomt --seeds 4 --preset paper --out runs/comparison/training/paper-fomt"
    )
    assert (kept["state"], kept["episodes"], kept["steps"]) == ("complete", 1000, 290648)  # docs/learning.md
    assert rows["paper-smoke/ddpg-wg-big_track-seed0"]["state"] == "missing"
    # Finished, but as a budget that cuts it short has it: not what was asked for.
    cut = tmp_path / "training" / "paper-smoke" / "ddpg-wg-big_track-seed0"
    with as_folder(ROOT / "docs/results/paper-rewards.zip") as runs:
        shutil.copytree(runs / cut.name, cut)
    n_kept = len(read_rows(cut / "episodes.csv"))
    (cut / "summary.json").write_text("{}", encoding="utf-8")
    again = {row["run"]: row for row in gather(here)["runs"].to_pylist()}["paper-smoke/ddpg-wg-big_track-seed0"]
    assert again["state"] == "partial" and again["episodes"] == n_kept > 100
    curve = [row for row in tables["learning"].to_pylist() if row["run"] == kept["run"]]
    assert sum(row["best_return"] is not None for row in curve) == 50
    assert tables["collisions"].num_rows > 0 and tables["episodes"].num_rows == 0


def test_a_training_of_which_an_algorithm_is_kept_trains_only_the_others_and_goes_on_with_what_is_begun(tiny: Path):
    kept = tiny / "kept" / "ddpg-ft-big_track-seed0"
    kept.mkdir(parents=True)
    (kept / "summary.json").write_text("{}", encoding="utf-8")
    path = tiny / "manifest.yaml"
    more = f"rewards: [ft]\n    algos: [ddpg, sac]\n    kept: {tiny / 'kept'}\n    kept_seeds: [0]"
    path.write_text(TINY.replace("rewards: [ft]", more), encoding="utf-8")

    def asked(budget: str) -> list[str]:
        (train,) = (step for step in steps(place(tiny, budget)) if isinstance(step, Train))
        return train.command()[: train.command().index("--preset")]

    assert asked("all") == ["sweep", "--algos", "sac", "--rewards", "ft", "--seeds", "0"]
    assert asked("more") == ["sweep", "--algos", "ddpg", "sac", "--rewards", "ft", "--seeds", "0", "1"]
    # Begun there with one seed more, which a sweep in the same folder must name too.
    begun = tiny / "out" / "training" / "short" / "manifest.json"
    begun.parent.mkdir(parents=True)
    begun.write_text(json.dumps({"algos": ["sac"], "rewards": ["ft"], "seeds": [0, 7]}), encoding="utf-8")
    assert asked("all") == ["sweep", "--algos", "sac", "--rewards", "ft", "--seeds", "0", "7"]


@pytest.mark.parametrize(
    ("wrong", "instead", "said"),
    [
        ("study: paper", "study: papr", "trainings.short.study"),
        ("rewards: [ft]", "rewards: [ft]\n    reward: [ft]", "trainings.short.reward"),
        ("trainings: [short]", "trainings: [long]", "judgements.learned.trainings names 'long'; there are short"),
        ("learned: {}, random", "learnt: {}, random", "names 'learnt'; there are learned, random, held-out"),
        ("episodes: 12,", "episodes: 0,", "episodes and tracks are at least 1"),
        ("seeds: [0]", "seeds: []", "seeds are whole numbers from 0 up, at least one"),
        ("asked: 8", "seeds: [3]\n    asked: 8", "budgets.all.seeds are [0], and none is among trainings.short.seeds"),
        ("asked: 8", "seeds: [1, 1]\n    asked: 8", "seeds are whole numbers from 0 up, each once; got [1, 1]"),
        ("sim: planar", "sim: planar, worlds: [track_2]", "either worlds or sets"),
        ("trainings:", "trainings: [", "is not readable as YAML"),
    ],
)
def test_a_manifest_that_cannot_be_meant_is_refused_by_the_name_of_what_is_wrong(
    tiny: Path, wrong: str, instead: str, said: str
):
    path = tiny / "manifest.yaml"
    path.write_text(TINY.replace(wrong, instead, 1), encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        read_manifest(path)
    assert said in str(refused.value) and "manifest.yaml" in str(refused.value)


@pytest.mark.parametrize(
    ("wrong", "instead", "said"),
    [
        ("episodes=8", "episods=8", "cannot set 'episods=8'"),
        ("rewards: [ft]", "rewards: [fat]", "unknown reward preset 'fat'"),
        ("asked: 8 episodes", "asked: 8 episodes\n    kept: nowhere.zip", "trainings.short.kept names nowhere.zip"),
    ],
)
def test_a_training_that_cannot_be_run_is_refused_before_anything_runs(
    tiny: Path, wrong: str, instead: str, said: str, capfd: pytest.CaptureFixture[str]
):
    path = tiny / "manifest.yaml"
    path.write_text(TINY.replace(wrong, instead, 1), encoding="utf-8")
    call = ["reproduce", "--manifest", str(path), "--budget", "all", "--out", str(tiny / "out")]
    assert main(call) == 2
    assert said in capfd.readouterr().err
    assert not (tiny / "out" / "training").exists() and not (tiny / "out" / "judged").exists()


def test_an_unknown_budget_or_step_is_refused_with_those_there_are(tiny: Path, capfd: pytest.CaptureFixture[str]):
    call = ["reproduce", "--manifest", str(tiny / "manifest.yaml"), "--out", str(tiny / "out")]
    assert main([*call, "--budget", "some"]) == 2
    assert "no budget 'some'; there are all, more" in capfd.readouterr().err
    assert main([*call, "--budget", "all", "--only", "dance"]) == 2
    assert "no step is called dance" in capfd.readouterr().err


def test_the_whole_name_of_a_step_chooses_that_step_alone(tiny: Path, capfd: pytest.CaptureFixture[str]):
    path = tiny / "manifest.yaml"
    path.write_text(
        TINY.replace("judgements:", "  short-too: {study: paper, asked: much}\njudgements:", 1), encoding="utf-8"
    )
    path.write_text(
        path.read_text(encoding="utf-8").replace("trainings: {short: []}", "trainings: {short: [], short-too: []}"),
        encoding="utf-8",
    )

    def chosen(*texts: str) -> list[str]:
        call = ["reproduce", "--manifest", str(path), "--budget", "all", "--out", str(tiny / "out"), "--json"]
        assert main([*call, "--plan", "--only", *texts]) == 0
        names: list[str] = json.loads(capfd.readouterr().out.splitlines()[-1])["steps"]
        return names

    assert chosen("train short") == ["train short"]
    assert chosen("train sho") == chosen("train short", "too") == ["train short", "train short-too"]


def test_a_failing_step_is_reported_at_the_end_and_the_others_go_on(tiny: Path, capfd: pytest.CaptureFixture[str]):
    path = tiny / "manifest.yaml"
    lost = tiny / "lost.py"
    lost.write_text(LOST, encoding="utf-8")
    path.write_text(TINY.replace("agent: random", f"agent: '{lost}:Lost'"), encoding="utf-8")
    call = ["reproduce", "--manifest", str(path), "--budget", "all", "--out", str(tiny / "out"), "--json"]
    assert main([*call, "--only", "judge"]) == 1
    said = capfd.readouterr()
    failed = json.loads(said.out.splitlines()[-1])["failed"]
    (own,) = (name for name in failed if name.startswith("judge random/"))
    assert set(failed) == {"judge learned/short-ddpg-ft/track_2", own}
    assert "'short' has no policy of ddpg under ft yet" in failed["judge learned/short-ddpg-ft/track_2"]
    assert "lost.py, line 3: act fails: ZeroDivisionError" in failed[own]
    (judged,) = (step for step in steps(place(tiny)) if step.name.startswith("judge held-out"))
    assert judged.is_done()


def test_scores_of_another_policy_or_of_fewer_episodes_are_no_done_cell(tiny: Path):
    (random,) = (step for step in steps(place(tiny)) if step.name.startswith("judge random"))
    assert isinstance(random, Judge)
    random.command()  # prepares the folder
    assert not random.is_done()
    scores = random.folder / "scores.json"
    scores.write_text(json.dumps({"track_2": {"episodes": 12}}), encoding="utf-8")
    assert random.is_done()
    scores.write_text(json.dumps({"track_2": {"episodes": 11}}), encoding="utf-8")
    assert not random.is_done()
    scores.write_text('{"track_2": {"episo', encoding="utf-8")  # what a kill leaves
    assert not random.is_done()
    scores.write_text(json.dumps({"track_2": {"episodes": 12}}), encoding="utf-8")
    made_by = random.folder / "made_by.json"
    made_by.write_text(
        json.dumps(json.loads(made_by.read_text(encoding="utf-8")) | {"sha256": "another"}), encoding="utf-8"
    )
    assert not random.is_done()
    random.command()
    assert not scores.exists()
    (held_out,) = (step for step in steps(place(tiny)) if step.name.startswith("judge held-out"))
    shipped = hashlib.sha256((ROOT / "zebrat_bullet" / "policies" / "shipped.safetensors").read_bytes()).hexdigest()
    assert isinstance(held_out, Judge) and held_out.made_by()["sha256"] == shipped  # of one that is named, too
    assert held_out.made_by()["format"] == SCHEMA and "format" not in random.made_by()  # worlds leave whole records


def test_an_edited_car_is_judged_anew(tiny: Path):
    car = tiny / "car.urdf"
    car.write_bytes((ROOT / "urdf" / "zebrat.urdf").read_bytes())
    path = tiny / "manifest.yaml"
    text = path.read_text(encoding="utf-8")

    def made_by(options: str) -> dict[str, Any]:
        path.write_text(text.replace("12, options: [--caster, embree]", f"12, options: {options}"), encoding="utf-8")
        return next(step.made_by() for step in steps(place(tiny)) if isinstance(step, Judge) and "random" in step.name)

    assert "files" not in made_by("[--caster, embree]")
    before = made_by(f"[--robot, {car}]")
    assert before == made_by(f"[--robot, {car}]") and before["files"].keys() == {str(car)}
    for options in (f"[--set, task.robot={car}]", f"[--set=task.robot={car}]", f"""[--set, 'task.robot="{car}"']"""):
        assert made_by(options)["files"] == before["files"]
    assert "files" not in made_by("[--robot, zebrat]")
    car.write_text(car.read_text(encoding="utf-8") + "<!-- edited -->", encoding="utf-8")
    assert made_by(f"[--robot, {car}]") != before


def test_a_run_that_is_not_finished_has_no_policy_to_be_judged(tiny: Path):
    here = place(tiny)
    (run,) = here.runs("short")
    run.mkdir(parents=True)
    (run / "best.safetensors").write_bytes(b"weights")
    (run / "evaluations.csv").write_text(
        "episode,total_steps,wall_s,success,collision,fail,time_s,best\n4,100,1.0,0.5,0.25,0.25,20.0,1\n",
        encoding="utf-8",
    )
    with pytest.raises(ConfigError, match="'short' has no policy of ddpg under ft yet"):
        best_policy(here, "short", "ddpg", "ft")
    (run / "summary.json").write_text("{}", encoding="utf-8")
    assert best_policy(here, "short", "ddpg", "ft") == run / "best.safetensors"
    (row,) = gather(here)["runs"].to_pylist()
    assert (row["best_success"], row["best_collision"], row["best_time_s"]) == (0.5, 0.25, 20.0)


def test_what_is_kept_in_tables_is_not_driven_again_and_comes_into_the_new_ones_as_it_is(tiny: Path):
    path, kept = tiny / "manifest.yaml", tiny / "kept"
    path.write_text(TINY.replace("episodes: 12", "episodes: 2"), encoding="utf-8")
    call = ["reproduce", "--manifest", str(path), "--budget", "all", "--out", str(tiny / "out")]
    assert main([*call, "--only", "judge random", "judge held-out", "--quiet"]) == 0
    driven = gather(place(tiny))
    write_tables(driven, kept)
    assert driven["episodes"].num_rows == 2 + 3 * 2 and driven["paths"].num_rows == 2

    def elsewhere(old: str = "", new: str = "") -> tuple[Place, list[str]]:
        """The same comparison in an empty folder, with those tables; and the judgements that it has still to drive."""
        text = path.read_text(encoding="utf-8").replace(old, new) if old else path.read_text(encoding="utf-8")
        manifest = tiny / "other.yaml"
        manifest.write_text(
            text.replace("about: all of it", f"about: all of it\n    records: {kept}"), encoding="utf-8"
        )
        here = Place(manifest=read_manifest(manifest), budget="all", out=tiny / "empty", checkout=ROOT)
        to_do = [step for step in steps(here) if isinstance(step, Judge) and not step.is_done()]
        return here, [step.cell.judgement for step in to_do]

    here, to_do = elsewhere()
    assert to_do == ["learned"]  # there is no policy of it
    assert {name: gather(here)[name].to_pylist() for name in ("episodes", "paths")} == {
        name: driven[name].to_pylist() for name in ("episodes", "paths")
    }
    here, to_do = elsewhere("method: random", "method: dice")  # another name only
    assert to_do == ["learned"] and "dice" in gather(here)["episodes"]["method"].to_pylist()
    assert elsewhere("episodes: 2, options", "episodes: 3, options")[1] == ["learned", "random"]
    assert elsewhere("[--caster, embree]", "[--caster, open3d]")[1] == ["learned", "random"]
    assert elsewhere("tracks: 3", "tracks: 4")[1] == ["learned", "held-out"]
    assert elsewhere("[reversals-5]", "[reversals-4]")[1] == ["learned", "held-out"]
    here, to_do = elsewhere("episodes: 2, options", "episodes: 1, options")  # more is kept than is asked for
    assert to_do == ["learned"] and gather(here)["paths"].num_rows == 1
    shutil.rmtree(kept)
    with pytest.raises(ConfigError, match=r"budgets\.all\.records names .*kept, which is not there"):
        elsewhere()


def test_the_committed_tables_are_of_todays_policies_and_sets_and_come_out_of_an_empty_folder_as_they_are(
    tmp_path: Path,
):
    here = Place(manifest=read_manifest(SHIPPED), budget="laptop", out=tmp_path, checkout=ROOT)
    committed = read_tables(ROOT / "docs" / "results" / "comparison")
    for name, table in gather(here).items():
        assert table.equals(committed[name]), name


def test_before_it_starts_it_says_what_how_long_and_what_is_missing(tiny: Path):
    here = place(tiny)
    planned: list[Step] = steps(here)
    said = forecast(here, planned, planned, SPEED)
    # 8 episodes of 40 steps at most, at 50 steps a second, are 6.4 s; and 4 s until it begins.
    assert "training short: 1 step, about 0.2 min" in said
    assert "1 of 2 seeds" in said
    slow = forecast(here, planned, planned, SPEED | {"train ddpg, PyBullet": 0.05})
    assert "training short: 1 step, about 107 min" in slow
    assert "training short" not in forecast(here, planned, planned[1:], SPEED)
    assert "what was not measured" in forecast(here, planned, planned, {})


def test_the_time_of_a_training_on_planar_cars_holds_the_drawing_of_its_tracks(tmp_path: Path):
    (tmp_path / "manifest.yaml").write_text(
        "trainings:\n"
        "  fast: {study: scale, asked: 10 million steps, algos: [ppo], rewards: [ft], preset: general,\n"
        "         set: [steps=10000000, planar.n_tracks=5000]}\n"
        "judgements: {}\n"
        "budgets: {all: {about: one run, seeds: [0], trainings: {fast: []}, judgements: {}}}\n",
        encoding="utf-8",
    )
    here = place(tmp_path)
    planned = steps(here)
    # 10 million steps at 50,000 a second are 200 s, and 5,000 tracks of 0.08 s are 400 s of one core among all.
    speed = {"train ppo, 1024 planar cars": 50_000.0, "a track of mixed": 0.08}
    assert "training fast: 1 step, about 10 min" in forecast(here, planned, planned, speed)


def test_the_papers_budget_leaves_nothing_out_and_is_what_the_paper_says():
    manifest = read_manifest(SHIPPED)
    paper = manifest.budget("paper")
    once = {"paper-fomt-first", "finetuning-first"}  # kept for their logs, and never run again
    assert list(paper.trainings) == [name for name in manifest.trainings if name not in once]
    assert list(paper.judgements) == list(manifest.judgements)
    assert len(paper.seeds) == 5 and not any(paper.trainings.values())
    assert cells(manifest, "paper") == cells(manifest)
    all_cells = cells(manifest, "paper")
    for study, rewards in (("paper", {"fomt", "fot", "ft", "wg"}), ("scale", {"fomt", "fot", "fmt", "ft"})):
        judged = [cell for cell in all_cells if cell.study == study and cell.reward and not cell.is_set]
        assert {cell.reward for cell in judged} == rewards
        real = {"real_1", "real_2", "real_3"} if study == "paper" else set()
        assert {cell.place for cell in judged} == {*TRACKS, *real} and {cell.episodes for cell in judged} == {70}
    for method in ("DWA", "TEB"):
        driven = [cell for cell in all_cells if cell.method == method]
        assert {cell.episodes for cell in driven} == {15}
        assert {"radius 0.3", "radius 0.5"} <= {cell.setting for cell in driven}


def test_a_command_that_changes_its_sign_counts_as_a_reversal_and_only_what_was_driven_back_as_backing_up():
    assert count_reversals(np.array([0.0, 0.3, 0.0, 0.3, -0.1, 0.0, -0.1, 0.3])) == 2
    along = np.array([0.0, 0.3, 0.6, 0.55, 0.5, 0.52, 0.4, 0.9])  # 0.2 m back, with a halt that moves it on a little
    for yaw in (0.0, 2.0):
        poses = np.stack([along * np.cos(yaw) + 3.0, along * np.sin(yaw), np.full(len(along), yaw)], axis=1)
        assert longest_way_back(poses) == pytest.approx(0.2)
        assert longest_way_back(poses[:3]) == 0.0 == longest_way_back(poses[:1])
    turned = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, np.pi], [0.0, 0.0, np.pi]])  # back where it was, nose first
    assert longest_way_back(turned) == 0.0


def test_a_training_that_no_budget_runs_is_missing_from_none(tmp_path: Path):
    def said(budget: str) -> str:
        here = Place(manifest=read_manifest(SHIPPED), budget=budget, out=tmp_path, checkout=ROOT)
        return forecast(here, [], [], {})

    assert "missing" not in said("paper")
    assert "finetuning-cloning" in said("laptop") and "first" not in said("laptop")


def test_a_training_with_seeds_of_its_own_has_no_others_in_any_budget(tmp_path: Path):
    text = TINY.replace("asked: 8 episodes\n", "asked: 8 episodes\n    seeds: [1]\n").replace(
        "seeds: [0]", "seeds: [1, 2]"
    )
    text = text.replace("worlds: [track_2], episodes: 2,", "seeds: every, worlds: [track_2], episodes: 2,")
    (tmp_path / "manifest.yaml").write_text(text, encoding="utf-8")
    for budget in ("all", "more"):
        here = place(tmp_path, budget)
        assert [config.seed for config in here.runs("short").values()] == [1]
        assert [cell.seed for cell in cells(here.manifest, budget) if cell.training] == [1]
    assert [cell.seed for cell in cells(here.manifest) if cell.training] == [1]
    assert asked_runs(here.manifest) == {("paper", "ddpg", "ft", "", "8 episodes"): 1}


def test_every_seed_means_kept_ones_that_the_budget_does_not_train_too_but_not_where_it_cuts_them_short():
    manifest = read_manifest(SHIPPED)
    seeds = {
        budget: {
            (cell.training, cell.seed) for cell in cells(manifest, budget) if cell.training and cell.seed is not None
        }
        for budget in ("smoke", "laptop")
    }
    kept = {("scale", seed) for seed in manifest.trainings["scale"].kept_seeds}
    assert len(kept) > len(manifest.budget("laptop").seeds) and kept <= seeds["laptop"]
    # Smoke does not train paper-fomt, and so does not cut it short.
    fomt = {("paper-fomt", seed) for seed in manifest.trainings["paper-fomt"].kept_seeds}
    assert seeds["smoke"] == {("paper", 0), ("scale", 0), ("finetuning", 0)} | fomt
    tuned = {("finetuning-fomt", seed) for seed in manifest.trainings["finetuning-fomt"].kept_seeds}
    assert tuned == {one for one in seeds["laptop"] if one[0] == "finetuning-fomt"}  # which it does not train


@pytest.mark.parametrize("budget", ["smoke", "laptop", "paper"])
def test_every_training_of_the_shipped_manifest_can_be_run_and_what_it_keeps_is_there(budget: str, tmp_path: Path):
    here = Place(manifest=read_manifest(SHIPPED), budget=budget, out=tmp_path, checkout=ROOT)
    planned = steps(here)
    assert len({step.name for step in planned}) == len(planned)
    for name, training in here.manifest.trainings.items():
        if training.policies:
            assert any(here.kept_policy(name, run) for run in here.runs(name)) or budget == "smoke"
        if training.study == "scale":
            assert all(config.steps == 10_000_000 for config in here.runs(name).values()) or budget == "smoke"
    if budget == "laptop":  # it judges nothing that it neither trains nor keeps
        judged = {cell.training for cell in cells(here.manifest, budget)} - {""}
        assert all(name in here.plan.trainings or here.manifest.trainings[name].policies for name in judged)
    assert {config.seed for config in here.runs("paper-fomt-first").values()} == {0, 1, 2}  # whatever the budget's
    finished = {step.name for step in planned if isinstance(step, Train) and step.is_done()}
    assert ("train paper-fomt" in finished) == (budget != "smoke")


def test_a_fine_tuning_begins_with_the_best_of_all_seeds_and_says_how_to_make_its_model_where_a_policy_alone_is_kept(
    tmp_path: Path,
):
    here = Place(manifest=read_manifest(SHIPPED), budget="laptop", out=tmp_path, checkout=ROOT)
    with pytest.raises(ConfigError) as refused:
        best_model(here, "paper", "ddpg", "fot")
    run = best_run(here, "paper", "ddpg", "fot")
    seed = here.runs("paper")[run].seed
    assert seed not in here.plan.seeds  # of those that are kept, too
    called = str(refused.value).partition("drive it again: zebrat ")[2]
    assert called == f"sweep --algos ddpg --rewards fot --seeds {seed} --preset paper --out {run.parent}"
    shutil.copytree(here.readable_runs("paper")[run], run)
    (run / "best.zip").write_bytes(b"a model")
    again = Place(manifest=here.manifest, budget="laptop", out=tmp_path, checkout=ROOT)
    assert best_model(again, "paper", "ddpg", "fot") == run / "best.zip"


def test_a_set_of_fewer_tracks_than_are_asked_for_is_driven_whole(tmp_path: Path):
    (tmp_path / "manifest.yaml").write_text(
        TINY.replace("sets: [reversals-5], tracks: 3", "sets: [reversals-5, corners], tracks: 300"), encoding="utf-8"
    )
    judged = [step for step in steps(place(tmp_path)) if isinstance(step, Judge) and step.cell.method != "RL_FT"]
    tracks = {step.cell.place: step.made_by()["tracks"] for step in judged}
    assert tracks["track_2"] is None
    assert tracks["corners"] == 300 and tracks["reversals-5"] == len(read_set("reversals-5").tracks) < 300


def test_rows_in_any_order_make_the_same_bytes(tmp_path: Path):
    rows = [{"run": "b", "episode": 20, "best_return": 1.5}, {"run": "a", "episode": 40}, {"run": "a", "success": 0.5}]
    for name, some in (("one", rows), ("two", rows[::-1])):
        write_tables({"learning": table_of("learning", some)}, tmp_path / name)
    assert (tmp_path / "one" / "learning.parquet").read_bytes() == (tmp_path / "two" / "learning.parquet").read_bytes()


def test_a_table_that_is_none_is_refused_by_name(tmp_path: Path):
    write_tables({name: table_of(name, []) for name in COLUMNS}, tmp_path)
    (tmp_path / "paths.parquet").write_bytes(b"PAR1 no table")
    with pytest.raises(ConfigError, match=r"paths\.parquet: is not the table `paths`"):
        read_tables(tmp_path)
    (tmp_path / "paths.parquet").unlink()
    with pytest.raises(ConfigError, match=r"paths\.parquet: no such file"):
        read_tables(tmp_path)
