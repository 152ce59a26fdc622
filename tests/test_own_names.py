"""Worlds are told apart by their folders, and checked with the car that drives them, by every command and the env."""

import json
import math
from dataclasses import replace
from pathlib import Path

import gymnasium
import pytest

import zebrat_bullet  # noqa: F401 (registers the env ids)
from zebrat_bullet.cli import main
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.detection.places import load_place
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.evaluation.judge import Judgement, judge
from zebrat_bullet.pytest_plugin import _Cache
from zebrat_bullet.report.tables import score_table
from zebrat_bullet.robot import load_robot
from zebrat_bullet.training.presets import TRAIN_PRESETS
from zebrat_bullet.training.run import train
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import load_world, parse_reference, unique_names, world_labels

# The car of 1.8 m would stand in the wall behind it.
SHORT = "name: short\nsegments: [{straight: 5, width: 1.5}]\nstart: {at_m: 0.8, range_x_m: 0.1, range_y_m: 0}\n"


@pytest.fixture
def short(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT, encoding="utf-8")
    return path


@pytest.fixture
def twins(tmp_path: Path) -> list[Path]:
    """Two files of one name in two folders, one 4 m and one 5 m long."""
    paths = []
    for folder, length in (("left", 4), ("right", 5)):
        (tmp_path / folder).mkdir()
        paths.append(tmp_path / folder / "map.yaml")
        paths[-1].write_text(f"name: map\nsegments: [{{straight: {length}, width: 1.5}}]\n", encoding="utf-8")
    return paths


