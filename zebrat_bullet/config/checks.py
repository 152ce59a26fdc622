"""Checks that settings share, and the kinds of value that several hold."""

from dataclasses import fields
from typing import Any

from zebrat_bullet.errors import ConfigError

MOST_SEED = 2**31 - 1
"""Greatest seed of a run; its evaluations and their episodes draw from seeds beyond it."""
Range = tuple[float, float]
"""Least and greatest value of a uniform draw."""


def require(ok: bool, message: str) -> None:
    """Raise a ConfigError with this message unless it is so."""
    if not ok:
        raise ConfigError(message)


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
