"""A drawn passage: corners joined by legs, laid out as the segments of a world file; and what cannot be laid, where."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from zebrat_bullet.errors import WorldError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.elements import Straight, Turn
from zebrat_bullet.world.passage import RANGE_Y_M, RANGE_YAW_RAD, START_GAP_M, start_share
from zebrat_bullet.world.schema import StartSpec, WorldSpec

BEHIND_M = 1.0
"""So much passage lies behind the first corner, where the middle of the car begins."""
MOST_CORNERS, LONGEST_M = 100, 100.0
_FAR_M = 500.0
_SHARPEST_RAD, _MOST_SHARP_RAD = math.radians(165.0), math.radians(135.0)
_STRAIGHT_ON_RAD = math.radians(0.5)
# What rounding to a millimetre takes of a leg, and the shortest straight that is written down.
_SLACK_M, _SHORTEST_M = 0.003, 0.01

Far = Annotated[float, Field(ge=-_FAR_M, le=_FAR_M)]


class Drawing(BaseModel):
    """A drawn passage, in m, in a frame of the page's own, y up.

    Attributes:
        points: corners, from the middle of the car to the exit.
        widths: of each leg between two of them.
        radii: how round the passage bends at each corner between two legs; 0 is sharp. As much of it is laid as the
            legs have room for.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    points: Annotated[list[tuple[Far, Far]], Field(min_length=2, max_length=MOST_CORNERS)]
    widths: Annotated[list[Annotated[float, Field(ge=0.1, le=10)]], Field(max_length=MOST_CORNERS)]
    radii: Annotated[list[Annotated[float, Field(ge=0, le=100)]], Field(max_length=MOST_CORNERS)]

    @model_validator(mode="after")
    def _check(self) -> "Drawing":
        n = len(self.points)
        if len(self.widths) != n - 1 or len(self.radii) != n - 2:
            raise ValueError(f"{n} points have {n - 1} widths and {n - 2} radii")
        return self


def parse_drawing(data: object) -> Drawing:
    """Return the drawing in plain data.

    Raises:
        WorldError: it is none; names the first wrong field.
    """
    with naming_the_field():
        return Drawing.model_validate(data)


@contextmanager
def naming_the_field() -> Iterator[None]:
    """Turn what is wrong with a drawing's data into one line.

    Raises:
        WorldError: names the first wrong field.
    """
    try:
        yield
    except ValidationError as error:
        item = error.errors(include_input=False, include_url=False)[0]
        field = ".".join(map(str, item["loc"])) or "drawing"
        message = item["msg"].removeprefix("Value error, ")
        raise WorldError(f"this is no drawing: {field}: {message}") from error


def lay(drawing: Drawing, robot: RobotModel, name: str = "my_track") -> tuple[WorldSpec, Pose2]:
    """Return a drawing as a world file, and where on the page the origin of that world is.

    Raises:
        WorldError: the car is too wide for it, or its legs are too short for its bends; `at` is on the page.
    """
    points = np.array(drawing.points)
    legs = np.diff(points, axis=0)
    lengths, yaws = np.hypot(*legs.T), np.arctan2(legs[:, 1], legs[:, 0])
    turns = np.remainder(np.diff(yaws) + math.pi, 2.0 * math.pi) - math.pi
    _check_size(drawing, points, lengths, robot)
    sharp_turns = np.abs(turns) > _SHARPEST_RAD
    if sharp_turns.any():
        raise WorldError(
            "The line turns back on itself here: make a U-turn of two corners", at=_at(points[1:-1][sharp_turns][0])
        )
    radii = _fitting_radii(drawing, points, lengths, turns)
    takes = np.array([0.0, *np.where(radii > 0, radii * np.tan(np.abs(turns) / 2.0), 0.0), 0.0])
    segments: list[Straight | Turn] = []
    for i, width in enumerate(drawing.widths):
        straight = lengths[i] - takes[i] - takes[i + 1] + (BEHIND_M if i == 0 else 0.0)
        if straight > _SHORTEST_M or i in (0, len(legs) - 1):
            segments.append(Straight(straight=round(max(float(straight), _SHORTEST_M), 3), width=width))
        if i < len(turns) and abs(turns[i]) > _STRAIGHT_ON_RAD:
            turn, radius = round(math.degrees(turns[i]), 2), round(float(radii[i]), 3)
            segments.append(Turn(turn=turn, radius=radius, width=_turn_width(drawing, i)))
    share = start_share(drawing.widths[0], robot.footprint_base)
    start = StartSpec(
        at_m=BEHIND_M, range_y_m=round(share * RANGE_Y_M, 4), range_yaw_rad=round(share * RANGE_YAW_RAD, 4)
    )
    (x, y), yaw = points[0], float(yaws[0])
    origin = Pose2(float(x) - BEHIND_M * math.cos(yaw), float(y) - BEHIND_M * math.sin(yaw), yaw)
    return WorldSpec(name=name, description="drawn by hand", segments=segments, start=start), origin


