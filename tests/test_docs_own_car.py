"""The example in docs/your_own_car.md does what the page says."""

import json
import re
from pathlib import Path

import pytest

from zebrat_bullet.cli import main

PAGE = (Path(__file__).parent.parent / "docs" / "your_own_car.md").read_text(encoding="utf-8")


def block(kind: str) -> str:
    match = re.search(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)
    assert match
    return match[1]


@pytest.mark.timeout(900)  # a dozen commands, processes of their own: over 300 s beside other work
def test_the_example_is_refused_then_named_then_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("buggy.urdf").write_text(block("xml"), encoding="utf-8")
    assert main(["robots", "buggy.urdf", "--json"]) == 1
    refused = capfd.readouterr().err
    roles = dict(line.split(": ") for line in block("yaml").splitlines())
    for role in ("left_steering_hinge_joint", "right_front_wheel_joint", "lidar_mount"):
        assert f"'{role}={roles[role]}'" in refused
    Path("buggy.roles.yaml").write_text(block("yaml"), encoding="utf-8")
    commands = [line.split()[1:] for line in block("sh").splitlines()]
    assert main([*commands[0], "--json"]) == 0 and Path("buggy.png").is_file()
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["buggy"]["wheelbase_m"] == pytest.approx(0.34)
    assert main([*commands[1], "--json", "--caster", "embree"]) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["track_2"]["success"] == 1.0
