"""Writes the reference pages from what the program itself says: python scripts/reference.py [FOLDER] (docs/).

`cli.md` from the parser of the command line, `settings.md` from the dataclasses of the settings and their docstrings,
`world_files.md` from the schema of world files. `tests/test_docs.py` fails where a page is not what this writes.
"""

import argparse
import inspect
import re
import sys
import typing
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path

from pydantic import BaseModel

from zebrat_bullet import config
from zebrat_bullet.cli.main import make_parser
from zebrat_bullet.cli.options import robot_options
from zebrat_bullet.imitation import cloning
from zebrat_bullet.imitation import settings as imitation_settings
from zebrat_bullet.planning.dwa.config import DwaConfig
from zebrat_bullet.planning.hybrid_a_star import HybridAStarConfig
from zebrat_bullet.planning.teb.config import TebConfig
from zebrat_bullet.training import collapses, learner_settings, settings
from zebrat_bullet.world import elements, schema

CONFIGS: tuple[tuple[str, str, type], ...] = (
    ("task", "The car in a world", config.TaskConfig),
    ("task.physics", "Physics", config.PhysicsConfig),
    ("task.dynamics", "The car's dynamics", config.DynamicsConfig),
    ("task.lidar", "Lidar", config.LidarConfig),
    ("task.noise", "Noise of the lidar", config.NoiseConfig),
    ("task.disturbance", "Disturbances", config.DisturbanceConfig),
    ("task.flatten", "From cloud to scan", config.FlattenConfig),
    ("task.region", "Safety region", config.SafetyRegionConfig),
    ("task.observation", "Observation", config.ObservationConfig),
    ("task.reward", "Reward", config.RewardConfig),
    ("task.episode", "Episode", config.EpisodeConfig),
    ("", "A training run", settings.TrainConfig),
    ("planar", "Training on planar cars", settings.PlanarConfig),
    ("watchdog", "Watchdog", collapses.WatchdogConfig),
    ("learner", "DDPG", learner_settings.DDPGConfig),
    ("learner", "DQN", learner_settings.DQNConfig),
    ("learner", "SAC", learner_settings.SACConfig),
    ("learner", "PPO", learner_settings.PPOConfig),
    ("", "Imitation", imitation_settings.ImitationConfig),
    ("clone", "Imitation: the network", cloning.CloneConfig),
    ("", "DWA", DwaConfig),
    ("", "TEB", TebConfig),
    ("", "Oracle", HybridAStarConfig),
)
"""Where each is in `--set`, its heading, and the class; planners' settings stand behind the agent's name."""

SETTINGS_HEAD = """\
# Settings

Every setting is a field of a frozen dataclass: `--set task.noise.range_sigma_m=0.01` on the command line,
`task={"noise": {...}}` or the class itself in Python, and `config.json` in every run's folder. A name that does not
exist and a value out of its bounds are refused. `zebrat train` and `sweep` take all but those of imitation, which
`imitate` takes; `evaluate`, `video`, `record` and `robustness` take those of `task.`. Which learner's settings count is
said by `--algo`. Those of the planners stand behind the agent's name:
`--agent dwa:inflation_radius_m=0.3,allow_reverse=true`.

Written by `scripts/docs` from the docstrings.
"""

CLI_HEAD = """\
# Command line

`zebrat COMMAND --help` says the same. Results go to standard output, all else to standard error; the exit status is 0,
1 after a part of the work, 2 after a mistake of the user's, 3 after one of ours, 130 after Ctrl-C. Written by
`scripts/docs` from the parser.
"""

WORLDS_HEAD = """\
# World files

A world is a YAML file like those in `worlds/`; [your own world](your_own_world.md) shows one of each kind. Lengths are
in metres, angles in degrees where the key does not say `_rad`. A key that does not exist and a value out of its bounds
are refused with the file, the field and the remedy. Written by `scripts/docs` from
`zebrat_bullet/world/schema.py` and `elements.py`.
"""

_LEAST_LOOSE = 999
"""Bounds from here on stop slips of the pen alone, and are not shown."""

