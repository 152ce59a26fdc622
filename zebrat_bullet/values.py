"""What a program hands over must be of a kind that can be meant, or is told what is."""

from numbers import Integral
from typing import TypeVar

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown

K = TypeVar("K")


def whole_number(value: object, what: str, least: int, most: int) -> int:
    """Return a whole number, also one of NumPy's, within its bounds.

    Raises:
        ConfigError: it is none, or beyond them; True and False are none.
    """
    if not isinstance(value, Integral) or isinstance(value, bool):
        raise ConfigError(f"{what} must be a whole number, {least} to {most}, got {shown(repr(value))}")
    number = int(value)
    if number < least:
        raise ConfigError(f"{what} must be at least {least}, got {number}")
    if number > most:
        raise ConfigError(f"{what} must be at most {most}, got {number}")
    return number


def of_kind(value: object, kind: type[K], what: str, remedy: str) -> K:
    """Return a value that is of a kind.

    Raises:
        ConfigError: it is not; says what to do.
    """
    if not isinstance(value, kind):
        raise ConfigError(f"{what} must be a {kind.__name__}, got {shown(repr(value))}; {remedy}")
    return value
