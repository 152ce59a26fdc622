"""The world file: what a person may write in `worlds/*.yaml`, in metres and degrees."""

from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator

from zebrat_bullet.errors import WorldError
from zebrat_bullet.files import read_yaml as read_any_yaml
from zebrat_bullet.files import shown

MOST_COORDINATE_M = 1e5
"""Whatever lies further from the origin is a slip of the pen."""
_LONGEST_M, _LONGEST_COURSE_M = 1000.0, 3000.0
_MOST_ITEMS, _MOST_ERRORS = 5000, 20
Metres = Annotated[float, Field(gt=0, le=_LONGEST_M)]
NotNegative = Annotated[float, Field(ge=0, le=_LONGEST_M)]
Coordinate = Annotated[float, Field(ge=-MOST_COORDINATE_M, le=MOST_COORDINATE_M)]
Degrees = Annotated[float, Field(ge=-3600, le=3600)]
Point = tuple[Coordinate, Coordinate]
Ring = Annotated[list[Point], Field(min_length=3, max_length=_MOST_ITEMS)]
Unknown = Literal["free", "occupied", "refused"]

# Below this height a wall enters the blind zone of the lidar, and is seen only from afar.
LOWEST_WALL_M = 0.8
WallHeight = Annotated[float, Field(ge=LOWEST_WALL_M, le=_LONGEST_M)]
SOURCES = ("segments", "free_space", "mesh", "map")


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Straight(_Strict):
    """A straight of the corridor, measured along its centre line (to the corner point, if a sharp turn follows)."""

    straight: Metres
    width: Metres


class Turn(_Strict):
    """A turn by `turn` degrees, left positive, about `radius` of the centre line; radius 0 is a sharp mitred corner."""

    turn: Annotated[float, Field(ge=-270, le=270)]
    radius: NotNegative = 0.0
    width: Metres | None = None

    @model_validator(mode="after")
    def _check(self) -> "Turn":
        if self.turn == 0:
            raise ValueError("a turn of 0 degrees turns nowhere: leave it out")
        if self.radius == 0 and abs(self.turn) > 135:
            raise ValueError("a sharp corner may turn at most 135 degrees: give a radius or split it in two")
        return self


class Wall(_Strict):
    """The walls round the corridor; with `boxes`, a row of boxes with gaps instead of a smooth wall."""

    height_m: WallHeight = 1.0
    thickness_m: Annotated[float, Field(ge=0.02, le=_LONGEST_M)] = 0.1
    boxes: "Boxes | None" = None


BoxLength = Annotated[float, Field(ge=0.05, le=_LONGEST_M)]


