"""Turns what comes from the page, a drawing or the text of a world file, into a checked world; says what is wrong."""

import re
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from zebrat_bullet.assets import find_asset, list_assets
from zebrat_bullet.errors import AssetError, WorldError, ZebratError
from zebrat_bullet.files import parse_yaml, read_text
from zebrat_bullet.play.drawing import drawing_of, lay, on_page, parse_drawing, plain
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, WorldNote, load_world, require_winnable
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.schema import WorldSpec, parse_spec, write_spec
from zebrat_bullet.world.track import course_m

MOST_ITEMS = 400
"""Segments, obstacles, niches and corners of an opened file: what is checked while the page waits."""
_LONGEST_M = 200.0

# A drawing with this fault is given a goal, the line of its exit, which then decides.
_OPEN_SPACE = "open_line: open space"
_GOAL_DECIDES = "In a bend the car could take the inside for open space, so here it is out once it crosses the exit."

# What the checks of any world file say, in the words of who has drawn one; the rest is shown as it stands.
_IN_PLAIN_WORDS = (
    (r"runs into its own", "The passage runs into itself here: lead it around"),
    (r"too thin to build|walls would cross", "The walls cross here: move the corners apart"),
    (_OPEN_SPACE, "From here the car sees so far aside that it takes the place for open space: make it narrower"),
    (
        r"open_line: within",
        "Out here a wall still stands close by, and no car would know that it is out: end elsewhere",
    ),
    (r"open_line: a wall", "A wall stands right behind the exit: end the passage elsewhere"),
    (r"start: at", "The car has no room to begin here: make the first leg longer or wider"),
    (r"width: somewhere", "Somewhere the passage is narrower than the car: widen it"),
)


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Why a track cannot be driven: in plain words, where on the page if it has a place, and as the checks put it."""

    text: str
    at: tuple[float, float] | None = None
    details: str = ""


@dataclass(frozen=True, kw_only=True)
class Track:
    """What was drawn or opened.

    Attributes:
        drawing: as plain data; None of a world file that holds more than a drawing can.
        world: checked; None where there is a problem.
        text: its world file; empty where none could be written.
        origin: where on the page the world's origin is.
        problem: why it cannot be driven.
        note: what was made of it.
        searched: what a way out is searched for in: the same walls with an exit, where the world has a goal instead.
    """

    drawing: dict[str, Any] | None = None
    world: World | None = None
    text: str = ""
    origin: Pose2 = field(default_factory=lambda: Pose2(0.0, 0.0, 0.0))
    problem: Problem | None = None
    note: str = ""
    searched: World | None = None


def drawn(data: object, robot: RobotModel, folder: Path) -> Track:
    """Check a drawing; its world file is written to the folder.

    Raises:
        WorldError: it is no drawing at all.
    """
    drawing = parse_drawing(data)
    try:
        spec, origin = lay(drawing, robot)
    except WorldError as error:
        return Track(drawing=plain(drawing), problem=Problem(text=str(error), at=error.at))
    path = write_spec(spec, folder)
    track = _loaded(path, path.read_text(encoding="utf-8"), robot, plain(drawing), origin)
    if track.problem is None or _OPEN_SPACE not in track.problem.details:
        return track
    laid = build_world(spec, path)
    assert laid.open_line is not None
    left, right = (tuple(end) for end in laid.open_line.round(3).tolist())
    path = write_spec(spec.model_copy(update={"goal": (left, right)}), folder)
    again = _loaded(path, path.read_text(encoding="utf-8"), robot, plain(drawing), origin)
    return again if again.world is None else replace(again, note=_GOAL_DECIDES, searched=laid)


def opened(text: str, robot: RobotModel, folder: Path) -> Track:
    """Check the text of a world file, or of a shipped one that it names.

    Raises:
        WorldError: it is no world file, one that names other files, or one too large to check while a page waits.
    """
    if text in list_assets("worlds", ".yaml"):
        text = read_text(find_asset("worlds", text, ".yaml"), AssetError)
    spec = _spec_of(text)
    drawing = drawing_of(spec)
    path = folder / "opened.yaml"
    path.write_text(text, encoding="utf-8")
    return _loaded(path, text, robot, None if drawing is None else plain(drawing), Pose2(0.0, 0.0, 0.0))


def _spec_of(text: str) -> WorldSpec:
    data = parse_yaml(text, "this file", WorldError)
    if not isinstance(data, dict):
        raise WorldError("this file is no world file: `key: value` lines are needed, of which the first is `name:`")
    beside = [key for key in ("mesh", "map", "image") if key in data]
    if beside:
        raise WorldError(
            f"this file names another one (`{beside[0]}:`), which the page cannot send: "
            "drive such a world with `zebrat teleop --world FILE` or `zebrat evaluate --worlds FILE`"
        )
    spec = parse_spec(data, "this file")
    rings = [*(spec.free_space or []), spec.centre_line or (), *(getattr(o, "polygon", ()) for o in spec.obstacles)]
    items = sum(map(len, rings)) + len(spec.segments or ()) + len(spec.obstacles) + len(spec.niches)
    if items > MOST_ITEMS or course_m(spec.segments or ()) > _LONGEST_M:
        raise WorldError(_too_large(f"{items} corners and segments, or too long"))
    return spec


def _check_extent(world: World) -> None:
    """Refuse what a planner's grid could not hold."""
    start = world.start.pose
    reach = np.abs([*world.walls.bounds, *world.waypoints.ravel(), start.x, start.y]).max()
    if reach > _LONGEST_M:
        raise WorldError(_too_large(f"it reaches {reach:.0f} m from its origin"))


def _too_large(what: str) -> str:
    return (
        f"this file is too large for the page ({what}; at most {MOST_ITEMS} items and {_LONGEST_M:.0f} m): "
        "drive it with `zebrat evaluate --worlds FILE`"
    )


def _loaded(path: Path, text: str, robot: RobotModel, drawing: dict[str, Any] | None, origin: Pose2) -> Track:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", WorldNote)  # the page says it
            world = load_world(path, robot=robot)
        require_winnable(world)
        _check_extent(world)
    except ZebratError as error:
        details = str(error).replace(f"{path}: ", "")
        plainly = next((words for pattern, words in _IN_PLAIN_WORDS if re.search(pattern, details)), details)
        at = getattr(error, "at", None)
        problem = Problem(text=plainly, at=None if at is None else on_page(at, origin), details=details)
        return Track(drawing=drawing, text=text, origin=origin, problem=problem)
    return Track(drawing=drawing, world=world, text=text, origin=origin, note=" ".join(world.notes))
