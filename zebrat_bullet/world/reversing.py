"""Families of tracks that a car leaves only by backing up."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from zebrat_bullet.world.elements import Buttress, Niche, Straight, Turn
from zebrat_bullet.world.pieces import Draft, Segments, between, cm, one_of_sides, wall_of
from zebrat_bullet.world.schema import StartSpec
from zebrat_bullet.world.track import corner_extent

_SPREAD_M = 0.03
# A start with little room about it.
_START = StartSpec(at_m=1.2, range_x_m=0.04, range_y_m=0.04, range_yaw_rad=0.08)
# The middle of the car stands so far from the closed end that it faces.
_NOSE_IN_M = 0.7
# From the middle of the car to its nose.
_NOSE_M = 0.5


@dataclass(frozen=True)
class _Widths:
    """Where the widths in m begin, at difficulty 0, and end, at 1."""

    corner: tuple[float, float]
    u_turn: tuple[float, float]
    beside_block: tuple[float, float]


_ONLY_WITH_REVERSALS = _Widths((0.92, 0.87), (1.14, 0.92), (0.95, 0.82))
_FROM_WIDE = _Widths((1.2, 0.87), (1.4, 0.92), (1.1, 0.82))


def manoeuvres(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """One or two right angles 0.87-0.94 m wide, or a U-turn of 0.92-1.17 m round a thin wall.

    Every other track with right angles begins right behind a block, from which the car must back away first; so also
    odd numbers of reversals are needed.
    """
    return _tight(rng, difficulty, _ONLY_WITH_REVERSALS)


def narrowing(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """The same turns from where one goes round in one go (1.2 m, U-turns 1.4 m) to the narrowest: what leads there."""
    return _tight(rng, difficulty, _FROM_WIDE)


def _tight(rng: np.random.Generator, difficulty: float, widths: _Widths) -> Iterator[Draft]:
    u_turn, blocked = rng.random() < 0.4, rng.random() < 0.5
    n_corners = int(rng.choice([0, 1, 2], p=[0.3, 0.35, 0.35])) if blocked else int(rng.choice([1, 2]))
    while True:
        if u_turn:
            yield _narrow_u_turn(rng, difficulty, widths)
        else:
            yield _narrow_corners(rng, difficulty, widths, n_corners, blocked)


def _narrow_corners(
    rng: np.random.Generator, difficulty: float, widths: _Widths, n_corners: int, blocked: bool
) -> Draft:
    width = cm(rng.uniform(1.45, 1.6) if blocked else rng.uniform(1.15, 1.4))
    obstacles: tuple[Buttress, ...] = ()
    start = StartSpec()
    if blocked:
        clear = cm(between(difficulty, *widths.beside_block) + rng.uniform(0.0, _SPREAD_M))
        at = cm(rng.uniform(1.9, 2.2))
        ahead = at + _NOSE_M + float(rng.uniform(0.06, 0.15))
        block = Buttress(
            buttress=wall_of(one_of_sides(rng)), at_m=cm(ahead + 0.15), length=0.3, depth=cm(width - clear)
        )
        obstacles, start = (block,), _START.model_copy(update={"at_m": at})
    segments: Segments = [Straight(straight=cm(rng.uniform(2.2, 2.6) + (1.8 if blocked else 0.0)), width=width)]
    for _ in range(n_corners):
        width = cm(between(difficulty, *widths.corner) + rng.uniform(0.0, 0.02))
        corner = Turn(turn=90.0 * one_of_sides(rng), width=width)
        taken = corner_extent(corner, width)
        lead, out = (cm(taken + rng.uniform(0.6, 1.4)) for _ in range(2))
        segments += [Straight(straight=lead, width=width), corner, Straight(straight=out, width=width)]
    last = Straight(straight=cm(rng.uniform(0.8, 1.4)), width=cm(rng.uniform(1.15, 1.4)))
    return Draft([*segments, last], obstacles, start=start)


def _narrow_u_turn(rng: np.random.Generator, difficulty: float, widths: _Widths) -> Draft:
    """Return a lane that turns back and leads out past its own beginning, and so is as narrow there."""
    width = cm(between(difficulty, *widths.u_turn) + rng.uniform(0.0, _SPREAD_M))
    corner = Turn(turn=90.0 * one_of_sides(rng), width=width)
    lead = cm(rng.uniform(3.0, 4.0))
    lanes: Segments = [Straight(straight=length, width=width) for length in (lead, cm(lead + rng.uniform(0.6, 1.2)))]
    across = Straight(straight=cm(width + rng.uniform(0.06, 0.15)), width=width)
    return Draft([lanes[0], corner, across, corner, lanes[1]], start=_START)


def deadends(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """The car faces a closed end: in a pocket beside the corridor, at its end with a pocket to turn, or in a room."""
    kind = rng.choice(["pocket", "end", "room"])
    while True:
        width = cm(between(difficulty, 1.65, 1.2) + rng.uniform(0.0, _SPREAD_M))
        side = one_of_sides(rng)
        # With its start, all of it that can be looked along is under 8 m: no open space is seen across a pocket.
        length = cm(rng.uniform(4.6, 5.6))
        begin: Segments = [Straight(straight=length, width=width)]
        niches: tuple[Niche, ...] = ()
        pose = (_NOSE_IN_M, 0.0, 180.0)
        if kind == "pocket":
            mouth, depth = cm(between(difficulty, 1.5, 1.05) + rng.uniform(0.0, _SPREAD_M)), cm(rng.uniform(1.25, 1.5))
            at = cm(rng.uniform(1.8, 2.6))
            niches = (Niche(niche=wall_of(side), at_m=at, length=mouth, depth=depth),)
            pose = (at, cm(side * (width / 2 + depth - _NOSE_IN_M)), 90.0 * side)
        elif kind == "end":
            mouth, depth = cm(between(difficulty, 1.7, 1.15) + rng.uniform(0.0, _SPREAD_M)), cm(rng.uniform(1.1, 1.4))
            at = cm(rng.uniform(2.2, 3.0))
            niches = (Niche(niche=wall_of(side), at_m=at, length=mouth, depth=depth),)
        else:
            room = cm(between(difficulty, 2.6, 1.9) + rng.uniform(0.0, _SPREAD_M))
            begin = [Straight(straight=cm(rng.uniform(2.4, 2.8)), width=room), Straight(straight=1.5, width=width)]
        # The wider, the longer: from its corner a car must not look out and back into the corridor at once.
        end = Straight(straight=cm(rng.uniform(0.8, 1.4) + 2.0 * (width - 1.2)), width=width)
        start = StartSpec(
            pose=pose, range_x_m=_START.range_x_m, range_y_m=_START.range_y_m, range_yaw_rad=_START.range_yaw_rad
        )
        yield Draft([*begin, *_bend(rng, one_of_sides(rng), width), end], niches=niches, start=start)


def _bend(rng: np.random.Generator, side: float, width: float) -> Segments:
    """Return a sharp turn of 60 to 90 degrees that needs no backing up; round it, a car would see the exit early."""
    turn = Turn(turn=side * float(rng.integers(60, 91)), width=width)
    lead, out = (cm(corner_extent(turn, width) + rng.uniform(0.1, 0.4)) for _ in range(2))
    return [Straight(straight=lead, width=width), turn, Straight(straight=out, width=width)]
