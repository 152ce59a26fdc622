"""The world file: what a person may write in `worlds/*.yaml`, in metres and degrees."""

from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator

from zebrat_bullet.errors import WorldError

Metres = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Point = tuple[float, float]
Ring = Annotated[list[Point], Field(min_length=3)]

# Below this height a wall enters the blind zone of the lidar, and is seen only from afar.
LOWEST_WALL_M = 0.8
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

    height_m: Annotated[float, Field(ge=LOWEST_WALL_M)] = 1.0
    thickness_m: Annotated[float, Field(ge=0.02)] = 0.1
    boxes: "Boxes | None" = None


class Boxes(_Strict):
    """Cardboard boxes in a row: smallest and largest length, height and gap between two, drawn from `seed`."""

    seed: int = 0
    length_m: tuple[Metres, Metres] = (0.4, 0.7)
    height_m: tuple[Annotated[float, Field(ge=LOWEST_WALL_M)], Annotated[float, Field(ge=LOWEST_WALL_M)]] = (0.8, 1.2)
    gap_m: tuple[NotNegative, NotNegative] = (0.0, 0.05)
    setback_m: NotNegative = 0.03


class _Obstacle(_Strict):
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
    yaw_deg: float = 0.0


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
    """Where the car begins: `at_m` along the centre line of a `segments` track, or `pose` [x, y, yaw_deg]."""

    at_m: NotNegative = 1.5
    pose: tuple[float, float, float] | None = None
    range_x_m: NotNegative = 0.1
    range_y_m: NotNegative = 0.1
    range_yaw_rad: NotNegative = 0.15


class WorldSpec(_Strict):
    """A world file. Exactly one of `segments`, `free_space`, `mesh`, `map` says where the walls are.

    `family` and `difficulty` say of a generated track how it was drawn; nothing is built from them.
    """

    name: str
    description: str = ""
    family: str = ""
    difficulty: Annotated[float, Field(ge=0, le=1)] | None = None
    wall: Wall = Wall()
    segments: Annotated[list[Segment], Field(min_length=1)] | None = None
    niches: tuple[Niche, ...] = ()
    free_space: Annotated[list[Ring], Field(min_length=1)] | None = None
    mesh: Path | None = None
    map: Path | None = None
    centre_line: Annotated[list[Point], Field(min_length=2)] | None = None
    open_line: tuple[Point, Point] | None = None
    start: StartSpec = StartSpec()
    obstacles: tuple[Obstacle, ...] = ()
    waypoints: Annotated[list[Point], Field(min_length=1)] | None = None
    max_steps: Annotated[int, Field(ge=1)] | None = None

    @model_validator(mode="after")
    def _check(self) -> "WorldSpec":
        given = [key for key in SOURCES if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of {', '.join(SOURCES)}; got {', '.join(given) or 'none'}")
        if self.segments is not None:
            if self.centre_line is not None or self.open_line is not None:
                raise ValueError("`segments` already say centre_line and open_line: leave both out")
            return self
        if self.start.pose is None:
            raise ValueError("start.pose [x, y, yaw_deg] is needed where there are no `segments`")
        if any(isinstance(item, Buttress) for item in self.obstacles):
            raise ValueError("a buttress stands on the wall of a `segments` track: use a box or polygon here")
        if self.niches:
            raise ValueError("niches open in the walls of a `segments` track: draw them as part of the walls here")
        if (self.centre_line is None) != (self.open_line is None):
            raise ValueError("centre_line and open_line go together: give both or neither")
        if self.free_space is not None and self.centre_line is None:
            raise ValueError("`free_space` needs a centre_line and an open_line")
        if self.wall.boxes is not None and self.free_space is None:
            raise ValueError("wall.boxes go with `segments` or `free_space` only")
        return self


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a YAML file.

    Raises:
        WorldError: it is no YAML, or no mapping.
    """
    try:
        data = yaml.safe_load(path.read_text())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise WorldError(f"{path}: not readable as YAML: {error}; mend the line it names") from error
    if not isinstance(data, dict):
        raise WorldError(f"{path}: holds {type(data).__name__}, not `key: value` lines; start with `name:`")
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
        raise WorldError("\n".join(f"{source}: {_explain(item)}" for item in error.errors())) from error


def _explain(item: Any) -> str:
    tags = {"straight", "turn", "box", "polygon", "post", "buttress"}
    steps = [step for i, step in enumerate(item["loc"]) if not (step in tags and i + 1 < len(item["loc"]))]
    # A key that is also the name of its kind (`straight`) appears once as tag and once as field: the last one stays.
    field = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps).lstrip(".") or "world"
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "extra_forbidden":
        return f"{field}: unknown field; correct its name or remove it"
    if item["type"] == "missing":
        return f"{field}: missing; add it"
    got = item["input"]
    return (
        f"{field}: {message}" if isinstance(got, dict | WorldSpec) else f"{field}: {message} (got {got!r}); change it"
    )
