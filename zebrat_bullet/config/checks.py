"""Checks that settings share, and the kinds of value that several hold."""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from numbers import Integral, Real
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


def of_their_kinds(config: Any) -> None:
    """Raise unless each field of a settings dataclass is of the kind of its default, a tuple of numbers; None: any.

    Raises:
        ConfigError: a number, a text, a flag, a tuple or other settings are something else.
    """
    for each in fields(config):
        value = getattr(config, each.name)
        usual = each.default if each.default is not MISSING else each.default_factory()  # type: ignore[operator]
        other = (type(usual), (type(usual),), type(usual).__name__)
        _, kinds, named = next((kind for kind in _KINDS if isinstance(usual, kind[0])), other)
        several = value if isinstance(usual, tuple) and isinstance(value, tuple | list) else ()
        if usual is not None and not (isinstance(value, kinds) and all(isinstance(one, Real) for one in several)):
            raise ConfigError(f"{each.name} must be {named}, got {shown(repr(value))}")


# What counts as what: a flag is no number, and a range of numbers may be one number.
_KINDS: tuple[tuple[type, tuple[type, ...], str], ...] = (
    (bool, (bool, np.bool_), "True or False"),
    (int, (Integral,), "a whole number"),
    (float, (Real,), "a number"),
    (str, (str, Path), "a text"),
    (tuple, (tuple, list, Real), "a tuple of numbers"),
    (Mapping, (Mapping,), "a mapping"),
)


def within(config: object, **bounds: tuple[float, float]) -> None:
    """Raise unless each named number of a settings dataclass, or each of a tuple of them, is within its bounds.

    Raises:
        ConfigError: one is not, or is no finite number; None counts as within.
    """
    for name, (least, most) in bounds.items():
        value = getattr(config, name)
        for each in value if isinstance(value, tuple) else (value,):
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