MODELS: tuple[type[BaseModel], ...] = (
    schema.WorldSpec,
    schema.StartSpec,
    elements.Wall,
    elements.Boxes,
    elements.Straight,
    elements.Turn,
    elements.Niche,
    elements.Box,
    elements.PolygonObstacle,
    elements.Post,
    elements.Buttress,
)


def main() -> None:
    """Write the three pages into the folder."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent.parent / "docs"
    for name, text in pages().items():
        (folder / name).write_text(text, encoding="utf-8")


def pages() -> dict[str, str]:
    """Return the text of each page by its file name."""
    return {"cli.md": cli_page(), "settings.md": settings_page(), "world_files.md": worlds_page()}


def cli_page() -> str:
    """Return the page on the command line: the options of every command, those of the car, each command's own."""
    parser = make_parser()
    commands = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction)).choices
    options = {name: {_names(a): _option(a) for a in sub._actions} for name, sub in commands.items()}
    shared = [k for k in next(iter(options.values())) if all(o.get(k) == options["train"][k] for o in options.values())]
    index = [f"[`{name}`](#{name}) | {_cell(sub.description or '')}" for name, sub in commands.items()]
    parts = [CLI_HEAD, _table("command | what", index)]
    parts += ["## Options of every command", _table("option | what", [options["train"][key] for key in shared])]
    car = [_names(action) for action in robot_options()._actions]
    without = ", ".join(f"`{name}`" for name, of in options.items() if not set(car) & set(of))
    parts += [
        "## Options of the car",
        f"Of every command but {without}, which take the car from elsewhere or need none.",
    ]
    parts += [_table("option | what", [options["train"][key] for key in car])]
    usual = {key: options["train"][key] for key in (*shared, *car)}
    for name, sub in commands.items():
        own = [row for key, row in options[name].items() if usual.get(key) != row]
        parts += [f"## {name}", _cell(sub.description or ""), _table("option | what", own) if own else ""]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _names(action: argparse.Action) -> str:
    return ", ".join(action.option_strings) or str(action.metavar or action.dest)


def _option(action: argparse.Action) -> str:
    """Return a row of an option's table."""
    names = action.option_strings or [str(action.metavar or action.dest)]
    takes = _takes(action)
    said = _cell((action.help or "").replace("%(default)s", str(action.default)).replace("%%", "%"))
    if action.required:
        said = f"needed. {said}"
    elif action.default not in (None, False, [], argparse.SUPPRESS) and "default" not in said:
        shown = " ".join(map(str, action.default)) if isinstance(action.default, list | tuple) else action.default
        said = f"{said} (default `{shown}`)".strip()
    return f"{', '.join(f'`{name}{takes}`' for name in names)} | {said}"


def _takes(action: argparse.Action) -> str:
    """Return what follows an option on the command line."""
    if action.nargs == 0:
        return ""
    if not action.option_strings:
        return {"+": " ...", "*": " ...", "...": " ..."}.get(str(action.nargs), "")
    if isinstance(action.metavar, tuple):
        return " " + " ".join(action.metavar)
    one = str(action.metavar or action.dest.upper())
    if action.choices:
        one = "{" + ",".join(map(str, action.choices)) + "}"
    if isinstance(action.nargs, int):
        return " " + " ".join([one] * action.nargs)
    several = {"+": f"{one} ...", "*": f"[{one} ...]", "?": f"[{one}]", "...": "..."}
    return " " + several.get(str(action.nargs), one)


def settings_page() -> str:
    """Return the page on settings: a table a dataclass."""
    parts = [SETTINGS_HEAD]
    for path, title, kind in CONFIGS:
        meanings = attributes(kind)
        rows = []
        for field in fields(kind):
            said = meanings.get(field.name) or _of_group(field.name, meanings)
            if not said and (field.name == "algo" or _settings_class(field)):
                continue
            rows.append(f"`{f'{path}.{field.name}'.lstrip('.')}` | {_default(field)} | {_cell(said)}")
        summary = (inspect.getdoc(kind) or "").split("\n\nAttributes:")[0]
        parts += [f"## {title}", f"`{kind.__name__}`. {' '.join(summary.split())}"]
        parts.append(_table("setting | default | what", rows))
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def attributes(kind: type) -> dict[str, str]:
    """Return what the "Attributes:" of a docstring say of each name; names before one colon share a text."""
    _, _, text = (inspect.getdoc(kind) or "").partition("\nAttributes:\n")
    found = re.findall(r"^    ([\w*]+(?:, \w+)*): (.*(?:\n {5,}.*)*)", text, re.MULTILINE)
    return {name: " ".join(meaning.split()) for names, meaning in found for name in names.split(", ")}