class Boxes(_Strict):
    """Cardboard boxes in a row: smallest and largest length, height and gap between two, drawn from `seed`."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    length_m: tuple[BoxLength, BoxLength] = (0.4, 0.7)
    height_m: tuple[WallHeight, WallHeight] = (0.8, 1.2)
    gap_m: tuple[NotNegative, NotNegative] = (0.0, 0.05)
    setback_m: NotNegative = 0.03

    @model_validator(mode="after")
    def _check(self) -> "Boxes":
        for key in ("length_m", "height_m", "gap_m"):
            least, most = getattr(self, key)
            if least > most:
                raise ValueError(f"{key} is [smallest, largest], got [{least}, {most}]: swap them")
        return self


class _Obstacle(_Strict):
    """It reaches from `bottom_m` to `height_m` above the floor; one lower than 0.8 m is declared by `low: true`."""

    height_m: Metres = 1.0
    bottom_m: NotNegative = 0.0
    low: bool = False

    @model_validator(mode="after")
    def _check_heights(self) -> "_Obstacle":
        if self.bottom_m >= self.height_m:
            raise ValueError(f"bottom_m {self.bottom_m} must be below height_m {self.height_m}")
        if self.height_m < LOWEST_WALL_M and not self.low:
            raise ValueError(
                f"height_m {self.height_m} is below {LOWEST_WALL_M} m, where the lidar can lose it: "
                "make it higher or declare it with `low: true`"
            )
        return self


class Box(_Obstacle):
    """A box with its centre at `box`, `size` along its own x and y, turned left by `yaw_deg`."""

    box: Point
    size: tuple[Metres, Metres]
    yaw_deg: Degrees = 0.0


class PolygonObstacle(_Obstacle):
    """Any simple outline."""

    polygon: Ring


class Post(_Obstacle):
    """A round post."""

    post: Point
    radius: Metres = 0.1


class Buttress(_Obstacle):
    """A block standing out of one wall of a `segments` track, `at_m` along the centre line."""

    buttress: Literal["left", "right"]
    at_m: NotNegative
    length: Metres
    depth: Metres


class Niche(_Strict):
    """A pocket in the `left` or `right` wall of a `segments` track, `depth` deep, with a mouth of `length`.

    It lies `at_m` along the centre line; at the very corner point of a sharp turn it goes on straight ahead on the
    outer side.
    """

    niche: Literal["left", "right"]
    at_m: NotNegative
    length: Metres
    depth: Metres


def _kind(item: Any) -> str | None:
    kinds = ("straight", "turn", "box", "polygon", "post", "buttress")
    keys = item if isinstance(item, dict) else getattr(type(item), "model_fields", {})
    return next((kind for kind in kinds if kind in keys), None)


Segment = Annotated[
    Annotated[Straight, Tag("straight")] | Annotated[Turn, Tag("turn")],
    Discriminator(
        _kind, custom_error_type="segment", custom_error_message="a segment needs the key `straight` or `turn`"
    ),
]
Obstacle = Annotated[
    Annotated[Box, Tag("box")]
    | Annotated[PolygonObstacle, Tag("polygon")]
    | Annotated[Post, Tag("post")]
    | Annotated[Buttress, Tag("buttress")],
    Discriminator(
        _kind,
        custom_error_type="obstacle",
        custom_error_message="an obstacle needs one of the keys `box`, `polygon`, `post`, `buttress`",
    ),
]


class StartSpec(_Strict):
    """Where the car begins: `at_m` along the centre line of a `segments` track, or `pose` [x, y, yaw_deg].

    Each episode draws the pose within the `range_...` of it, to either side, x along the heading.
    """

    at_m: NotNegative = 1.5
    pose: tuple[Coordinate, Coordinate, Degrees] | None = None
    range_x_m: NotNegative = 0.1
    range_y_m: NotNegative = 0.1
    range_yaw_rad: Annotated[float, Field(ge=0, le=3.15)] = 0.15


class WorldSpec(_Strict):
    """A world file. Exactly one of `segments`, `free_space`, `mesh`, `map` says where the walls are.

    `family` and `difficulty` say of a generated track how it was drawn; nothing is built from them. `scale`, `offset`,
    `up`, `thickness_m` and `low` say how a mesh is meant, `unknown` what nobody has mapped is. `goal` is the last
    waypoint, or a line to cross; `waypoints` lead there. `max_steps` is this world's time-out in control steps.
    """

    name: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^/\\\x00-\x1f]+$")]
    description: Annotated[str, Field(max_length=2000)] = ""
    family: str = ""
    difficulty: Annotated[float, Field(ge=0, le=1)] | None = None
    wall: Wall = Wall()
    segments: Annotated[list[Segment], Field(min_length=1, max_length=_MOST_ITEMS)] | None = None
    niches: Annotated[tuple[Niche, ...], Field(max_length=_MOST_ITEMS)] = ()
    free_space: Annotated[list[Ring], Field(min_length=1, max_length=_MOST_ITEMS)] | None = None
    mesh: Path | None = None
    scale: Annotated[float, Field(ge=1e-6, le=1e6)] | None = None
    offset: tuple[Coordinate, Coordinate, Coordinate] | None = None
    up: Literal["y", "z"] | None = None
    thickness_m: Annotated[float, Field(ge=0.02, le=10)] | None = None
    low: bool = False
    map: Path | None = None
    unknown: Unknown | None = None
    centre_line: Annotated[list[Point], Field(min_length=2, max_length=_MOST_ITEMS)] | None = None
    open_line: tuple[Point, Point] | None = None
    start: StartSpec = StartSpec()
    obstacles: Annotated[tuple[Obstacle, ...], Field(max_length=_MOST_ITEMS)] = ()
    waypoints: Annotated[list[Point], Field(min_length=1, max_length=_MOST_ITEMS)] | None = None
    goal: tuple[Point, Point] | Point | None = None
    max_steps: Annotated[int, Field(ge=1, le=1_000_000)] | None = None

    @property
    def is_circuit(self) -> bool:
        """Whether the centre line ends where it begins."""
        line = self.centre_line
        return line is not None and len(line) > 3 and line[0] == line[-1]

    @model_validator(mode="before")
    @classmethod
    def _begin_at_origin(cls, data: Any) -> Any:
        """A mesh or map without a start is begun at its origin, exactly, as one without a world file is."""
        if isinstance(data, dict) and "start" not in data and ("mesh" in data or "map" in data):
            return data | {"start": AT_ORIGIN}
        return data

    @model_validator(mode="after")
    def _check(self) -> "WorldSpec":
        given = [key for key in SOURCES if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of {', '.join(SOURCES)}; got {', '.join(given) or 'none'}")
        self._check_keys_of(given[0])
        for key in ("centre_line", "open_line", "goal"):
            self._check_points(key)
        if self.segments is not None:
            if self.centre_line is not None or self.open_line is not None:
                raise ValueError("`segments` already say centre_line and open_line: leave both out")
            length = sum(s.straight if isinstance(s, Straight) else abs(s.turn) / 57 * s.radius for s in self.segments)
            if length > _LONGEST_COURSE_M:
                raise ValueError(f"segments are {length:.0f} m long, more than {_LONGEST_COURSE_M:.0f} m: shorten them")
            return self
        if self.start.pose is None:
            raise ValueError("start.pose [x, y, yaw_deg] is needed where there are no `segments`")
        if any(isinstance(item, Buttress) for item in self.obstacles):
            raise ValueError("a buttress stands on the wall of a `segments` track: use a box or polygon here")
        if self.niches:
            raise ValueError("niches open in the walls of a `segments` track: draw them as part of the walls here")
        ends = bool(self.goal or self.waypoints or self.is_circuit)
        if self.free_space is not None and not (self.centre_line if self.open_line else ends):
            raise ValueError("`free_space` needs a centre_line and an open_line, or else a goal")
        if self.centre_line is not None and not (self.open_line or ends):
            raise ValueError(
                "centre_line needs an open_line that it leads over, a goal, or an end at its first point (a circuit)"
            )
        if self.wall.boxes is not None and self.free_space is None:
            raise ValueError("wall.boxes go with `segments` or `free_space` only")
        return self

    def _check_keys_of(self, source: str) -> None:
        owners = dict.fromkeys(("scale", "offset", "up", "thickness_m", "low"), "mesh") | {"unknown": "map"}
        stray = [key for key, owner in owners.items() if getattr(self, key) and owner != source]
        if stray:
            raise ValueError(
                f"{', '.join(stray)}: for a `{owners[stray[0]]}` only, and this is a `{source}`: remove it"
            )

    def _check_points(self, key: str) -> None:
        points = getattr(self, key)
        if points is None or not isinstance(points[0], tuple | list):
            return
        if all(point == points[0] for point in points):
            raise ValueError(f"{key}: its points are all the same: it needs two that differ")


AT_ORIGIN = StartSpec(pose=(0.0, 0.0, 0.0), range_x_m=0.0, range_y_m=0.0, range_yaw_rad=0.0)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file.

    Raises:
        WorldError: it is no YAML, or no mapping.
    """
    data = read_any_yaml(path, WorldError)
    if not isinstance(data, dict):
        holds = "is empty" if data is None else f"holds a {type(data).__name__}"
        raise WorldError(f"{path}: {holds}, not `key: value` lines; start with `name:`")
    return data


