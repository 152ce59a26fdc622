"""Sweeps in processes of this machine: killed, failing, stopped and extended, and nothing finished is run twice."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from own_cars import OwnCar

from zebrat_bullet.assets import find_asset
from zebrat_bullet.cli.main import main
from zebrat_bullet.config_text import to_json
from zebrat_bullet.errors import AssetError, ConfigError
from zebrat_bullet.evaluation.csv_log import read_rows
from zebrat_bullet.training.presets import TRAIN_PRESETS
from zebrat_bullet.training.run_folder import has_checkpoint, is_finished
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep import Sweep, open_sweep, read_manifest, sweep_of
from zebrat_bullet.training.sweep_local import run_locally
from zebrat_bullet.training.sweep_run import Outcome, claim, perform, status

ZEBRAT = Path(sys.executable).parent / "zebrat"

TINY = (
    "episodes=20",
    "learner.hidden=[16,16]",
    "learner.batch_size=16",
    "learner.buffer_size=2000",
    "learner.warmup_steps=200",
    "eval_every=20",
    "eval_episodes=1",
    "checkpoint_every=1",
    "task.lidar.n_channels=4",
    "task.episode.max_steps=60",
)


def episodes(run: Path) -> list[int]:
    with (run / "episodes.csv").open() as file:
        return [int(row["episode"]) for row in csv.DictReader(file)]


def holder(run: Path) -> int | None:
    """Return the process that last held a run."""
    lock = run / "lock"
    said = lock.read_text(encoding="utf-8").split() if lock.exists() else []
    return int(said[1]) if len(said) == 2 else None


def zebrat_sweep(folder: Path, *arguments: object) -> subprocess.Popen[str]:
    command = [ZEBRAT, "sweep", "--out", folder, "--json", *arguments]
    return subprocess.Popen(list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_until_in_the_middle(run: Path, process: subprocess.Popen[str]) -> int:
    """Wait until a run has a checkpoint and is not finished; return the process that holds it."""
    while not (has_checkpoint(run) and status(run).state == "running"):
        assert process.poll() is None and not is_finished(run), process.communicate()
        time.sleep(0.02)
    return holder(run)


def summary_times(folder: Path) -> dict[Path, float]:
    return {path: path.stat().st_mtime for path in folder.glob("*/summary.json")}


def test_a_killed_worker_is_resumed_a_failing_run_fails_alone_and_nothing_finished_runs_again(tmp_path):
    folder = tmp_path / "sweep"
    runs = open_sweep(Sweep(algos=("ddpg", "sac"), worlds=("track_2",), seeds=(0, 1), set=TINY), folder)
    killed, _, broken, _ = runs
    (broken / "checkpoint").mkdir(parents=True)  # holds nothing: to resume from it raises
    (broken / "config.json").write_text(to_json(runs[broken]), encoding="utf-8")

    sweep = zebrat_sweep(folder)
    os.kill(wait_until_in_the_middle(killed, sweep), signal.SIGKILL)
    at = time.time()
    said, errors = sweep.communicate()
    summaries = json.loads(said)
    assert sweep.returncode == 1 and f"1 of 4 runs failed: {broken.name}" in errors
    assert {name for name, summary in summaries.items() if "error" in summary} == {broken.name}
    assert "FileNotFoundError" in summaries[broken.name]["error"] and "Traceback" in (broken / "error.txt").read_text(
        encoding="utf-8"
    )
    assert all(episodes(run) == list(range(1, 21)) for run in runs if run != broken)
    begun, ended = ((killed / name).stat().st_mtime for name in ("versions.json", "summary.json"))
    assert begun < at < ended  # it went on from its checkpoint: a new beginning writes versions.json

    before = summary_times(folder)
    assert len(before) == 3
    shutil.rmtree(broken / "checkpoint")
    sweep = zebrat_sweep(folder)
    worker = wait_until_in_the_middle(broken, sweep)
    sweep.send_signal(signal.SIGINT)
    said, errors = sweep.communicate()
    assert sweep.returncode == 130 and said == "" and f"`zebrat sweep --out {folder}` continues" in errors
    assert not psutil.pid_exists(worker) and status(broken).state == "waiting"
    assert summary_times(folder) == before


def test_a_run_whose_process_keeps_dying_is_given_up(tmp_path):
    runs = open_sweep(Sweep(worlds=("track_2",), set=TINY), tmp_path)
    (run,) = runs

    def kill_the_worker():
        for child in psutil.Process().children():
            if str(run) in child.cmdline():
                child.kill()

    run_locally(runs, workers=1, retries=1, on_tick=kill_the_worker)
    assert "its process died 2 times, at last with status -9" in (run / "error.txt").read_text(encoding="utf-8")
    assert status(run).state == "failed"


def test_a_run_belongs_to_one_process_at_a_time(tmp_path):
    with claim(tmp_path) as mine:
        assert mine and status(tmp_path).state == "running"
        assert perform(TrainConfig(), tmp_path) is Outcome.BUSY
    assert status(tmp_path).state == "waiting"
    with claim(tmp_path) as mine:
        assert mine


def test_a_finished_run_is_left_as_it_is(tmp_path):
    (tmp_path / "summary.json").write_text("{}", encoding="utf-8")
    assert perform(TrainConfig(), tmp_path) is Outcome.DONE
    assert {path.name for path in tmp_path.iterdir()} == {"summary.json", "lock"}


def test_a_sweep_may_grow_and_not_otherwise_change(tmp_path):
    small = Sweep(seeds=(0, 1), set=("episodes=10",))
    assert [run.name for run in open_sweep(small, tmp_path)] == [f"ddpg-fomt-big_track-seed{k}" for k in (0, 1)]
    larger = Sweep(algos=("ppo", "ddpg"), seeds=(0, 1, 2), set=("episodes=10",))
    runs = open_sweep(larger, tmp_path)
    assert len(runs) == 6 and {config.episodes for config in runs.values()} == {10}
    for other, difference in (
        (small, r"algos were \('ppo', 'ddpg'\), now \('ddpg',\)"),
        (Sweep(algos=("ppo", "ddpg"), seeds=(0, 1, 2)), r"set were \('episodes=10',\), now \(\)"),
    ):
        with pytest.raises(ConfigError, match=difference):
            open_sweep(other, tmp_path)
    assert sweep_of(read_manifest(tmp_path / "manifest.json")) == larger


def test_the_car_of_a_sweep_is_that_of_its_runs(tmp_path):
    runs = open_sweep(Sweep(robot="long", rewards=("wg",)), tmp_path)
    (config,) = runs.values()
    assert config.task.robot == "long" and config.task.observation.waypoint
    with pytest.raises(ConfigError, match="robot were long, now zebrat"):
        open_sweep(Sweep(rewards=("wg",)), tmp_path)


def test_a_run_trained_with_other_settings_is_not_taken_for_one_of_the_sweep(tmp_path):
    ((run, config),) = open_sweep(Sweep(), tmp_path).items()
    (run / "checkpoint").mkdir(parents=True)
    (run / "config.json").write_text(to_json(config), encoding="utf-8")
    open_sweep(Sweep(), tmp_path)
    settings = json.loads(to_json(config))
    del settings["stop_at"]  # as a version wrote it that did not know this setting
    settings["attempts"] = 1  # and had one that is gone
    (run / "config.json").write_text(json.dumps(settings), encoding="utf-8")
    open_sweep(Sweep(), tmp_path)
    (run / "config.json").write_text(to_json(TrainConfig(episodes=7)), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"trained with other settings \(episodes\)"):
        open_sweep(Sweep(), tmp_path)


def test_a_sweep_does_not_go_on_with_a_car_or_world_that_was_edited_since_its_first_runs(tmp_path):
    car, world = tmp_path / "mine.urdf", tmp_path / "mine.yaml"
    car.write_text(OwnCar().urdf(), encoding="utf-8")
    shutil.copy(find_asset("worlds", "track_2", ".yaml"), world)
    given = {"robot": str(car), "worlds": (str(world),), "set": ("episodes=1", *TINY[1:])}
    ((run, config),) = open_sweep(Sweep(**given), tmp_path / "sweep").items()
    assert perform(config, run) is Outcome.DONE
    grown = Sweep(**given, seeds=(0, 1))
    assert len(open_sweep(grown, tmp_path / "sweep")) == 2
    text = world.read_text(encoding="utf-8")
    world.write_text(text.replace("{straight: 3.2, width: 1.35}", "{straight: 3.3, width: 1.35}"), encoding="utf-8")
    with pytest.raises(ConfigError, match=f"was trained before world {world} changed; put it back as it was, or name"):
        open_sweep(grown, tmp_path / "sweep")
    world.write_text(text, encoding="utf-8")
    car.write_text(OwnCar(half_base=0.17).urdf(), encoding="utf-8")
    with pytest.raises(ConfigError, match=f"was trained before robot {car} changed"):
        open_sweep(grown, tmp_path / "sweep")


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"algos": ["ddpg", "td3"]}, ConfigError, "unknown algorithm 'td3'"),
        ({"rewards": ["fomo"]}, ConfigError, "fomo"),
        ({"worlds": ["nowhere"]}, AssetError, "nowhere"),
        ({"seeds": [0, 0]}, ConfigError, "seeds must name at least one, and each once"),
        ({"seeds": []}, ConfigError, "seeds must name at least one"),
        ({"seeds": ["one"]}, ConfigError, "seeds"),
        ({"preset": "papper"}, ConfigError, "no preset 'papper'"),
        ({"set": ["bach_size=3"]}, ConfigError, "cannot set 'bach_size=3'"),
        ({"algos": ["ddpg", "ppo"], "set": ["learner.tau=0.1"]}, ConfigError, "ppo-fomt-big_track-seed0: cannot set"),
        ({"set": ["seed=3"]}, ConfigError, "axis of the sweep"),
        ({"set": ["init=nothing.zip"]}, ConfigError, "nothing.zip"),
    ],
)
def test_a_mistake_costs_nothing(settings, error, message, tmp_path):
    with pytest.raises(error, match=message):
        open_sweep(sweep_of(settings), tmp_path / "sweep")
    assert not (tmp_path / "sweep").exists()


def test_worlds_of_one_file_name_have_runs_of_their_own_that_stay_where_they_are(tmp_path):
    shipped = Path(__file__).parent.parent / "worlds" / "track_2.yaml"
    files = [tmp_path / name / "track_2.yaml" for name in ("a", "x/b", "y/b")]
    for file in files:
        file.parent.mkdir(parents=True)
        shutil.copy(shipped, file)
    first, second, third = map(str, files)
    begun = open_sweep(Sweep(worlds=(second,)), tmp_path / "sweep")
    grown = open_sweep(Sweep(worlds=(first, second, third, "track_2")), tmp_path / "sweep")
    where = {config.worlds[0]: run.name for run, config in grown.items()}
    assert where == {
        second: "ddpg-fomt-track_2-seed0",
        first: "ddpg-fomt-a-track_2-seed0",
        third: "ddpg-fomt-b-track_2-seed0",
        "track_2": "ddpg-fomt-track_2-2-seed0",
    }
    assert set(begun) < set(grown)


def test_runs_begin_seed_after_seed_so_that_a_sweep_that_is_stopped_has_compared_alike(tmp_path):
    runs = open_sweep(Sweep(algos=("ddpg", "sac"), rewards=("fomt", "wg"), seeds=(0, 1)), tmp_path / "sweep")
    assert [config.seed for config in runs.values()] == [0, 0, 0, 0, 1, 1, 1, 1]


def test_files_of_a_sweep_are_found_from_anywhere_with_their_places_too(tmp_path, monkeypatch):
    shutil.copy(Path(__file__).parent.parent / "worlds" / "track_2.yaml", tmp_path)
    monkeypatch.chdir(tmp_path)
    one = Sweep(worlds=("track_2.yaml",), set=("episodes=1", *TINY[1:], "eval_worlds=[track_2.yaml]"))
    ((run, config),) = open_sweep(one, tmp_path / "sweep").items()
    assert run.name == "ddpg-fomt-track_2-seed0"
    assert config.worlds == config.eval_worlds == (str(tmp_path / "track_2.yaml"),)
    assert perform(config, run) is Outcome.DONE
    open_sweep(one, tmp_path / "sweep")  # what it has trained is its own
    assert Sweep(worlds=("track_2.yaml:start=0.5,0.0,0.0",)).worlds == (f"{tmp_path}/track_2.yaml:start=0.5,0.0,0.0",)


def test_a_yaml_manifest_names_a_sweep(tmp_path):
    path = tmp_path / "sweep.yaml"
    path.write_text("algos: [ddpg, sac]\nseeds: [0, 1, 2]\nset: [episodes=50]\n", encoding="utf-8")
    assert sweep_of(read_manifest(path)) == Sweep(algos=("ddpg", "sac"), seeds=(0, 1, 2), set=("episodes=50",))
    path.write_text("algorithms: [ddpg]", encoding="utf-8")
    with pytest.raises(ConfigError, match="keys of algos, rewards, worlds, seeds, preset, robot, set"):
        read_manifest(path)


def test_the_commands_options_prevail_over_the_manifest(tmp_path):
    manifest, out = tmp_path / "sweep.yaml", tmp_path / "sweep"
    manifest.write_text("algos: [ppo]\nseeds: [0, 1]\n", encoding="utf-8")
    tiny = f"--manifest {manifest} --worlds track_2 --set episodes=1 eval_episodes=1 task.episode.max_steps=5 --quiet"
    assert main(["sweep", *tiny.split(), "--out", str(out), "--seed", "3", "--seeds", "4"]) != 0 and not out.exists()
    assert main(["sweep", *tiny.split(), "--out", str(out), "--seed", "3"]) == 0
    assert [run.name for run in out.iterdir() if run.is_dir()] == ["ppo-fomt-track_2-seed3"]


def test_a_status_is_read_from_the_ends_of_the_logs(tmp_path):
    header = "episode,total_steps,wall_s,env,world,outcome,return,steps,epsilon\n"
    rows = [
        f"{k},{100 * k},{0.5 * k},0,w,{'success' if k > 990 else 'collision'},1.0,100,0.1\n" for k in range(1, 1001)
    ]
    (tmp_path / "episodes.csv").write_text(
        header + "".join(rows) + "1001,1001", encoding="utf-8"
    )  # the last is being written
    (tmp_path / "evaluations.csv").write_text("episode,success\n500,0.75\n1000,0.5\n", encoding="utf-8")
    now = status(tmp_path)
    assert (now.state, now.episode, now.success, now.best) == ("waiting", 1000, 0.5, 0.75)
    assert now.steps_per_s == pytest.approx(200)


def test_of_a_table_that_grows_only_whole_rows_are_read_and_of_its_end_only_those_within_it(tmp_path):
    table = tmp_path / "table.csv"
    table.write_text("episode,success\n1,0.25\n2,0.50\n3,0.60\n4,0.7", encoding="utf-8")  # the last was to be 0.75
    assert [row["success"] for row in read_rows(table)] == ["0.25", "0.50", "0.60"]
    assert read_rows(table, last_bytes=14) == [{"episode": "3", "success": "0.60"}]
    assert read_rows(tmp_path / "none.csv") == []


def test_a_presets_worlds_stay_unless_others_are_named(tmp_path, monkeypatch):
    several = TrainConfig(worlds=("big_track", "big_track", "track_3"))
    monkeypatch.setitem(TRAIN_PRESETS, "several", several)
    (kept,) = open_sweep(Sweep(preset="several"), tmp_path / "kept").items()
    assert kept[0].name == "ddpg-fomt-big_track+track_3-seed0"
    assert kept[1].worlds == several.worlds
    (named,) = open_sweep(Sweep(preset="several", worlds=("track_2",)), tmp_path / "named").values()
    assert named.worlds == ("track_2",)


def test_no_workers_are_refused_before_anything_is_written(tmp_path, capfd):
    assert main(["sweep", "--workers", "0", "--out", str(tmp_path / "sweep")]) == 2
    assert "at least 1 worker process, got 0" in capfd.readouterr().err and not (tmp_path / "sweep").exists()
