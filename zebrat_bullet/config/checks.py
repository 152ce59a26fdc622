"""Checks that settings share, and the kinds of value that several hold."""

from dataclasses import MISSING, fields
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown

MOST_SEED = 2**31 - 1
"""Greatest seed of a run; its evaluations and their episodes draw from seeds beyond it."""
Range = tuple[float, float]
"""Least and greatest value of a uniform draw."""


def require(ok: bool, message: str) -> None:
    """Raise a ConfigError with this message unless it is so."""
    if not ok:
        raise ConfigError(message)


def of_their_kinds(config: Any, range_or_number: bool = False) -> None:
    """Raise unless each field of a settings dataclass is of the kind of its default; None: a number or None.

    Args:
        config: the settings.
        range_or_number: where a tuple is usual, a number counts too.

    Raises:
        ConfigError: a number, a text, a flag, a tuple of numbers or other settings are something else.
    """
    for each in fields(config):
        value = getattr(config, each.name)
        usual = each.default if each.default is not MISSING else each.default_factory()  # type: ignore[operator]
        if usual is None:
            ok, kind = value is None or _is_number(value), "a number or None"
        elif isinstance(usual, bool):
            ok, kind = isinstance(value, bool | np.bool_), "True or False"
        elif isinstance(usual, int):
            ok, kind = _is_number(value) and value == value // 1, "a whole number"
        elif isinstance(usual, float):
            ok, kind = _is_number(value), "a number"
        elif isinstance(usual, str):
            ok, kind = isinstance(value, str | Path), "a text"
        elif isinstance(usual, tuple):
            length = f"{len(usual)} " if usual else ""
            ok, kind = _are_numbers(value, len(usual)), f"a tuple of {length}numbers"
            ok = ok or (range_or_number and _is_number(value))
        else:
            ok, kind = isinstance(value, type(usual)), "a mapping" if isinstance(usual, dict) else type(usual).__name__
        require(ok, f"{each.name} must be {kind}, got {shown(repr(value))}")


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _are_numbers(values: object, n: int) -> bool:
    """Return whether these are n numbers; of 0, any number of them."""
    return isinstance(values, tuple | list) and len(values) in (n, n or len(values)) and all(map(_is_number, values))


def within(config: object, **bounds: tuple[float, float]) -> None:
    """Raise unless each named number of a settings dataclass, or each of a tuple of them, is within its bounds.

    Raises:
        ConfigError: one is not, or is no finite number; None counts as within.
    """
    for name, (least, most) in bounds.items():
        value = getattr(config, name)
        for each in value if isinstance(value, tuple | list) else (value,):
            # A number that is none compares as False with both.
            require(each is None or least <= each <= most, f"{name} must be {least:g} to {most:g}, got {each}")


def none_negative(config: Any) -> None:
    """Raise a ConfigError unless every number of a settings dataclass, alone or in a tuple, is 0 to a million."""
    names = [each.name for each in fields(config) if isinstance(getattr(config, each.name), int | float | tuple)]
    within(config, **dict.fromkeys(names, (0.0, 1e6)))


def at_least_one(config: object, *names: str) -> None:
    """Raise a ConfigError unless each named number of a settings dataclass is at least 1."""
    for name in names:
        if getattr(config, name) < 1:
            raise ConfigError(f"{name} must be at least 1, got {getattr(config, name)}")


def shares(config: object, *names: str) -> None:
    """Raise a ConfigError unless each named number of a settings dataclass is in [0, 1]."""
    for name in names:
        if not 0 <= getattr(config, name) <= 1:
            raise ConfigError(f"{name} must be in [0, 1], got {getattr(config, name)}")