def write_spec(spec: WorldSpec, folder: Path) -> Path:
    """Write a world file as `folder`/NAME.yaml, what is as by default left out, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{spec.name}.yaml"
    data = spec.model_dump(mode="json", exclude_defaults=True)
    path.write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120))
    return path


def parse_spec(data: dict[str, Any], source: str) -> WorldSpec:
    """Check the mapping of a world file.

    Raises:
        WorldError: names the file, every wrong field, what it held and what is allowed.
    """
    try:
        return WorldSpec.model_validate(data)
    except ValidationError as error:
        lines = [f"{source}: {_explain(item)}" for item in error.errors()[:_MOST_ERRORS]]
        more = error.error_count() - len(lines)
        raise WorldError("\n".join(lines) + (f"\n{source}: and {more} more" if more > 0 else "")) from error


def _explain(item: Any) -> str:
    tags = {"straight", "turn", "box", "polygon", "post", "buttress"}
    steps = [step for i, step in enumerate(item["loc"]) if not (step in tags and i + 1 < len(item["loc"]))]
    # A key that is also the name of its kind (`straight`) appears once as tag and once as field: the last one stays.
    field = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps).lstrip(".") or "world"
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "extra_forbidden":
        return f"{shown(field)}: unknown field; correct its name or remove it"
    if item["type"] == "missing":
        return f"{field}: missing; add it"
    got = item["input"]
    if isinstance(got, dict | WorldSpec):
        return f"{field}: {message}"
    return f"{field}: {message} (got {shown(repr(got))}); change it"
