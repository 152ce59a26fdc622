"""A driver of one's own out of a file: driven like any other, its mistakes told by file and line."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from zebrat_bullet.agents import code_or_weights, load_agent, trained_task
from zebrat_bullet.cli.main import main
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import AssetError, ConfigError
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.world import load_world

DRIVER = """from helper import HALF
from zebrat_bullet.types import Command


class HalfSpeed:
    name = "half-speed"
    privileged = frozenset()

    def __init__(self, task):
        self.speed_mps = HALF * task.physics.max_speed_mps

    def reset(self, seed):
        self.seed = seed

    def act(self, reading):
        return Command(self.speed_mps, 0.0)


def none(task):
    raise LookupError("no weights")
"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., str]:
    """Returns what writes the driver, a text in it replaced by another, and returns the path of its file."""
    (tmp_path / "helper.py").write_text("HALF = 0.5\n", encoding="utf-8")

    def written(old: str = "", new: str = "") -> str:
        assert old in DRIVER
        path = tmp_path / "mine.py"
        path.write_text(DRIVER.replace(old, new, 1) if old else DRIVER, encoding="utf-8")
        return str(path)

    return written


def test_it_is_judged_in_processes_of_its_own_and_recorded_under_its_name(write, tmp_path: Path, capfd) -> None:
    agent = f"{write()}:HalfSpeed"
    assert trained_task(agent) is None
    where = ["--worlds", "track_2", "--episodes", "2", "--workers", "2", "--caster", "embree", "--quiet"]
    assert main(["evaluate", "--agent", agent, *where, "--out", str(tmp_path / "out"), "--json"]) == 0
    scores = json.loads(capfd.readouterr().out)["track_2"]
    assert (scores["collision"], scores["episodes"]) == (1.0, 2)
    drive = Drive(TaskConfig(), load_world("track_2"))
    record = run_episode(drive, load_agent(agent, TaskConfig()), 0, 0)
    drive.close()
    assert record.command[:, 0] == pytest.approx(0.3) and record.agent == "half-speed"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("self.seed = seed", "1 / 0", r"mine\.py, line 13: reset fails: ZeroDivisionError: division by zero"),
        ("Command(self.speed_mps, 0.0)", "self.speed", r"mine\.py, line 16: act fails: AttributeError"),
        ("Command(self.speed_mps, 0.0)", "0.3, 0.0", r"act returned \(0\.3, 0\.0\); return a Command"),
        ("return Command(self.speed_mps, 0.0)", "pass", "act returned None; return a Command"),
        ("class HalfSpeed:", "class HalfSpeed", r"mine\.py, line 5: the file fails: SyntaxError"),
        ("helper", "no_such_helper", r"mine\.py, line 1: the file fails: ModuleNotFoundError"),
        ('    name = "half-speed"\n', "", r"HalfSpeed has no name; an agent has name, privileged"),
        ("frozenset()", '"pose"', "privileged is pose; it is a set of goal, map, pose, waypoint"),
        ("from helper", "import sys; sys.exit(3)\nfrom helper", r"mine\.py, line 1: the file fails: SystemExit: 3"),
        (
            "privileged = frozenset()",
            "privileged = property(lambda self: 1 / 0)",
            r"line 7: the agent fails: ZeroDivisionError",
        ),
        ("frozenset()", '{"gps"}', "it is a set of goal, map, pose, waypoint"),
        *(
            (
                "self.speed_mps, 0.0",
                given,
                r"mine\.py:HalfSpeed: act returned .*speed and steering angle are finite numbers",
            )
            for given in ('"fast", 0.0', "[0.3], 0.0", "float('nan'), 0.0", "0.3, __import__('numpy').array([0.0])")
        ),
        (
            "return Command(",
            "reading.scan.ranges_m[:] = 3.0; return Command(",
            r"mine\.py, line 16: act fails: ValueError: .*read-only; compute on a copy of what it is given",
        ),
    ],
)
def test_its_mistakes_are_told_by_file_and_line(write, old: str, new: str, said: str) -> None:
    drive = Drive(TaskConfig(), load_world("track_2"))
    with pytest.raises(ConfigError, match=said):
        run_episode(drive, load_agent(f"{write(old, new)}:HalfSpeed", TaskConfig()), 0, 0)
    drive.close()


def test_a_factory_that_fails_and_names_that_there_are_not_are_refused(write) -> None:
    file = write()
    with pytest.raises(ConfigError, match=r"mine\.py, line 20: none\(task\) fails: LookupError: no weights"):
        load_agent(f"{file}:none", TaskConfig())
    for name in (":FullSpeed", ""):
        with pytest.raises(AssetError, match=r"there are HalfSpeed, none: --agent .*mine\.py:NAME"):
            load_agent(file + name, TaskConfig())
    with pytest.raises(AssetError, match=r"no file .*yours\.py, named by --agent .*; it is FILE\.py:NAME"):
        load_agent(file.replace("mine", "yours") + ":HalfSpeed", TaskConfig())
    with pytest.raises(AssetError, match=r"or a driver of your own, FILE\.py:NAME"):
        load_agent("half-speed", TaskConfig())


def test_two_drivers_of_one_name_have_each_its_own_neighbours_and_records(write, tmp_path: Path, capfd) -> None:
    agents = []
    for share in (0.5, 0.25):
        folder = tmp_path / f"version-{share}"
        folder.mkdir()
        (folder / "helper.py").write_text(f"HALF = {share}\n", encoding="utf-8")
        (folder / "mine.py").write_text(Path(write()).read_text(encoding="utf-8"), encoding="utf-8")
        agents.append(f"{folder / 'mine.py'}:HalfSpeed")
    made = [load_agent(agent, TaskConfig()) for agent in agents]
    assert [agent.act(None).speed_mps for agent in made] == pytest.approx([0.3, 0.15])
    assert "helper" not in sys.modules and not any(str(tmp_path) in place for place in sys.path)
    where = ["--worlds", "track_2", "--episodes", "1", "--workers", "1", "--caster", "embree", "--quiet"]
    assert main(["evaluate", "--agent", *agents, *where, "--out", str(tmp_path / "out"), "--json"]) == 0
    assert list(json.loads(capfd.readouterr().out)) == agents
    assert len(list((tmp_path / "out").glob("*/scores.json"))) == 2


def test_a_driver_counts_as_another_when_its_own_digest_changes(write) -> None:
    one = code_or_weights(load_agent(f"{write()}:HalfSpeed", TaskConfig()))
    with_weights = "privileged = frozenset()", "privileged = frozenset()\n    digest = str(HALF)"
    path = Path(write(*with_weights))
    at_half = code_or_weights(load_agent(f"{path}:HalfSpeed", TaskConfig()))
    assert len({one, at_half}) == 2
    path.with_name("helper.py").write_text("HALF = 0.25\n", encoding="utf-8")
    assert code_or_weights(load_agent(f"{path}:HalfSpeed", TaskConfig())) != at_half
