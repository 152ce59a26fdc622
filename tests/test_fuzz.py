"""Spoiled files of fixed seeds: each is taken, or refused by an error of ours that names it; nothing else comes out."""

from pathlib import Path

import pytest
from fuzz import DOORS, attack

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import read_yaml

FEW = {"state": 4, "arrays": 4, "networks": 4, "init": 4, "archive": 6}
"""How many of the doors that build a learner; of the others `MANY`."""
MANY = 12


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[object, Path]:
    """Return a good folder of each kind, made once."""
    folders: dict[object, Path] = {}
    for door in DOORS.values():
        if door.make not in folders:
            folders[door.make] = tmp_path_factory.mktemp("good")
            door.make(folders[door.make])
    return folders


@pytest.mark.parametrize("name", DOORS)
def test_a_good_file_is_taken_and_spoiled_ones_are_taken_or_refused(name: str, good: dict[object, Path]) -> None:
    door = DOORS[name]
    attack(door, good[door.make], seed=None)
    found = [attack(door, good[door.make], seed) for seed in range(FEW.get(name, MANY))]
    assert "refused" in found


def test_the_attack_itself_sees_an_error_of_a_parser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x.yaml").write_text("a: 1", encoding="utf-8")
    door = DOORS["settings"].__class__(lambda folder: None, "x.yaml", [lambda data, chance: b"a: ["], read_yaml_badly)
    with pytest.raises(KeyError):
        attack(door, tmp_path, 0)


def read_yaml_badly(path: Path) -> None:
    try:
        read_yaml(path, ConfigError)
    except ConfigError as error:
        raise KeyError from error
