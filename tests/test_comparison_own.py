"""A comparison of the user's own drivers, runs and worlds: what has changed under its name is driven anew."""

import json
import shutil
from pathlib import Path

import pytest

from zebrat_bullet.cli.main import main
from zebrat_bullet.comparison.manifest import read_manifest
from zebrat_bullet.comparison.named import folder_name
from zebrat_bullet.comparison.policies import Place
from zebrat_bullet.comparison.steps import Judge, steps
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.world import generate_spec, write_spec

ROOT = Path(__file__).parent.parent
POLICIES = ROOT / "zebrat_bullet" / "policies"
DRIVER = """
from zebrat_bullet.types import Command


class Ahead:
    name, privileged = "ahead", frozenset()

    def __init__(self, task):
        pass

    def reset(self, seed):
        pass

    def act(self, reading):
        return Command(0.1, 0.0)
"""
OWN = """
trainings: {{}}
judgements:
  own:
    drivers: [{{method: mine, agent: "{agent}"}}]
    worlds: ["{world}"]
    episodes: 1
    options: [{options}]
budgets:
  all: {{about: all of it, seeds: [0], judgements: {{own: {{}}}}}}
"""


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    (tmp_path / "driver.py").write_text(DRIVER, encoding="utf-8")
    (tmp_path / "run").mkdir()
    shutil.copy(POLICIES / "shipped.safetensors", tmp_path / "run" / "best.safetensors")
    write_spec(generate_spec(3), tmp_path).rename(tmp_path / "track.yaml")
    return tmp_path


def written(folder: Path, agent: str = "random", world: str = "track_2", options: str = "--caster, embree") -> Path:
    path = folder / "manifest.yaml"
    path.write_text(OWN.format(agent=agent, world=world, options=options), encoding="utf-8")
    return path


def judged(folder: Path, agent: str = "random", world: str = "track_2") -> Judge:
    """The only judgement of a manifest, as if it had been driven."""
    manifest = read_manifest(written(folder, agent, world))
    (step,) = steps(Place(manifest=manifest, budget="all", out=folder / "out", checkout=ROOT))
    assert isinstance(step, Judge)
    step.command()
    (step.folder / "scores.json").write_text(json.dumps({world: {"episodes": 1}}), encoding="utf-8")
    assert step.is_done()
    return step


def test_a_driver_a_run_and_a_world_that_were_edited_are_driven_anew(mine: Path):
    by_code = judged(mine, agent=f"{mine}/driver.py:Ahead")
    (mine / "driver.py").write_text(DRIVER.replace("0.1", "0.2"), encoding="utf-8")
    assert not by_code.is_done()
    by_run = judged(mine, agent=str(mine / "run"))
    shutil.copy(POLICIES / "il.safetensors", mine / "run" / "best.safetensors")
    assert not by_run.is_done()
    placed = judged(mine, world=f"{mine}/track.yaml")
    write_spec(generate_spec(4), mine).rename(mine / "track.yaml")
    assert not placed.is_done()
    placed.command()
    assert not (placed.folder / "scores.json").exists()


def test_what_is_shipped_is_known_by_its_name_alone(mine: Path):
    """The keys of committed records hang on it."""
    for agent in ("dwa:inflation_radius_m=0.3", "shipped"):
        made_by = judged(mine, agent=agent).made_by()
        assert list(made_by) == ["agent", "sha256", "sim", "seed", "options", "set", "tracks", "starts"]
        assert bool(made_by["sha256"]) == (agent == "shipped")


def test_a_world_named_by_its_path_is_judged_in_a_folder_of_the_comparison(mine: Path):
    place = judged(mine, world=f"{mine}/track.yaml").folder
    assert place.parent == mine / "out" / "judged" / "own" / "random" and place.name.endswith("track.yaml")
    for above in ("..", ".", "../../elsewhere"):
        assert Path(folder_name(above)).name not in ("", ".", "..")
    manifest = written(mine)
    for alike in (f'{mine}/a/b.yaml", "{mine}/a-b.yaml', 'track_2", "track_2'):
        manifest.write_text(OWN.format(agent="random", world=alike, options=""), encoding="utf-8")
        with pytest.raises(ConfigError, match="would share"):
            steps(Place(manifest=read_manifest(manifest), budget="all", out=mine / "out", checkout=ROOT))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"world": "track_99"}, "judgements.own of the manifest cannot be driven: no worlds named 'track_99'"),
        ({"agent": "nope.py:Nope"}, "judgements.own of the manifest cannot be driven: no file nope.py"),
        ({"agent": "nobody"}, "judgements.own of the manifest cannot be driven: no agent 'nobody'"),
        (
            {"options": "--castr, embree"},
            "judgements.own of the manifest cannot be driven: unrecognized arguments: --castr",
        ),
        ({"options": "--set, task.lidar.rnge_max_m=4"}, "cannot set 'lidar.rnge_max_m=4'"),
        ({"options": "--caster, mujoco"}, "--caster mujoco casts its rays in MuJoCo"),
    ],
)
def test_a_judgement_of_what_there_is_not_is_refused_by_the_plan_before_anything_runs(
    mine: Path, wrong: dict[str, str], said: str, capfd: pytest.CaptureFixture[str]
):
    call = ["reproduce", "--manifest", str(written(mine, **wrong)), "--budget", "all", "--out", str(mine / "out")]
    assert main([*call, "--plan"]) == 2
    assert said in capfd.readouterr().err
    assert not (mine / "out").exists()


def test_a_set_that_there_is_not_and_a_driver_that_planar_cars_cannot_have_are_refused(
    mine: Path, capfd: pytest.CaptureFixture[str]
):
    on_sets = OWN.replace('worlds: ["{world}"]', 'sets: ["{world}"]\n    sim: planar').replace("[{options}]", "[]")
    path = mine / "manifest.yaml"
    for agent, name, said in (("shipped", "nowhere", "no worlds/sets named 'nowhere'"), ("dwa", "corners", "dwa")):
        path.write_text(on_sets.format(agent=agent, world=name), encoding="utf-8")
        assert main(["reproduce", "--manifest", str(path), "--budget", "all", "--plan", "--out", str(mine / "o")]) == 2
        assert said in capfd.readouterr().err
