"""Random tracks by family: laid from the same segments as the shipped ones, and checked by the same rules."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice
from numbers import Real
from pathlib import Path

import numpy as np
import shapely

from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.files import shown
from zebrat_bullet.processes import in_order
from zebrat_bullet.robot import RobotModel, robot_of
from zebrat_bullet.values import of_kind, whole_number
from zebrat_bullet.world import families, reversing
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.load import default_robot
from zebrat_bullet.world.mixed import mixed
from zebrat_bullet.world.pieces import Draft
from zebrat_bullet.world.schema import WorldSpec
from zebrat_bullet.world.solid import ExtrudedMesh
from zebrat_bullet.world.track import course_m
from zebrat_bullet.world.validate import check_closed, validate_world
from zebrat_bullet.world.walls import walls_are_whole
from zebrat_bullet.world.world import World

# Tracks of seeds from here on are never trained on: they are kept to measure what a policy makes of unknown ones.
HELD_OUT_SEED = 900_000
# Draws drafts of a track without end, given a difficulty and the width of the car in m.
Drafts = Callable[[np.random.Generator, float, float], Iterator[Draft]]
_DRAFTS: dict[str, Drafts] = {
    "mixed": mixed,
    "corridors": families.corridors,
    "corners": families.corners,
    "uturns": families.uturns,
    "curves": families.curves,
    "uneven": families.uneven,
    "bottlenecks": families.bottlenecks,
    "boxes": families.boxes,
    "niches": families.niches,
    "narrowing": reversing.narrowing,
    "manoeuvres": reversing.manoeuvres,
    "deadends": reversing.deadends,
}
FAMILIES = tuple(_DRAFTS)
_COURSE_M = dict.fromkeys(FAMILIES, (6.0, 15.0)) | dict.fromkeys(("narrowing", "manoeuvres", "deadends"), (4.0, 15.0))
_MIXED_DIFFICULTY = 0.6
_MAX_TRIES = 200
_MOST_SEED = 2**63 - 1
# So many seeds go to a process at a time.
_BATCH = 8


def generate_track(
    rng: np.random.Generator,
    *,
    family: str = "mixed",
    difficulty: float | None = None,
    robot: RobotModel | str | Path | None = None,
    name: str = "generated",
) -> World:
    """Draw tracks of a family until one is valid; the same state of `rng` gives the same track.

    Args:
        rng: all randomness comes from here.
        family: one of `FAMILIES`.
        difficulty: 0 to 1; if None it is drawn, and 0.6 for `mixed` tracks, where it is the share of tight turns.
        robot: the car that must fit, by name, file or as `load_robot` gives it; ZebraT if None.
        name: of the world.

    Raises:
        ConfigError: there is no such family or difficulty.
        WorldError: no valid track in many tries.
    """
    of_kind(rng, np.random.Generator, "rng", "give np.random.default_rng(SEED), or take generate_tracks")
    return _valid_track(rng, family=family, difficulty=difficulty, robot=_robot(robot), name=name)[1]


def generate_spec(
    seed: int, *, family: str = "mixed", difficulty: float | None = None, robot: RobotModel | str | Path | None = None
) -> WorldSpec:
    """Return the world file of a seed's track: loaded, it is the world that `generate_tracks` makes.

    Raises:
        ConfigError: there is no such family or difficulty.
        WorldError: no valid track in many tries.
    """
    rng, name = _rng(seed), _name(seed, family)
    return _valid_track(rng, family=family, difficulty=difficulty, robot=_robot(robot), name=name)[0]


def generate_tracks(
    seeds: Iterable[int],
    *,
    family: str | Sequence[str] = "mixed",
    difficulty: float | None = None,
    workers: int = 1,
    robot: RobotModel | str | Path | None = None,
) -> Iterator[World]:
    """Draw one track for each seed, in the order of the seeds, which may go on for ever.

    A track depends on its own seed and on what `generate_track` is told, not on its neighbours or on `workers`.
    It is named `FAMILY-SEED`, `generated-SEED` if mixed.

    Args:
        seeds: not negative; those from `HELD_OUT_SEED` on are for evaluation only.
        family: one of `FAMILIES`; or several, of which seed s takes the one at place s modulo their number.
        difficulty, robot: as `generate_track`.
        workers: as for `in_order`.

    Raises:
        ConfigError: fewer than one worker, no such family, difficulty or robot; or when it is its turn, no such seed.
        WorldError: when it is the turn of a seed that has no valid track.
    """
    families = (family,) if isinstance(family, str) else tuple(family)
    if not families:
        raise ConfigError(f"family is empty; name at least one of {', '.join(FAMILIES)}")
    if not isinstance(seeds, Iterable):
        raise ConfigError(f"seeds must be a range or a list, got {shown(repr(seeds))}; give [{shown(repr(seeds))}]")
    for each in families:
        check_family(each, difficulty)
    track = partial(_track_of, families=families, difficulty=difficulty, robot=_robot(robot))
    return in_order(track, seeds, workers, _BATCH)


def difficulty_of(seed: int, family: str = "mixed") -> float:
    """Return the difficulty of a seed's track if none is asked for.

    Raises:
        ConfigError: there is no such family.
    """
    return _difficulty(_rng(seed), family, None)


def check_family(family: str, difficulty: float | None) -> None:
    """Refuse a family or a difficulty that there is not.

    Raises:
        ConfigError: says what there is.
    """
    if family not in FAMILIES:
        raise ConfigError(f"no family of tracks {shown(repr(family))}: name one of {', '.join(FAMILIES)}")
    if difficulty is not None and not (isinstance(difficulty, Real) and 0.0 <= difficulty <= 1.0):
        raise ConfigError(
            f"difficulty must be 0 (easy) to 1 (hard), got {shown(repr(difficulty))}; leave it out to draw it"
        )


def _difficulty(rng: np.random.Generator, family: str, asked: float | None) -> float:
    check_family(family, asked)
    if family == "mixed":
        return _MIXED_DIFFICULTY if asked is None else asked
    # Drawn in any case, so that one seed's tracks of several difficulties resemble each other.
    drawn = round(float(rng.random()), 3)
    return drawn if asked is None else asked


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(whole_number(seed, "a seed", 0, _MOST_SEED))


def _robot(robot: RobotModel | str | Path | None) -> RobotModel:
    return default_robot() if robot is None else robot_of(robot)


def _name(seed: int, family: str) -> str:
    return f"{'generated' if family == 'mixed' else family}-{seed}"


def _track_of(seed: int, *, families: Sequence[str], difficulty: float | None, robot: RobotModel) -> World:
    rng = _rng(seed)
    family = families[seed % len(families)]
    return generate_track(rng, family=family, difficulty=difficulty, robot=robot, name=_name(seed, family))


def _valid_track(
    rng: np.random.Generator, *, family: str, difficulty: float | None, robot: RobotModel, name: str
) -> tuple[WorldSpec, World]:
    difficulty = _difficulty(rng, family, difficulty)
    shortest, longest = _COURSE_M[family]
    car_width_m = float(np.ptp(robot.footprint_base[:, 1]))
    for draft in islice(_DRAFTS[family](rng, difficulty, car_width_m), _MAX_TRIES):
        if not shortest <= course_m(draft.segments) <= longest:
            continue
        spec = WorldSpec(
            name=name,
            description=f"generated: {family}, difficulty {difficulty:.2f}",
            family=family,
            difficulty=difficulty,
            **vars(draft),
        )
        try:
            world = build_world(spec, Path(name))
            _check_closed(world)
            validate_world(world, robot, name)
        except (WorldError, shapely.GEOSException):  # the latter where rounding makes a wall cross itself
            continue
        assert world.open_line is not None
        if walls_are_whole(world.free_space, world.walls, world.open_line, spec.wall):
            return spec, world
    length_m = float(np.ptp(robot.footprint_base[:, 0]))
    raise WorldError(
        f"{name}: no valid track in {_MAX_TRIES} tries for a car {length_m:.2f} m long and {car_width_m:.2f} m wide; "
        "take another seed or an easier difficulty, or where the car is too large for any, worlds of your own "
        "(docs/your_own_car.md)"
    )


def _check_closed(world: World) -> None:
    """Refuse a mesh with holes, made only where it can have one: an outline touches itself only round a hole in it."""
    assert isinstance(world.mesh, ExtrudedMesh)
    if any(solid.outline.interiors for solid in world.mesh.solids):
        check_closed(world, world.name)
