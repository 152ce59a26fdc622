"""The world file: what a person may write in `worlds/*.yaml`, in metres and degrees."""

from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError, model_validator

from zebrat_bullet.errors import WorldError
from zebrat_bullet.files import read_yaml as read_any_yaml
from zebrat_bullet.files import shown
from zebrat_bullet.world.elements import (
    MOST_ITEMS,
    Buttress,
    Coordinate,
    Degrees,
    Niche,
    NotNegative,
    Obstacle,
    Point,
    Ring,
    Segment,
    Straight,
    Strict,
    Wall,
)

_LONGEST_COURSE_M = 3000.0
_MOST_ERRORS = 20
Unknown = Literal["free", "occupied", "refused"]
SOURCES = ("segments", "free_space", "mesh", "map")
# What of `wall` counts where the file of others says where the walls are.
_WALL_KEYS = {"mesh": set[str](), "map": {"height_m"}}


class StartSpec(Strict):
    """Where the car begins: `at_m` along the centre line of a `segments` track, or `pose` [x, y, yaw_deg].

    Each episode draws the pose within the `range_...` of it, to either side, x along the heading.
    """

    at_m: NotNegative = 1.5
    pose: tuple[Coordinate, Coordinate, Degrees] | None = None
    range_x_m: NotNegative = 0.1
    range_y_m: NotNegative = 0.1
    range_yaw_rad: Annotated[float, Field(ge=0, le=3.15)] = 0.15


class WorldSpec(Strict):
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
    segments: Annotated[list[Segment], Field(min_length=1, max_length=MOST_ITEMS)] | None = None
    niches: Annotated[tuple[Niche, ...], Field(max_length=MOST_ITEMS)] = ()
    free_space: Annotated[list[Ring], Field(min_length=1, max_length=MOST_ITEMS)] | None = None
    mesh: Path | None = None
    scale: Annotated[float, Field(ge=1e-6, le=1e6)] | None = None
    offset: tuple[Coordinate, Coordinate, Coordinate] | None = None
    up: Literal["y", "z"] | None = None
    thickness_m: Annotated[float, Field(ge=0.02, le=10)] | None = None
    low: bool = False
    map: Path | None = None
    unknown: Unknown | None = None
    centre_line: Annotated[list[Point], Field(min_length=2, max_length=MOST_ITEMS)] | None = None
    open_line: tuple[Point, Point] | None = None
    start: StartSpec = StartSpec()
    obstacles: Annotated[tuple[Obstacle, ...], Field(max_length=MOST_ITEMS)] = ()
    waypoints: Annotated[list[Point], Field(min_length=1, max_length=MOST_ITEMS)] | None = None
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
        if "at_m" in self.start.model_fields_set:
            raise ValueError(
                f"start.at_m: for `segments` only, and this is a `{given[0]}`, begun at its start.pose: remove it"
            )
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
        return self

    def _check_keys_of(self, source: str) -> None:
        owners = dict.fromkeys(("scale", "offset", "up", "thickness_m", "low"), "mesh") | {"unknown": "map"}
        stray = [key for key, owner in owners.items() if getattr(self, key) and owner != source]
        if stray:
            raise ValueError(
                f"{', '.join(stray)}: for a `{owners[stray[0]]}` only, and this is a `{source}`: remove it"
            )
        idle = sorted(self.wall.model_fields_set - _WALL_KEYS.get(source, self.wall.model_fields_set))
        if idle:
            raise ValueError(
                f"{', '.join(f'wall.{key}' for key in idle)}: for walls that are built along `segments` or "
                f"`free_space`, and a `{source}` has its own: remove it"
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
    """Write a world file as `folder`/NAME.yaml, what is as by default left out, and return its path.

    Loaded, it is the world that `generate_tracks` makes of the seed of `generate_spec`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{spec.name}.yaml"
    data = spec.model_dump(mode="json", exclude_defaults=True)
    path.write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120), encoding="utf-8")
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