def _of_group(name: str, meanings: dict[str, str]) -> str:
    """Return what is said of `weight_*` for a name that begins so."""
    return next((said for key, said in meanings.items() if key.endswith("*") and name.startswith(key[:-1])), "")


def _settings_class(field: Field) -> bool:
    return field.default_factory is not MISSING and is_dataclass(field.default_factory())


def _default(field: Field) -> str:
    if field.default is not MISSING:
        value = field.default
    elif field.default_factory is not MISSING:
        value = field.default_factory()
    else:
        return "must be given"
    if is_dataclass(value):
        return "see below"
    if isinstance(value, float) and round(value, 6) != value:
        return f"`{value:.4g}`"
    return f"`{value!r}`"


def worlds_page() -> str:
    """Return the page on world files: a table a mapping."""
    parts = [WORLDS_HEAD]
    for model in MODELS:
        rows = []
        for name, field in model.model_fields.items():
            default = "must be given" if field.is_required() else _plain(field.get_default(call_default_factory=True))
            rows.append(f"`{name}` | {_cell(_kind(field.annotation))}{_bounds(field.metadata)} | {default}")
        title = "The file" if model is schema.WorldSpec else model.__name__
        said = " ".join(f"{inspect.getdoc(model)} {_of_obstacles(model)}".split())
        parts += [f"## {title}", said, _table("key | what | default", rows)]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _of_obstacles(model: type[BaseModel]) -> str:
    """Return what the docstring of the obstacles' own base says, nothing of another model."""
    base = model.__mro__[1]
    return "" if base.__mro__[1] is BaseModel else str(inspect.getdoc(base))


def _plain(value: object) -> str:
    if value is None or value == ():
        return "none"
    return f"see {type(value).__name__}" if isinstance(value, BaseModel) else f"`{value!r}`"


def _kind(annotation: object, bounds: str = "") -> str:
    """Return a type of a field in words."""
    if annotation == elements.Point:
        return "[x, y]"
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _kind(inner[0], _bounds(inner[1:]))
    if origin is typing.Literal:
        return " or ".join(f"`{value}`" for value in inner)
    if origin in (list, tuple):
        items = [_kind(each) for each in inner if each is not Ellipsis]
        if origin is list or Ellipsis in inner:
            return f"list of {items[0]}"
        return f"[{', '.join(items)}]"
    if inner:  # a union
        return " or ".join(_kind(each) for each in inner if each is not type(None)) + bounds
    words = {float: "number", int: "whole number", str: "text", bool: "true or false", Path: "file"}
    return words.get(annotation, getattr(annotation, "__name__", str(annotation))) + bounds  # type: ignore[call-overload]


def _bounds(metadata: typing.Iterable[object]) -> str:
    signs = (("gt", "above"), ("ge", "at least"), ("lt", "below"), ("le", "at most"))
    said = [
        f"{word} {bound:g}"
        for item in metadata
        for sign, word in signs
        for bound in [getattr(item, sign, None)]
        if bound is not None and abs(bound) < _LEAST_LOOSE
    ]
    inner = [_bounds(item.metadata) for item in metadata if hasattr(item, "metadata")]
    return (" (" + ", ".join(said) + ")" if said else "") + "".join(inner)


def _table(head: str, rows: list[str]) -> str:
    lines = [head, " | ".join(["---"] * (head.count("|") + 1)), *rows]
    return "\n".join(f"| {line} |" for line in lines)


def _cell(text: str) -> str:
    """Return a text as a cell of a Markdown table: one line, its bars and angle brackets shown as such."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    shown = [part if part.startswith("`") else part.replace("<", "&lt;").replace("*", "\\*") for part in parts]
    return "".join(shown).replace("|", "\\|")


if __name__ == "__main__":
    main()