def test_two_worlds_of_one_name_stay_two(twins: list[Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    names = [str(path) for path in twins]
    assert main(["worlds", *names, "--json", "--quiet", "--map", str(tmp_path / "maps")]) == 0
    listed = json.loads(capfd.readouterr().out)
    assert [(name, at["length_m"]) for name, at in listed.items()] == [("left/map", 2.5), ("right/map", 3.5)]
    assert (tmp_path / "maps" / "left" / "map.yaml").is_file() and (tmp_path / "maps" / "right" / "map.yaml").is_file()
    what = Judgement(agent="random", worlds=tuple(names), episodes=1, workers=1, task=TaskConfig(), records=tmp_path)
    assert list(judge(what)) == names
    assert {path.parent.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.npz")} == {
        "left/map",
        "right/map",
    }


def test_names_are_told_apart_by_as_many_folders_as_it_takes() -> None:
    assert unique_names(["map", "map", "else"], ["/a/x/map.yaml", "/b/x/map.yaml", "/a/else.yaml"]) == [
        "a/x/map",
        "b/x/map",
        "else",
    ]
    assert unique_names(["map", "map"], ["/a/m.yaml", "/a/n.yaml"]) == ["map-1", "map-2"]
    assert world_labels(["track_2", "/a/map.yaml:goal=1,2", "track_2"]) == {
        "track_2": "track_2",
        "/a/map.yaml:goal=1,2": "map",
    }


def test_a_reference_reads_as_it_is_written() -> None:
    text = "maps/a b.yaml:start=1.0,-2.5,90.0:goal=3.0,4.0"
    assert str(parse_reference(text)) == text
    world = load_world("track_2:start=1.5,0.1,3")
    assert world.start.pose == Pose2(1.5, 0.1, math.radians(3.0)) and world.source == "track_2:start=1.5,0.1,3.0"
    for wrong in ("track_2:start=1,2", "track_2:start=a,b,c", "track_2:goal=nan,0", "track_2:exit=0,0,1,1"):
        with pytest.raises(WorldError, match=r"start: takes|goal: takes|exit: only a mesh"):
            load_world(wrong)


@pytest.mark.parametrize(
    ("behind", "wrong"),
    [
        ("start=1.5,0,0:gola=5,0", "'gola=5,0'"),
        ("goal=7,0:foo", "'foo'"),
        ("goal=7,0:exit", "'exit'"),
        ("goal=7,0:", "''"),
        ("start=1.5,0,0:start=2,0,0", "'start=2,0,0' again"),
    ],
)
def test_what_is_said_of_a_world_besides_its_places_is_refused(behind: str, wrong: str) -> None:
    with pytest.raises(WorldError, match=f"is start=, goal= and exit=, each once, got {wrong}; correct it"):
        parse_reference(f"my_track.yaml:{behind}")


@pytest.mark.parametrize("name", ["a:b.yaml", "C:/maps/a.yaml", "gola=5,0:a.yaml"])
def test_a_worlds_name_may_have_colons(name: str) -> None:
    assert parse_reference(name).name == name
    reference = parse_reference(f"{name}:goal=3,4:start=1,2,3")
    assert (reference.name, reference.goal, reference.start) == (name, (3.0, 4.0), (1.0, 2.0, 3.0))


def test_every_way_in_checks_a_world_with_the_car_that_drives_it(
    short: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["worlds", str(short), "--quiet"]) == 0
    monkeypatch.chdir(tmp_path)
    for command in (
        ["worlds", str(short)],
        ["evaluate", "--agent", "random", "--worlds", str(short)],
        ["video", "--agent", "random", "--world", str(short)],
        ["teleop", "--world", str(short), "--port", "0"],
        ["collisions", "--drivers", "random", "--worlds", str(short)],
        ["bench", "--world", str(short)],
        ["bench", "--agent", "random", "--world", str(short)],
        ["bench", "--learning", "paper", "--world", str(short)],
    ):
        assert main([*command, "--robot", "long", "--quiet"]) == 2, command
        assert "short.yaml: start: at (0.80, 0.00)" in capfd.readouterr().err
    task = TaskConfig(robot="long")
    with pytest.raises(WorldError, match=r"short\.yaml: start"):
        train(replace(TRAIN_PRESETS["quick"], worlds=(str(short),), task=task), tmp_path / "run")
    with pytest.raises(WorldError, match=r"short\.yaml: start"):
        gymnasium.make("ZebraT/BigTrack-v0", world=short, task=task)
    with pytest.raises(WorldError, match=r"short\.yaml: start"):
        PlanarVectorEnv(1, short, task=task)
    with pytest.raises(WorldError, match=r"short\.yaml: start"):
        load_place(str(short), "long")
    checked = _Cache()  # of the pytest plugin's fixture
    with pytest.raises(WorldError, match=r"short\.yaml: start"):
        checked.world(short, "long")
    assert checked.world(short, "zebrat").name == checked.world(f"{short}:start=1.0,0.0,0.0", "long").name == "short"
    assert load_world(short, robot=load_robot("zebrat")).name == load_place(str(short)).name == "short"


def test_another_car_has_no_share_in_the_certified_times(short: Path, tmp_path: Path) -> None:
    what = Judgement(agent="random", worlds=("track_2",), episodes=1, workers=1, task=TaskConfig(robot="hexagon"))
    scores = judge(what)
    rows = {certified: score_table(scores, certified).splitlines()[-1].split("|") for certified in (True, False)}
    assert float(rows[True][7]) > 5 and rows[False][7].strip() == "-"
    own = score_table({"h|<b>.yaml": scores["track_2"]}).splitlines()[-1]
    assert own.startswith(r"| h\|<b>.yaml | ")  # its bar begins no other cell


def test_what_there_is_of_a_refused_world_is_drawn(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.yaml").write_text(SHORT.replace("0.8", "0.3"), encoding="utf-8")
    picture = tmp_path / "bad.png"
    assert main(["worlds", str(tmp_path / "bad.yaml"), "--draw", "--out", str(picture)]) == 2
    said = capfd.readouterr().err
    assert picture.stat().st_size > 5000 and f"drew what there is of the worlds that are refused: {picture}" in said
    x, y, degrees = said.partition("--start ")[2].partition(";")[0].split()
    assert main(["worlds", str(tmp_path / "bad.yaml"), "--quiet", "--start", x, y, degrees]) == 0
    both = [str(tmp_path / "bad.yaml"), "track_2"]
    assert main(["worlds", *both, "--draw", "--out", str(tmp_path / "both.png"), "--quiet"]) == 2
    assert (tmp_path / "both.png").is_file() and (tmp_path / "both-refused.png").is_file()


@pytest.mark.parametrize("wrong", [[], [3], None])
def test_what_is_no_world_is_refused_in_our_words(wrong: object) -> None:
    with pytest.raises(ConfigError, match="a world is a name"):
        gymnasium.make("ZebraT/BigTrack-v0", world=wrong)
