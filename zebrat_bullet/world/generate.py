"""Random tracks for training: laid from the same segments as the shipped ones, and checked by the same rules."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from functools import partial
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.draw import draw_track
from zebrat_bullet.world.load import default_robot
from zebrat_bullet.world.solid import ExtrudedMesh
from zebrat_bullet.world.track import course_m
from zebrat_bullet.world.validate import check_closed, validate_world
from zebrat_bullet.world.walls import walls_are_whole
from zebrat_bullet.world.world import World

# Tracks of seeds from here on are never trained on: they are kept to measure what a policy makes of unknown ones.
HELD_OUT_SEED = 900_000
_MAX_TRIES = 200
# So many seeds go to a process at a time, and so many such batches wait for each process.
_BATCH, _WAITING = 8, 3
# Share of the tracks whose walls are rows of cardboard boxes.
_BOXED_SHARE = 0.15


def generate_track(
    rng: np.random.Generator,
    *,
    length_m: tuple[float, float] = (6.0, 15.0),
    tightness: float = 0.6,
    variety: bool = True,
    robot: RobotModel | None = None,
    name: str = "generated",
) -> World:
    """Draw tracks until one is valid; the same state of `rng` gives the same track.

    Args:
        rng: all randomness comes from here.
        length_m: shortest and longest course, from the closed end to the open-space line.
        tightness: share of turns drawn from the tight ones (right-angled corners 1.1-1.4 m wide, U-turns of 1.2-1.5 m).
        variety: also draw what the shipped unseen worlds have: walls of cardboard boxes, runs of right angles, long
            places a metre wide, two buttresses. Without it the tracks are those that the shipped policies learned on:
            in one of fifty a wall beside the exit has an opening of up to 0.3 m.
        robot: the car that must fit; ZebraT if None.
        name: of the world.

    Raises:
        WorldError: no valid track of that length in many tries; widen `length_m`.
    """
    robot = robot or default_robot()
    aim_m = float(rng.uniform(*length_m))
    # Drawn once: a row of boxes is refused more often than a smooth wall, and would become rarer.
    boxed = variety and float(rng.random()) < _BOXED_SHARE
    for _ in range(_MAX_TRIES):
        spec = draw_track(rng, length_m=aim_m, tightness=tightness, variety=variety, boxed=boxed, name=name)
        assert spec.segments is not None
        if not length_m[0] <= course_m(spec.segments) <= length_m[1]:
            continue
        try:
            world = build_world(spec, Path(name))
            _check_closed(world)
            validate_world(world, robot, name)
        except WorldError:
            continue
        assert world.open_line is not None
        if not variety or walls_are_whole(world.free_space, world.walls, world.open_line, spec.wall):
            return world
    raise WorldError(f"{name}: length_m: no valid track of {length_m} m in {_MAX_TRIES} tries; widen the range")


def generate_tracks(
    seeds: Iterable[int],
    *,
    workers: int = 1,
    length_m: tuple[float, float] = (6.0, 15.0),
    tightness: float = 0.6,
    variety: bool = True,
    robot: RobotModel | None = None,
) -> Iterator[World]:
    """Draw one track for each seed, named `generated-SEED`, in the order of the seeds, which may go on for ever.

    A track depends on its own seed and on what `generate_track` is told, not on its neighbours or on `workers`.

    Args:
        seeds: not negative; those from `HELD_OUT_SEED` on are for evaluation only.
        workers: 1 draws here; more draw in so many processes, which import the caller's main module again, so a script
            needs its `if __name__ == "__main__":`.
        length_m, tightness, variety, robot: as `generate_track`.

    Raises:
        ConfigError: fewer than one worker.
        WorldError: when it is the turn of a seed that has no valid track.
    """
    if workers < 1:
        raise ConfigError(f"workers must be at least 1, got {workers}")
    track = partial(_track_of, length_m=length_m, tightness=tightness, variety=variety, robot=robot or default_robot())
    return map(track, seeds) if workers == 1 else _in_processes(track, iter(seeds), workers)


def _track_of(seed: int, *, length_m: tuple[float, float], tightness: float, variety: bool, robot: RobotModel) -> World:
    return generate_track(
        np.random.default_rng(seed),
        length_m=length_m,
        tightness=tightness,
        variety=variety,
        robot=robot,
        name=f"generated-{seed}",
    )


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
