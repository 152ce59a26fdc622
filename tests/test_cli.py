"""The command line as a user meets it: one JSON object last, everything else on stderr, errors that say what to do."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from zebrat_bullet.assets import find_asset
from zebrat_bullet.cli.main import main, make_parser
from zebrat_bullet.cli.recording import BAG_OPTIONS
from zebrat_bullet.evaluation.records import load_record
from zebrat_bullet.training.sweep_run import claim

ZEBRAT = Path(sys.executable).parent / "zebrat"


def zebrat(*arguments: object, check: bool = True, cwd: Path | None = None) -> subprocess.CompletedProcess:
    return subprocess.run([ZEBRAT, *map(str, arguments)], capture_output=True, text=True, check=check, cwd=cwd)


def result(*arguments: object) -> dict:
    done = zebrat(*arguments, "--json")
    assert len(done.stdout.splitlines()) == 1, done.stdout
    return json.loads(done.stdout)


def test_evaluate_prints_the_agreed_json_and_its_records_replay(tmp_path):
    answer = result("evaluate", "--agent", "random", "--worlds", "track_2", "--episodes", 3, "--out", tmp_path)
    world = answer["track_2"]
    assert {"success", "collision", "fail", "success_ci", "time_s", "episodes", "caster", "seed"} <= set(world)
    assert world["success"] + world["collision"] + world["fail"] == pytest.approx(1.0)
    assert world["caster"] == "bullet" and world["episodes"] == 3 and world["seed"] == 0
    assert json.loads((tmp_path / "scores.json").read_text(encoding="utf-8")) == answer
    assert "| track_2 |" in (tmp_path / "table.md").read_text(encoding="utf-8")
    replayed = result("replay", tmp_path / "records" / "track_2" / "episode_0001.npz")
    assert replayed["exact"] is True


def test_several_agents_are_judged_on_the_same_episodes_and_compared(tmp_path):
    agents = ("random", "dwa:inflation_radius_m=0.3")
    answer = result("evaluate", "--agent", *agents, "--worlds", "track_2", "--episodes", 1, "--out", tmp_path)
    assert list(answer) == list(agents) and answer["random"]["track_2"]["episodes"] == 1
    table = (tmp_path / "comparison.md").read_text(encoding="utf-8")
    assert "| dwa:inflation_radius_m=0.3 | goal, map, pose | 100%, " in table and "| random | - | 0% |" in table
    assert "| least possible | | 15.3 |" in table
    poses = [load_record(path).pose[0] for path in sorted(tmp_path.glob("*/records/track_2/episode_0000.npz"))]
    assert len(poses) == 2 and (poses[0] == poses[1]).all()


def test_train_writes_a_run_that_evaluate_accepts(tmp_path):
    learner = ("learner.hidden=[16,16]", "learner.warmup_steps=20", "learner.batch_size=16")
    settings = ("episodes=3", "eval_every=2", "eval_episodes=1", *learner)
    run = tmp_path / "run"
    answer = result("train", "--worlds", "track_2", "--out", run, "--quiet", "--set", *settings)
    assert answer["episodes"] == 3 and (run / "learning_curve.png").stat().st_size > 10_000
    judged = result("evaluate", "--agent", run, "--worlds", "track_2", "--episodes", 1, "--out", tmp_path / "judged")
    assert judged["track_2"]["episodes"] == 1


def test_a_run_that_another_process_trains_is_left_alone(tmp_path):
    (tmp_path / "config.json").write_text("{}", encoding="utf-8")
    with claim(tmp_path):
        done = zebrat("train", "--resume", "--out", tmp_path, check=False)
    assert done.returncode == 2 and "another process is training in" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["config.json", "lock"]


def test_robots_are_listed_with_what_their_urdf_says_and_drawn(tmp_path):
    answer = result("robots", "--draw", "--out", tmp_path / "robots.png")
    assert list(answer) == ["hexagon", "long", "zebrat"] and answer["hexagon"]["corners"] == 6
    zebrat_says = answer["zebrat"]
    assert (zebrat_says["length_m"], zebrat_says["width_m"], zebrat_says["bearings"]) == (1.0, 0.6, 32)
    assert round(zebrat_says["turning_radius_m"], 3) == 0.819 and zebrat_says["lidar_m"] == [0.4, 0.0, 0.75]
    assert (tmp_path / "robots.png").stat().st_size > 10_000


def test_bench_times_planar_cars_beside_pybullet():
    answer = result("bench", "--planar", "--steps", 40, "--rounds", 1, "--cars", 24)
    assert answer["planar"]["n_cars"] == 24 and answer["planar"]["device"] == "cpu"
    assert answer["planar"]["steps_per_s"] > answer["embree"]["steps_per_s"] > 0 < answer["bullet"]["steps_per_s"]
    assert all(answer["planar"][f"{part}_us"] > 0 for part in ("drive", "look", "resets", "rest"))
    assert answer["hardware"]["cores"] >= 1


def test_bench_splits_the_step_for_both_casters():
    every, region = (
        result("bench", "--steps", 20, "--world", "track_2", "--bearings", bearings) for bearings in ("all", "region")
    )
    for answer in (every, region):
        assert set(answer) == {"embree", "bullet"}
        for part in answer.values():
            assert part["steps_per_s"] > 0 and part["rtf"] == pytest.approx(0.2 * part["steps_per_s"])
            assert min(part["full_ms"], part["bare_rays_ms"], part["rays_ms"]) > 0
    for name in ("bare_rays_ms", "rays_ms"):  # a tenth of the rays: not even beside other work as slow as all of them
        assert region["bullet"][name] < every["bullet"][name]


def test_worlds_lists_and_draws(tmp_path):
    answer = result("worlds", "track_1", "track_6", "--draw", "--out", tmp_path / "worlds.png")
    assert set(answer) == {"track_1", "track_6"}
    assert (tmp_path / "worlds.png").stat().st_size > 10_000


def test_worlds_writes_generated_tracks_that_load_by_path_and_draws_them(tmp_path):
    chosen = ("--family", "niches", "deadends", "--seed", 900_007, "--difficulty", 0.3)
    answer = result("worlds", "--generate", 2, *chosen, "--draw", "--out", tmp_path)
    names = ["niches-900007", "niches-900008", "deadends-900007", "deadends-900008"]
    assert list(answer) == names and (tmp_path / "worlds.png").stat().st_size > 10_000
    again = result("worlds", *(tmp_path / f"{name}.yaml" for name in names))
    assert again == answer


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("worlds", "--generate", "1", "--family", "ring"), "no family of tracks 'ring': name one of mixed,"),
        (("worlds", "--generate", "1", "--difficulty", "1.5"), "difficulty must be 0 (easy) to 1 (hard), got 1.5"),
        (("worlds", "--generate", "0"), "at least 1 world"),
        (("worlds", "track_1", "--generate", "1"), "takes no names"),
        (("worlds", "--family", "boxes"), "add --generate N"),
        (("worlds", "track_2", "--out", "x.png"), "--out x.png names the picture that --draw makes; add --draw"),
        (("robots", "--out", "x.png"), "--out x.png names the picture that --draw makes; add --draw"),
        (("evaluate", "--agent", "nobody"), "no agent 'nobody': name one of"),
        (("evaluate", "--agent", "random", "--worlds", "nowhere"), "nowhere"),
        (("evaluate", "--agent", "random", "--episodes", "0"), "episodes must be at least 1"),
        (("evaluate", "--agent", "random", "--worlds", "real_1", "track_2", "real_1"), "real_1 is named twice"),
        (("evaluate", "--agent", "random", "--worlds", "real_1", "--tracks", "3"), "--tracks goes with --set NAME"),
        (("evaluate", "--agent", "il", "--worlds", "real_1", "--set", "corners"), "give one of them"),
        (("evaluate", "--agent", "teb:"), "no setting stands behind teb:; write teb, or teb:KEY=VALUE"),
        (("evaluate", "--agent", "shipped:foo=1"), "the policy 'shipped' has no settings, got shipped:foo=1"),
        (("demonstrate", "--families", "ring", "--episodes", "7"), "--families, --episodes goes with --generated N"),
        (("imitate", "--demonstrations", "nowhere"), "there is no nowhere; name the folder"),
        (("train", "--set", "bach_size=3", "--out", "/nonexistent/x"), "cannot set 'bach_size=3'"),
        (("train", "--resume", "--out", "/nonexistent/x"), "holds no training run"),
        (("train", "--resume", "--preset", "quick", "--set", "a=3", "--out", "/no"), "--preset, --set cannot change"),
        (("train", "--resume", "--seed", "3", "--preset", "quick"), "runs/quick-seed3 holds no training run"),
        (("train", "--resume", "--seed", "0", "--out", "/no"), "so --seed cannot change"),  # be it the default
        (("ros", "drive", "--world", "track_3", "--policy", "x"), "--world is for `zebrat ros sim`"),
        (("ros", "sim", "--policy", "x"), "--policy is for `zebrat ros drive`"),
        (("replay", "/nonexistent/x.npz"), "no such file; correct its name"),
        (
            ("evaluate", "--agent", "random", "--robot", "cars/x.urdf"),
            "if the car's file has moved, --robot says where it lies",
        ),
        (("replay", "x.npz", "--agent", "a", "--lidar-topic", "/b"), "--agent, --lidar-topic can only be heeded with"),
        (("replay", "x.npz", "--tolerance", "1", "1", "--delay", "1"), "--delay, --tolerance can only be heeded with"),
    ],
)
def test_a_users_mistake_is_one_line_that_says_what_to_do(arguments, message, tmp_path):
    done = zebrat(*arguments, check=False, cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert message in done.stderr and "Traceback" not in done.stderr


def test_every_option_that_goes_with_a_bag_is_refused_with_a_record():
    options, of_others = (vars(make_parser().parse_args([command])).keys() for command in ("replay", "robots"))
    assert options - of_others == {"record", "bag", *BAG_OPTIONS}


@pytest.mark.parametrize("sigma", ["-1", "nan", "101"])
@pytest.mark.parametrize("command", ["video", "record", "demonstrate"])
def test_noise_that_is_none_is_refused_by_its_name(command, sigma, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main([command, "--agent", "random", "--action-noise", sigma, "--quiet"]) == 2
    assert f"{command}: action_noise must be 0 to 100, got {float(sigma)}" in capfd.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", ["-1", "1.5", "9" * 19, "two"])
@pytest.mark.parametrize(
    "command", [["ros", "sim", "--episode"], ["record", "--episode"], ["video", "--episode"], ["sets", "--seed"]]
)
def test_the_number_of_an_episode_is_a_whole_number_from_0_up(command, number, capfd):
    with pytest.raises(SystemExit) as ended:
        main([*command, number])
    assert ended.value.code == 2
    said = capfd.readouterr().err.splitlines()[-1]
    assert f"argument {command[-1]}: takes a whole number from 0 up, of at most 18 digits, got '{number}'" in said


@pytest.mark.parametrize("command", [["curves", "runs/a"], ["imitate"], ["report"], ["reproduce"]])
def test_a_command_that_takes_no_car_refuses_one(command, capfd):
    with pytest.raises(SystemExit):
        main([*command, "--robot", "mule"])
    assert "unrecognized arguments: --robot mule" in capfd.readouterr().err


@pytest.mark.parametrize("where", [["--worlds", "real_1"], []])
def test_planar_cars_asked_for_where_they_do_not_drive_are_refused(where, capfd, tmp_path):
    assert main(["evaluate", "--agent", "shipped", "--sim", "planar", *where, "--out", str(tmp_path)]) == 2
    said = capfd.readouterr().err.splitlines()
    assert len(said) == 1 and "planar cars drive --set NAME or --generated N, not --worlds" in said[0]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "command",
    [
        ["evaluate", "--agent", "shipped", "--worlds", "real_1"],
        ["evaluate", "--agent", "shipped", "random", "--worlds", "real_1"],
        ["evaluate", "--agent", "shipped", "--generated", "1"],
        ["evaluate", "--agent", "shipped", "--set", "niches", "--tracks", "1"],
        ["video", "--world", "real_1"],
        ["width", "--agent", "shipped"],
        ["robustness", "--agent", "shipped", "--axes", "mass=1.3", "--worlds", "real_1", "--episodes", "1"],
    ],
)
@pytest.mark.parametrize(
    ("engine", "caster", "said"),
    [
        ("bullet", "mujoco", "--caster mujoco casts its rays in MuJoCo, but PyBullet drives; give --caster bullet or "),
        ("mujoco", "bullet", "--caster bullet casts its rays in PyBullet, but MuJoCo drives; give --caster mujoco or "),
    ],
)
def test_the_caster_of_another_engine_is_refused_at_once(command, engine, caster, said, capfd, tmp_path):
    pytest.importorskip("mujoco")
    assert main([*command, "--sim", engine, "--caster", caster, "--out", str(tmp_path / "out")]) == 2
    told = capfd.readouterr().err.splitlines()
    assert len(told) == 1 and f"{said}embree, or --sim {caster}" in told[0]
    assert not list(tmp_path.iterdir())


def test_a_caster_that_settings_fit_the_engine_to_is_taken(tmp_path, capfd):
    pytest.importorskip("mujoco")
    settings = ["task.physics.engine=mujoco", "task.episode.max_steps=2"]
    common = ["evaluate", "--agent", "shipped", "--worlds", "real_1", "--episodes", "1", "--workers", "1"]
    assert main([*common, "--caster", "mujoco", "--set", *settings, "--out", str(tmp_path), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["real_1"]["engine"] == "mujoco"
    assert main([*common, "--caster", "bullet", "--set", *settings, "--out", str(tmp_path)]) == 2
    assert "--caster bullet casts its rays in PyBullet, but MuJoCo drives" in capfd.readouterr().err


def test_what_slips_through_is_one_line_that_calls_it_our_bug_and_debug_shows_where(monkeypatch, capsys):
    def fail(*arguments):
        raise RuntimeError("odd\nthing")

    monkeypatch.setattr("zebrat_bullet.assets.list_assets", fail)
    assert main(["sets"]) == 3
    said = capsys.readouterr()
    assert said.err.startswith("zebrat sets: this is a bug of ours: RuntimeError: odd thing; run it again with --debug")
    assert len(said.err.splitlines()) == 1 and not said.out
    with pytest.raises(RuntimeError, match="odd"):
        main(["sets", "--debug"])


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["worlds", "track_2", "--draw", "--out", "/proc/none/x.png"], "worlds: cannot be written: No such file"),
        (["worlds", "track_2", "--draw", "--out", "x.xyz"], "x.xyz is to be a picture: end it in .png, .svg"),
        (["robots", "--draw", "--out", "cars"], "cars is to be a picture: end it in .png, .svg"),
        (["video", "--agent", "oracle", "--out", "drive.avi"], "a video's name ends in .mp4, got 'drive.avi'"),
        (["worlds", "track_2", "--map", __file__], "worlds: cannot be written: File exists"),
        (["teleop", "--world", "none", "--out", __file__], "is a file; name a folder, which keeps an episode each"),
    ],
)
def test_what_cannot_be_written_is_told_as_the_users_to_mend(command, said, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main([*command, "--quiet"]) == 2
    assert said in capfd.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (FileNotFoundError(2, "No such file", "/somewhere/else.json"), 3),
        (FileNotFoundError(2, "No such file", "here/scores.json"), 3),  # we should have written it
        (PermissionError(13, "Permission denied", "/somewhere/else.json"), 3),
        (PermissionError(13, "Permission denied", "here/scores.json"), 2),
        (PermissionError(13, "Permission denied", ".here.0a1b2c3d.part"), 2),  # before it gets its name
        (PermissionError(13, "Permission denied", ".other.0a1b2c3d.part"), 3),
        (PermissionError(13, "Permission denied", "here.yaml"), 3),
        (FileNotFoundError(2, "No such file", "here.part"), 3),
        (OSError(28, "No space left on device"), 2),
    ],
)
def test_what_is_missing_inside_is_still_our_bug(error, status, tmp_path, monkeypatch, capfd):
    def fail(*arguments):
        raise error

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("zebrat_bullet.assets.list_assets", fail)
    assert main(["sets", "--out", "here"]) == status
    said = capfd.readouterr().err
    assert ("this is a bug of ours" if status == 3 else "sets: cannot be written: ") in said


def test_what_is_wrong_with_a_car_that_is_listed_is_said_of_that_car(tmp_path, capfd):
    (tmp_path / "mine.urdf").write_text(
        find_asset("urdf", "zebrat", ".urdf").read_text(encoding="utf-8"), encoding="utf-8"
    )
    assert main(["robots", str(tmp_path / "mine.urdf"), "--joints", "wheel_radius_m=-1"]) == 1
    assert "mine.urdf: wheel_radius_m is" in capfd.readouterr().err


@pytest.mark.parametrize("degrees", ["361", "-359"])
def test_a_start_of_more_than_a_turn_is_in_degrees_all_the_same(degrees, capfd):
    assert main(["worlds", "track_2", "--start", "1.5", "0", degrees]) == 0, capfd.readouterr().err


def test_a_reader_that_is_gone_costs_nothing_and_a_full_or_closed_output_is_told(tmp_path):
    def shell(command: str) -> subprocess.CompletedProcess:
        call = f"set -o pipefail; {sys.executable} -m zebrat_bullet worlds track_2 {command}"
        return subprocess.run(["bash", "-c", call], capture_output=True, text=True)

    for command in ("--json | true", ">&-"):
        done = shell(command)
        assert (done.returncode, done.stdout) == (0, "") and "Traceback" not in done.stderr
    full = shell("> /dev/full")
    assert full.returncode == 2
    assert full.stderr.splitlines()[-1] == ("zebrat worlds: standard output cannot be written: No space left on device")


def test_a_locale_that_lacks_a_letter_costs_no_result(tmp_path):
    text = Path(__file__).parent.parent.joinpath("worlds/track_2.yaml").read_text(encoding="utf-8")
    world = tmp_path / "mine.yaml"
    world.write_text(re.sub("^description: .*$", "description: Größer", text, flags=re.MULTILINE), encoding="utf-8")
    ascii_alone = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    done = subprocess.run([ZEBRAT, "worlds", world], capture_output=True, text=True, env=os.environ | ascii_alone)
    assert done.returncode == 0, done.stderr
    assert r"Gr\xf6\xdfer" in done.stdout


def test_what_lies_in_a_checkout_alone_is_named_as_such_where_there_is_none(tmp_path):
    for command, option in (("report", "records"), ("imitate", "demonstrations")):
        done = zebrat(command, check=False, cwd=tmp_path)
        assert done.returncode == 2
        assert f"of a checkout is not here; run it in a checkout, or name another with --{option}" in done.stderr
