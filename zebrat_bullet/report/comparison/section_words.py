"""What the report's words mean, and in what these experiments are not the paper's."""

from pathlib import Path
from typing import Any

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import read_yaml
from zebrat_bullet.report.comparison.document import Grid, Section

_WORDS = Path(__file__).with_name("words.yaml")


def words_section() -> Section:
    """Return the section that explains the report's words."""
    rows = tuple((word, meaning) for word, meaning in _read()["words"].items())
    return Section("Words", (Grid(("word", "what it means"), rows, wordy=True),), folded=True)


def differences_section() -> Section:
    """Return the section on what is not as in the paper."""
    rows = tuple((what, each["paper"], each["here"]) for what, each in _read()["differences"].items())
    return Section("What differs from the paper", (Grid(("", "the paper", "here"), rows, wordy=True),))


def _read() -> dict[str, dict[str, Any]]:
    words: dict[str, dict[str, Any]] = read_yaml(_WORDS, ConfigError)
    return words
