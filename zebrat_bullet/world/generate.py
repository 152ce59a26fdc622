"""Random tracks for training: laid from the same segments as the shipped ones, and checked by the same rules."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from functools import partial
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Literal

import numpy as np

from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.load import default_robot
from zebrat_bullet.world.schema import Buttress, Straight, Turn, WorldSpec
from zebrat_bullet.world.solid import ExtrudedMesh
from zebrat_bullet.world.track import corner_extent, course_m
from zebrat_bullet.world.validate import check_closed, validate_world
from zebrat_bullet.world.world import World

# Tracks of seeds from here on are never trained on: they are kept to measure what a policy makes of unknown ones.
HELD_OUT_SEED = 900_000
_MAX_TRIES = 200
# So many seeds go to a process at a time, and so many such batches wait for each process.
_BATCH, _WAITING = 8, 3
_WIDEST_M = 2.0


def generate_track(
    rng: np.random.Generator,
    *,
    length_m: tuple[float, float] = (6.0, 15.0),
    tightness: float = 0.6,
    robot: RobotModel | None = None,
    name: str = "generated",
) -> World:
    """Draw tracks until one is valid; the same state of `rng` gives the same track.

    Args:
        rng: all randomness comes from here.
        length_m: shortest and longest course, from the closed end to the open-space line.
        tightness: share of turns drawn from the tight ones (right-angled corners 1.1-1.4 m wide, U-turns of 1.2-1.5 m).
        robot: the car that must fit; ZebraT if None.
        name: of the world.

    Raises:
        WorldError: no valid track of that length in many tries; widen `length_m`.
    """
    robot = robot or default_robot()
    aim_m = float(rng.uniform(*length_m))
    for _ in range(_MAX_TRIES):
        spec = _draw(rng, aim_m, tightness, name)
        assert spec.segments is not None
        if not length_m[0] <= course_m(spec.segments) <= length_m[1]:
            continue
        try:
            world = build_world(spec, Path(name))
            _check_closed(world)
            validate_world(world, robot, name)
        except WorldError:
            continue
        return world
    raise WorldError(f"{name}: length_m: no valid track of {length_m} m in {_MAX_TRIES} tries; widen the range")


def generate_tracks(
    seeds: Iterable[int],
    *,
    workers: int = 1,
    length_m: tuple[float, float] = (6.0, 15.0),
    tightness: float = 0.6,
    robot: RobotModel | None = None,
) -> Iterator[World]:
    """Draw one track for each seed, named `generated-SEED`, in the order of the seeds, which may go on for ever.

    A track depends on its own seed and on what `generate_track` is told, not on its neighbours or on `workers`.

    Args:
        seeds: not negative; those from `HELD_OUT_SEED` on are for evaluation only.
        workers: 1 draws here; more draw in so many processes, which import the caller's main module again, so a script
            needs its `if __name__ == "__main__":`.
        length_m, tightness, robot: as `generate_track`.

    Raises:
        ConfigError: fewer than one worker.
        WorldError: when it is the turn of a seed that has no valid track.
    """
    if workers < 1:
        raise ConfigError(f"workers must be at least 1, got {workers}")
    track = partial(_track_of, length_m=length_m, tightness=tightness, robot=robot or default_robot())
    return map(track, seeds) if workers == 1 else _in_processes(track, iter(seeds), workers)


def _track_of(seed: int, *, length_m: tuple[float, float], tightness: float, robot: RobotModel) -> World:
    rng = np.random.default_rng(seed)
    return generate_track(rng, length_m=length_m, tightness=tightness, robot=robot, name=f"generated-{seed}")


def _in_processes(track: Callable[[int], World], seeds: Iterator[int], workers: int) -> Iterator[World]:
    """Yield the tracks in the order of the seeds; a consumer that stops early stops the processes too."""
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        waiting: deque[Future[list[World]]] = deque()
        try:
            while batch := list(islice(seeds, _BATCH)):
                waiting.append(pool.submit(_tracks_of, track, batch))
                if len(waiting) > workers * _WAITING:
                    yield from waiting.popleft().result()
            while waiting:
                yield from waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


def _tracks_of(track: Callable[[int], World], seeds: list[int]) -> list[World]:
    return [track(seed) for seed in seeds]


def _check_closed(world: World) -> None:
    """Refuse a mesh with holes, made only where it can have one: an outline touches itself only round a hole in it."""
    assert isinstance(world.mesh, ExtrudedMesh)
    if any(solid.outline.interiors for solid in world.mesh.solids):
        check_closed(world, world.name)


def _draw(rng: np.random.Generator, length: float, tightness: float, name: str) -> WorldSpec:
    """Draw a chain of straights and turns of about the given length, not yet checked."""
    first = Straight(straight=_cm(rng.uniform(2.4, 3.2)), width=_cm(rng.uniform(1.2, 1.7)))
    segments: list[Straight | Turn] = [first]
    travelled, last_width = first.straight, first.width
    while travelled < length - 2.0:
        turn, width = _draw_turn(rng, tightness)
        lead = _cm(rng.uniform(0.2, 0.8) + corner_extent(turn, width))
        tail = _straights(rng, width, corner_extent(turn, width))
        segments += [Straight(straight=lead, width=width), turn, *tail]
        last_width = tail[-1].width
        travelled += lead + abs(math.radians(turn.turn)) * turn.radius + sum(part.straight for part in tail)
    segments.append(Straight(straight=_cm(rng.uniform(0.8, 1.6)), width=last_width))
    return WorldSpec(name=name, description="generated", segments=segments, obstacles=_draw_buttresses(rng, segments))


def _draw_turn(rng: np.random.Generator, tightness: float) -> tuple[Turn, float]:
    """Return a turn and the width of the corridor through it."""
    side = 1.0 if rng.random() < 0.5 else -1.0
    if rng.random() < tightness:
        kind = rng.random()
        if kind < 0.4:
            width = _cm(rng.uniform(1.1, 1.4))
            return Turn(turn=90.0 * side, radius=0.0, width=width), width
        if kind < 0.7:
            width = _cm(rng.uniform(1.1, 1.4))
            return Turn(turn=90.0 * side, radius=_cm(rng.uniform(max(0.75, width / 2 + 0.05), 1.1)), width=width), width
        # Passable in one go: the outer corner of the car sweeps 1.36 m about the turning centre.
        width = _cm(rng.uniform(1.2, 1.5))
        radius = _cm(rng.uniform(max(width / 2 + 0.05, 1.42 - width / 2), 1.1))
        return Turn(turn=180.0 * side, radius=radius, width=width), width
    width = _cm(rng.uniform(1.1, 1.9))
    if rng.random() < 0.5:
        return Turn(turn=side * float(rng.choice([30.0, 45.0, 60.0])), radius=0.0, width=width), width
    radius = _cm(rng.uniform(max(width / 2 + 0.05, 1.0), 1.8))
    return Turn(turn=side * round(float(rng.uniform(30.0, 180.0))), radius=radius, width=width), width


def _straights(rng: np.random.Generator, width: float, taken: float) -> list[Straight]:
    """Return what follows a turn: a straight, often with a step in its width."""
    first = Straight(straight=_cm(taken + rng.uniform(0.5, 1.3)), width=width)
    if rng.random() < 0.5:
        return [first]
    stepped = _cm(np.clip(width + rng.uniform(-0.4, 0.4), 1.0, _WIDEST_M))
    return [first, Straight(straight=_cm(rng.uniform(0.4, 1.6)), width=stepped)]


def _draw_buttresses(rng: np.random.Generator, segments: list[Straight | Turn]) -> tuple[Buttress, ...]:
    """Return at most one block that stands out of a wall of a wide straight and leaves at least 1.05 m."""
    if rng.random() > 0.5:
        return ()
    at, places = 0.0, []
    for i, segment in enumerate(segments):
        run = segment.straight if isinstance(segment, Straight) else abs(math.radians(segment.turn)) * segment.radius
        corners = [corner_extent(beside, beside.width or 0.0) for beside in segments[max(i - 1, 0) : i + 2]]
        far_from_corners = run / 2 >= max(corners) + 0.5
        if isinstance(segment, Straight) and i > 0 and segment.width >= 1.25 and far_from_corners:
            places.append((at + run / 2, segment.width))
        at += run
    if not places:
        return ()
    middle, width = places[int(rng.integers(len(places)))]
    depth = _cm(rng.uniform(0.15, min(0.5, width - 1.06)))
    side: Literal["left", "right"] = "left" if rng.random() < 0.5 else "right"
    return (Buttress(buttress=side, at_m=_cm(middle), length=0.3, depth=depth),)


def _cm(value: float) -> float:
    """Round up to whole centimetres, so that a generated track can be written down and built again."""
    return math.ceil(float(value) * 100 - 1e-6) / 100
