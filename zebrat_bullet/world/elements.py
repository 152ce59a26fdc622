"""What a world file is made of, in metres and degrees: segments, walls, boxes, obstacles, niches."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

MOST_COORDINATE_M = 1e5
"""Whatever lies further from the origin is a slip of the pen."""
_LONGEST_M = 1000.0
MOST_ITEMS = 5000
Metres = Annotated[float, Field(gt=0, le=_LONGEST_M)]
NotNegative = Annotated[float, Field(ge=0, le=_LONGEST_M)]
Coordinate = Annotated[float, Field(ge=-MOST_COORDINATE_M, le=MOST_COORDINATE_M)]
Degrees = Annotated[float, Field(ge=-3600, le=3600)]
Point = tuple[Coordinate, Coordinate]
Ring = Annotated[list[Point], Field(min_length=3, max_length=MOST_ITEMS)]

# Below this height a wall enters the blind zone of the lidar, and is seen only from afar.
LOWEST_WALL_M = 0.8
WallHeight = Annotated[float, Field(ge=LOWEST_WALL_M, le=_LONGEST_M)]


class Strict(BaseModel):
    """A part of a world file: what it does not know is refused, and so is what is not finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Straight(Strict):
    """A straight of the corridor, measured along its centre line (to the corner point, if a sharp turn follows)."""

    straight: Metres
    width: Metres


class Turn(Strict):
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


class Wall(Strict):
    """The walls round the corridor; with `boxes`, a row of boxes with gaps instead of a smooth wall."""

    height_m: WallHeight = 1.0
    thickness_m: Annotated[float, Field(ge=0.02, le=_LONGEST_M)] = 0.1
    boxes: "Boxes | None" = None


BoxLength = Annotated[float, Field(ge=0.05, le=_LONGEST_M)]


class Boxes(Strict):
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


class _Obstacle(Strict):
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


class Niche(Strict):
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
