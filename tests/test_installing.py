"""What an installation takes: the tested versions lie within the ranges, and a Python that does not fit is refused."""

import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def constraints() -> list[Requirement]:
    lines = (ROOT / "scripts" / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return [Requirement(line) for line in lines if line and not line.startswith("#")]


def ranges() -> list[Requirement]:
    """The project's libraries and its extras' ones, without ROS, which is pinned there, and without itself."""
    lists = [
        PROJECT["dependencies"],
        *(lines for extra, lines in PROJECT["optional-dependencies"].items() if extra != "ros"),
    ]
    wanted = [Requirement(line) for lines in lists for line in lines]
    return [requirement for requirement in wanted if canonicalize_name(requirement.name) != PROJECT["name"]]


def test_constraints_name_each_library_once_with_one_version():
    pins = constraints()
    names = [canonicalize_name(pin.name) for pin in pins]
    assert len(names) == len(set(names))
    for pin in pins:
        assert [specifier.operator for specifier in pin.specifier] == ["=="], pin


@pytest.mark.parametrize("requirement", ranges(), ids=lambda requirement: requirement.name)
def test_tested_version_lies_in_the_range(requirement: Requirement):
    pins = {canonicalize_name(pin.name): next(iter(pin.specifier)).version for pin in constraints()}
    assert requirement.specifier.contains(pins[canonicalize_name(requirement.name)])


def test_nobody_is_forced_to_one_version():
    assert [str(wanted) for wanted in ranges() if any(part.operator == "==" for part in wanted.specifier)] == []


def setup_with(python: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Runs a copy of scripts/setup in `folder` with a Python that it is to refuse, before it installs anything."""
    shutil.copytree(ROOT / "scripts", folder / "scripts")
    shutil.copy(ROOT / "pyproject.toml", folder)
    environment = {**os.environ, "PYTHON": python}
    return subprocess.run(["scripts/setup"], cwd=folder, env=environment, capture_output=True, text=True, timeout=60)


def test_setup_refuses_an_old_python(tmp_path):
    old = tmp_path / "old_python"
    old.write_text("#!/bin/sh\necho 3.10\n", encoding="utf-8")
    old.chmod(0o755)
    done = setup_with(str(old), tmp_path)
    assert done.returncode == 1
    assert "3.11, 3.12 or 3.13 is needed" in done.stderr and f"{old} (3.10)" in done.stderr
    assert not (tmp_path / ".venv").exists()


def test_setup_refuses_a_python_that_does_not_run(tmp_path):
    stand_in = tmp_path / "python3.12"
    stand_in.write_text("#!/bin/sh\nexit 127\n", encoding="utf-8")
    stand_in.chmod(0o755)
    done = setup_with(str(stand_in), tmp_path)
    assert done.returncode == 1 and f"{stand_in} (does not run)" in done.stderr
