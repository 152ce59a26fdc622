"""How a world is named: a shipped name or a path, and after colons where it begins and ends there.

`my_map.yaml:start=1.0,2.0,90:goal=7.5,2.0`: yaw in degrees, as in world files.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.files import is_file, shown
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.elements import MOST_COORDINATE_M

_SETTING = re.compile(r":(start|goal|exit)=")
_LENGTHS = {"start": ("x,y,yaw in degrees", (3,)), "goal": ("x,y", (2,)), "exit": ("x1,y1,x2,y2", (4,))}


@dataclass(frozen=True)
class WorldReference:
    """A world by name or path, and what is said of it besides.

    Attributes:
        name: shipped name or path.
        start: x, y in m and yaw in degrees, or None for the world's own.
        goal: x, y in m, or None.
        exit: both ends of the open-space line, x, y, x, y in m, or None.
    """

    name: str
    start: tuple[float, ...] | None = None
    goal: tuple[float, ...] | None = None
    exit: tuple[float, ...] | None = None

    def __str__(self) -> str:
        said = {"start": self.start, "goal": self.goal, "exit": self.exit}
        return self.name + "".join(f":{key}={','.join(map(repr, at))}" for key, at in said.items() if at is not None)

    def with_places(
        self,
        start: Pose2 | Sequence[float] | None = None,
        goal: Pose2 | Sequence[float] | None = None,
        exit: Sequence[Sequence[float]] | None = None,
    ) -> "WorldReference":
        """Return it with another start (x, y, yaw in rad), goal (x, y) and exit (two points), each where not None.

        Raises:
            WorldError: they are not so many finite numbers, or the yaw is more than a turn.
        """
        made = self
        if start is not None:
            x, y, yaw = _numbers("start", start, 3)
            if abs(yaw) > 2 * math.pi + 1e-6:  # a turn in single precision is a hair more
                raise WorldError(
                    f"start: its yaw is in rad, -2 pi to 2 pi, got {yaw:g}; {yaw:g} degrees are {math.radians(yaw):.4f}"
                )
            made = replace(made, start=_checked("start", (x, y, math.degrees(yaw))))
        if goal is not None:
            ends = (goal.x, goal.y) if isinstance(goal, Pose2) else _numbers("goal", goal, 2)
            made = replace(made, goal=_checked("goal", ends))
        if exit is not None:
            corners = [value for point in exit for value in _numbers("exit", point, 2)]
            made = replace(made, exit=_checked("exit", corners))
        return made


def parse_reference(text: str) -> WorldReference:
    """Read how a world is named.

    A name may have colons of its own; it ends where the first place is said.

    Raises:
        WorldError: start, goal or exit are not so many finite numbers, one is there twice, or what follows them is
            none of these.
    """
    first = _SETTING.search(text)
    if first is None:
        return WorldReference(text)
    said: dict[str, tuple[float, ...]] = {}
    for part in text[first.start() + 1 :].split(":"):
        key, equals, numbers = part.partition("=")
        if not equals or key not in _LENGTHS or key in said:
            raise WorldError(
                f"{shown(text)}: what follows a world's name is start=, goal= and exit=, each once, got "
                f"{shown(part)!r}{' again' if key in said else ''}; correct it"
            )
        said[key] = _checked(key, numbers.split(","))
    return WorldReference(text[: first.start()], **said)


def unique_names(names: Sequence[str], sources: Sequence[str]) -> list[str]:
    """Return names of worlds, those that are alike told apart by the folders of their files, or else by number.

    Args:
        names: one a world.
        sources: what each was loaded from.
    """
    made = list(names)
    for name in {name for name in names if names.count(name) > 1}:
        same = [i for i, other in enumerate(names) if other == name]
        folders = [Path(parse_reference(sources[i]).name).resolve().parent.parts for i in same]
        for depth in range(1, max(map(len, folders)) + 1):
            told = ["/".join([*(part.strip("/") for part in folder[-depth:]), name]) for folder in folders]
            if len(set(told)) == len(told):
                break
        else:
            told = [f"{name}-{k}" for k in range(1, len(same) + 1)]
        for i, each in zip(same, told, strict=True):
            made[i] = each
    return made


def world_labels(references: Sequence[str]) -> dict[str, str]:
    """Return a short name, good for a folder, for each of several world references, no two alike."""
    distinct = list(dict.fromkeys(references))
    stems = [Path(parse_reference(text).name).stem for text in distinct]
    return dict(zip(distinct, unique_names(stems, distinct), strict=True))


def _numbers(key: str, values: Sequence[float], n: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != n or not all(map(math.isfinite, numbers)):
        raise WorldError(f"{key}: takes {n} numbers{_SHAPES[key]}, got {shown(repr(values))}; give these")
    return numbers


_SHAPES = {"start": ", x, y in m and yaw in rad", "goal": ", x and y in m", "exit": " a point, two points"}


def _checked(key: str, values: Sequence[object]) -> tuple[float, ...]:
    shape, lengths = _LENGTHS[key]
    try:
        numbers = tuple(float(value) for value in values)  # type: ignore[arg-type]
    except ValueError:
        numbers = ()
    if len(numbers) not in lengths or not all(math.isfinite(v) and abs(v) <= MOST_COORDINATE_M for v in numbers):
        got = shown(",".join(map(str, values)))
        raise WorldError(f"{key}: takes {shape}, numbers within {MOST_COORDINATE_M:g} of 0, got {got}; correct it")
    return numbers


def world_names(worlds: Sequence[str | Path]) -> tuple[str, ...]:
    """Return references to worlds as texts, which other processes and the files of a run can say again.

    Raises:
        ConfigError: they are no list of names or paths.
    """
    if not isinstance(worlds, list | tuple) or not all(isinstance(world, str | Path) for world in worlds):
        raise ConfigError(
            f"worlds must be names or files of worlds, in a list, got {shown(repr(worlds), 60)}; a generated track is "
            "saved as a file by write_spec(generate_spec(SEED), FOLDER) of zebrat_bullet.world"
        )
    return tuple(map(str, worlds))


def anywhere(world: str) -> str:
    """Return the name of a world, good from any folder: a user's own file by its whole path."""
    reference = parse_reference(world)
    return str(replace(reference, name=str(Path(reference.name).resolve()))) if is_file(reference.name) else world