def drawing_of(spec: WorldSpec) -> Drawing | None:
    """Return a world file as a drawing in the frame of its world; None where it holds more than a drawing can."""
    if not spec.segments or spec.obstacles or spec.niches or spec.wall.boxes or spec.start.pose is not None:
        return None
    points = [np.array([spec.start.at_m, 0.0])]
    widths: list[float] = []
    radii: list[float] = []
    here, yaw, reach, width = np.zeros(2), 0.0, -spec.start.at_m, 0.0
    pending: float | None = None  # the radius of the corner that the next leg leaves
    for segment in spec.segments:
        if isinstance(segment, Straight):
            if width and pending is None and reach > _SHORTEST_M:  # the passage changes its width
                points, widths, radii = [*points, here], [*widths, width], [*radii, 0.0]
                reach = 0.0
            here = here + segment.straight * np.array([math.cos(yaw), math.sin(yaw)])
            reach, width, pending = reach + segment.straight, segment.width, None
            continue
        turn = math.radians(segment.turn)
        if abs(turn) > _SHARPEST_RAD or reach + 1e-9 < 0:
            return None
        take = segment.radius * math.tan(abs(turn) / 2.0)
        corner = here + take * np.array([math.cos(yaw), math.sin(yaw)])
        points, radii = [*points, corner], [*radii, segment.radius]
        widths.append(width if pending is None else segment.width or width)
        yaw += turn
        here, reach, pending = corner + take * np.array([math.cos(yaw), math.sin(yaw)]), take, segment.radius
    points, widths = [*points, here], [*widths, width]
    try:
        return Drawing(points=[_at(point) for point in points], widths=widths, radii=radii)
    except ValidationError:
        return None


def _check_size(drawing: Drawing, points: NDArray[np.float64], lengths: NDArray[np.float64], robot: RobotModel) -> None:
    middles = (points[:-1] + points[1:]) / 2.0
    if lengths.min() < 1e-3:
        raise WorldError("Two corners lie on each other here: take one away", at=_at(points[int(lengths.argmin())]))
    if lengths.sum() > LONGEST_M:
        raise WorldError(f"The passage is {lengths.sum():.0f} m long; at most {LONGEST_M:.0f} m are drawn here")
    car = float(np.ptp(robot.footprint_base[:, 1]))
    narrow = int(np.argmin(drawing.widths))
    if drawing.widths[narrow] <= car + 2.0 * START_GAP_M:
        raise WorldError(
            f"Too narrow here: the passage is {drawing.widths[narrow]:.2f} m wide and the car {car:.2f} m; widen it",
            at=_at(middles[narrow]),
        )


def _turn_width(drawing: Drawing, i: int) -> float:
    return max(drawing.widths[i], drawing.widths[i + 1])


def _fitting_radii(
    drawing: Drawing, points: NDArray[np.float64], lengths: NDArray[np.float64], turns: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the (N - 2,) radius that each corner is laid with.

    A corner of radius r takes r tan(turn / 2) of both its legs, a sharp one as much as that of half the width, the
    least radius that there is. Corners share what the leg between them has to spare.
    """
    slopes = np.tan(np.abs(turns) / 2.0)
    least = np.array([_turn_width(drawing, i) / 2.0 for i in range(len(turns))])
    bends = np.abs(turns) > _STRAIGHT_ON_RAD
    needs = np.where(bends, least * slopes + _SLACK_M, 0.0)
    spare = lengths - np.array([0.0, *needs]) - np.array([*needs, 0.0])
    if spare.min() < 0.0:
        leg = int(spare.argmin())
        raise WorldError(
            "The bend here is too tight for so wide a passage: draw it wider, move its corners apart, or make the "
            "passage narrower",
            at=_at((points[leg] + points[leg + 1]) / 2.0),
        )
    room = [needs[i] - _SLACK_M + min(a, b) / 2.0 for i, (a, b) in enumerate(pairwise(spare))]
    radii = np.minimum(drawing.radii, np.array(room) / np.maximum(slopes, 1e-9))
    # Too sharp a turn for a mitred corner is rounded all the same.
    radii = np.where(np.abs(turns) > _MOST_SHARP_RAD, np.maximum(radii, least + 1e-3), radii)
    return np.where(bends & (radii >= least + 1e-3), radii, 0.0)


def _at(point: NDArray[np.float64]) -> tuple[float, float]:
    return round(float(point[0]), 4), round(float(point[1]), 4)


def on_page(at: tuple[float, float], origin: Pose2) -> tuple[float, float]:
    """Return a place in a world on the page that its drawing is on."""
    c, s = math.cos(origin.yaw), math.sin(origin.yaw)
    return origin.x + c * at[0] - s * at[1], origin.y + s * at[0] + c * at[1]


def plain(drawing: Drawing) -> dict[str, Any]:
    """Return a drawing as plain data for JSON."""
    return drawing.model_dump(mode="json")
