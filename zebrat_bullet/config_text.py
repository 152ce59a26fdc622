"""Settings as text and back: JSON, YAML, "key=value"; every value is checked, and what is refused is named."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import parse_yaml, read_text, read_yaml, refusing, shown

_MOST_ERRORS = 10
_WHOLE = {"margin_m"}
"""Mappings that are set as a whole: what they held before may be no mapping."""

Config = TypeVar("Config")


# A tenth of a second each of a large class.
_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)


def to_json(config: object) -> str:
    """Return a settings dataclass as JSON."""
    return _adapter(type(config)).dump_json(config).decode()


def from_json(kind: type[Config], text: str) -> Config:
    """Read a settings dataclass of the given kind from JSON.

    Raises:
        ConfigError: a value is missing, of the wrong type or out of its range; the message names the field.
    """
    try:
        return _adapter(kind).validate_json(text)
    except ValidationError as error:
        raise ConfigError(f"not a valid {kind.__name__}: {_explained(error)}") from error


def _explained(error: ValidationError) -> str:
    """Return in a line which fields are wrong, and why."""
    # Of several kinds of learners, those that were not meant say only that.
    meant = [item for item in error.errors() if item["loc"][-1:] != ("algo",) or item["type"] != "literal_error"]
    said = []
    for item in (meant or error.errors())[:_MOST_ERRORS]:
        where = ".".join(str(step) for step in item["loc"] if not str(step).endswith("Config"))
        got = "" if item["type"] == "value_error" else f", got {shown(repr(item['input']))}"
        said.append(f"{where + ': ' if where else ''}{item['msg'].removeprefix('Value error, ')}{got}")
    return shown("; ".join(said), 1000)


def from_plain(kind: type[Config], data: Config | Mapping[str, Any], base: Config | None = None) -> Config:
    """Return settings of the given kind from plain data, as JSON and YAML hold them, or of settings in a mapping.

    Args:
        kind: their class.
        data: what they are; settings of that class are returned as they are.
        base: what is left out is as there; None: as by default.

    Raises:
        ConfigError: a name is unknown (the message lists those there are), or as `from_json`.
    """
    if isinstance(data, kind):
        return data
    if not isinstance(data, Mapping):
        raise ConfigError(f"settings are a {kind.__name__} or a mapping of its fields, got {shown(data)!r}")
    values = json.loads(to_json(kind() if base is None else base))
    _update(values, data, kind.__name__)
    with refusing(kind.__name__, ConfigError, "no plain data", "use numbers, texts, lists and mappings"):
        return from_json(kind, json.dumps(values, default=_plain))


def _plain(value: object) -> Any:
    """Return settings, or a number of NumPy's, as JSON has it."""
    if is_dataclass(value):
        return json.loads(to_json(value))
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a {type(value).__name__} is neither a setting nor plain")


def _update(values: dict[str, Any], data: Mapping[str, Any], where: str) -> None:
    for name, value in data.items():
        if name not in values:
            raise ConfigError(f"{where} has no {shown(name)!r}; it has {', '.join(values)}")
        if isinstance(values[name], dict) and isinstance(value, Mapping) and name != "weights":
            _update(values[name], value, f"{where}.{name}")
        else:
            values[name] = value


def read_config(kind: type[Config], path: Path) -> Config:
    """Read a settings dataclass of the given kind from a JSON file.

    Raises:
        ConfigError: it cannot be read, or as `from_json`; the message names the file.
    """
    with refusing(path, ConfigError, f"holds no {kind.__name__}", "mend what it names, or leave the file out"):
        return from_json(kind, read_text(path, ConfigError))


def with_overrides(config: Config, assignments: Sequence[str]) -> Config:
    """Return settings with some replaced by "key=value" texts; keys are dotted, values YAML.

    Raises:
        ConfigError: a text has no "=", a key does not exist (the message lists those that do), or a value is refused.
    """
    values = json.loads(to_json(config))
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        *path, last = key.split(".")
        at = values
        for name in path:
            at = at.get(name) if isinstance(at, dict) else None
        if not equals or not isinstance(at, dict) or (last not in at and path[-1:] != ["weights"]):
            known = ", ".join(at) if isinstance(at, dict) else ", ".join(values)
            raise ConfigError(f"cannot set {assignment!r}: write key=value with a key of {known}")
        at[last] = parse_yaml(text, shown(assignment), ConfigError)
    return from_json(type(config), json.dumps(values))


def with_settings_of(config: Config, path: Path, assignments: Sequence[str] = ()) -> Config:
    """Return settings with some replaced by those of a YAML file, and further ones by "key=value" texts.

    Raises:
        ConfigError: as `overrides_of` and `with_overrides`; the message names the file.
    """
    with refusing(path, ConfigError, "holds settings that cannot be meant", "mend what it names"):
        return with_overrides(config, [*overrides_of(path), *assignments])


def overrides_of(path: Path) -> list[str]:
    """Return a YAML file of nested settings as "key=value" texts for `with_overrides`.

    Raises:
        ConfigError: the file cannot be read, or is not a mapping.
    """
    values = read_yaml(path, ConfigError)
    if not isinstance(values, dict):
        raise ConfigError(f"{path} must hold settings as `key: value`, got {type(values).__name__}")
    return [f"{key}={json.dumps(value)}" for key, value in _dotted(values)]


def _dotted(values: Mapping[Any, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict) and value and key not in _WHOLE:
            yield from ((f"{key}.{rest}", inner) for rest, inner in _dotted(value))
        else:
            yield str(key), value
