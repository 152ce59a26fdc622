"""Families of tracks that can mostly be driven without reversing, each about one thing, from easy to hard.

A difficulty is 0 (wide) to 1 (as narrow as a planner passes without reversing, or nearly so). Widths are ZebraT's, but
for the bottlenecks, which are as wide as the car and a little more.
"""

from collections.abc import Callable, Iterator

import numpy as np

from zebrat_bullet.world.elements import Buttress, Niche, Obstacle, Straight, Turn
from zebrat_bullet.world.mixed import box_walls
from zebrat_bullet.world.pieces import (
    Draft,
    Segments,
    Stretch,
    between,
    cm,
    corners_m,
    one_of_sides,
    stretches,
    wall_of,
)
from zebrat_bullet.world.track import corner_extent, course_m

# A drawn width is up to this much more than its difficulty says.
_SPREAD_M = 0.06
_COURSE_M, _LONGEST_M = (6.5, 14.0), 15.0
_BUTTRESS_M = 0.3


def corridors(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """Kinks of 15 to 60 degrees: the sharper, the wider."""

    def leg() -> Segments:
        angle = round(float(rng.uniform(15.0, 60.0)))
        width = _width(rng, difficulty, 1.7, 0.74 + 0.24 * angle / 60.0)
        return [*_sharp(rng, one_of_sides(rng) * angle, width)]

    return _chains(rng, difficulty, leg)


def corners(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """Sharp right angles, every other one with a step in width right behind it."""

    def leg() -> Segments:
        width = _width(rng, difficulty, 1.7, 0.95)
        lead, turn, out = _sharp(rng, 90.0 * one_of_sides(rng), width)
        if rng.random() < 0.5:
            return [lead, turn, out]
        other = _width(rng, difficulty, 1.8, 1.0)
        return [lead, turn, Straight(straight=cm(width / 2), width=width), Straight(straight=out.straight, width=other)]

    return _chains(rng, difficulty, leg)


def uturns(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """Round about a block, or by two right angles about a thin wall."""

    def leg() -> Segments:
        side = one_of_sides(rng)
        if rng.random() < 0.5:
            # In one go: the outer corner of the car sweeps 1.36 m about the turning centre, the inner side 0.52 m.
            outer = between(difficulty, 2.0, 1.46) + float(rng.uniform(0.0, _SPREAD_M))
            width = cm(min(_width(rng, difficulty, 1.6, 1.1), outer - 0.05))
            turns: Segments = [Turn(turn=180.0 * side, radius=cm(outer - width / 2), width=width)]
        else:
            width = _width(rng, difficulty, 1.7, 1.2)
            corner, wall_m = Turn(turn=90.0 * side, width=width), float(rng.uniform(0.06, 0.15))
            turns = [corner, Straight(straight=cm(width + wall_m), width=width), corner]
        taken = corner_extent(turns[0], width)
        lead = Straight(straight=cm(taken + rng.uniform(0.3, 0.8)), width=width)
        return [lead, *turns, Straight(straight=cm(taken + rng.uniform(0.6, 1.4)), width=width)]

    return _chains(rng, difficulty, leg, after=3.4)


def curves(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """Round bends of 30 to 180 degrees, and S-bends without a straight between."""

    def leg() -> Segments:
        side, width = one_of_sides(rng), _width(rng, difficulty, 1.7, 0.93)
        bends: Segments = []
        for turned in (1.0, -1.0) if rng.random() < 0.5 else (1.0,):
            angle = round(float(rng.uniform(30.0, 180.0 if not bends else 120.0)))
            radius = cm(max(width / 2 + 0.1, between(difficulty, 1.5, 1.0)) + rng.uniform(0.0, 0.6))
            bends.append(Turn(turn=turned * side * angle, radius=radius, width=width))
        ends = (Straight(straight=cm(rng.uniform(0.3, 1.0)), width=width) for _ in range(2))
        return [next(ends), *bends, next(ends)]

    return _chains(rng, difficulty, leg)


def uneven(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """Steps in width one after the other, buttresses to both sides, a slight kink here and there."""

    def leg() -> Segments:
        wide = float(rng.uniform(1.35, 1.7))
        steps: Segments = [
            Straight(straight=cm(rng.uniform(0.5, 1.2)), width=_width(rng, difficulty, 1.3, 0.82)),
            Straight(straight=cm(rng.uniform(1.3, 2.6)), width=cm(wide)),
        ]
        return (
            steps if rng.random() < 0.6 else [*steps, *_sharp(rng, one_of_sides(rng) * rng.integers(15, 46), cm(wide))]
        )

    def blocks(segments: Segments) -> tuple[Obstacle, ...]:
        side, made = one_of_sides(rng), []
        for stretch in _roomy(segments, 1.2, 1.3):
            clear = _width(rng, difficulty, 1.15, 0.88)
            if rng.random() < 0.8 and clear < stretch.width_m - 0.1:
                middle = (stretch.begin_m + stretch.end_m) / 2
                made.append(_buttress(wall_of(side), middle, cm(stretch.width_m - clear)))
                side = -side
        return tuple(made)

    return _chains(rng, difficulty, leg, blocks=blocks)


def bottlenecks(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """Places a little wider than the car, short or long, in the middle or (two buttresses) to one side."""
    slack_m = between(difficulty, 0.5, 0.06)

    def narrow() -> float:
        return cm(car_width_m + slack_m + float(rng.uniform(0.0, _SPREAD_M / 2)))

    def leg() -> Segments:
        wide = cm(rng.uniform(1.2, 1.6))
        room: Segments = [Straight(straight=cm(rng.uniform(1.3, 1.9)), width=wide)]
        if rng.random() < 0.4:
            room += [Turn(turn=float(one_of_sides(rng) * rng.integers(15, 61)), width=wide), *room]
        kind = rng.random()
        if kind < 0.35:
            return [*room, Straight(straight=cm(rng.uniform(1.0, 2.2)), width=narrow()), *room[:1]]
        if kind < 0.65:
            return [*room, Straight(straight=cm(rng.uniform(0.15, 0.4)), width=narrow()), *room[:1]]
        return [*room, Straight(straight=cm(rng.uniform(2.6, 3.2)), width=wide)]

    def pairs(segments: Segments) -> tuple[Obstacle, ...]:
        made: list[Obstacle] = []
        for stretch in _roomy(segments, 2.4, 1.1):
            blocked = stretch.width_m - narrow()
            left = cm(blocked * float(rng.uniform(0.2, 0.8)))
            middle = (stretch.begin_m + stretch.end_m) / 2
            made += [_buttress("left", middle, left), _buttress("right", middle, cm(blocked - left))]
        return tuple(made)

    return _chains(rng, difficulty, leg, blocks=pairs)


def boxes(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """Kinks and right angles between rows of cardboard boxes with gaps."""

    def leg() -> Segments:
        angle = 90.0 if rng.random() < 0.4 else float(rng.choice([30.0, 45.0, 60.0]))
        return [*_sharp(rng, one_of_sides(rng) * angle, _width(rng, difficulty, 1.7, 1.07))]

    gap_m = cm(between(difficulty, 0.03, 0.08))
    for draft in _chains(rng, difficulty, leg):
        yield Draft(draft.segments, wall=box_walls(rng, gap_m))


def niches(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """Dead ends in the walls: beside the straights, and straight ahead where the way turns off."""

    def leg() -> Segments:
        width = _width(rng, difficulty, 1.7, 1.08)
        lead, turn, out = _sharp(rng, one_of_sides(rng) * float(rng.choice([45.0, 90.0, 90.0])), width)
        return [Straight(straight=cm(lead.straight + rng.uniform(0.5, 1.5)), width=width), turn, out]

    for draft in _chains(rng, difficulty, leg):
        yield Draft(draft.segments, niches=tuple(_dead_ends(rng, difficulty, draft.segments)))


def _dead_ends(rng: np.random.Generator, difficulty: float, segments: Segments) -> Iterator[Niche]:
    """Draw pockets that look the more like a way on, the harder: as wide as the corridor, and deep."""

    def depth() -> float:
        return cm(between(difficulty, 0.4, 1.6) + rng.uniform(0.0, 0.4))

    for at, turn in corners_m(segments):
        if abs(turn.turn) == 90.0 and turn.width is not None and rng.random() < 0.7:
            # A centimetre past the corner point, where the centre line has turned.
            mouth = cm(between(difficulty, 0.6, turn.width - 0.04))
            yield Niche(
                niche=wall_of(-turn.turn), at_m=cm(at + 0.01), length=min(mouth, turn.width - 0.04), depth=depth()
            )
    for stretch in stretches(segments)[1:]:
        mouth = cm(between(difficulty, 0.5, 1.0) + rng.uniform(0.0, 0.2))
        if stretch.length_m > mouth + 0.2 and rng.random() < 0.7:
            at = rng.uniform(stretch.begin_m + mouth / 2 + 0.05, stretch.end_m - mouth / 2 - 0.05)
            yield Niche(niche=wall_of(one_of_sides(rng)), at_m=cm(at), length=mouth, depth=depth())


def _chains(
    rng: np.random.Generator,
    difficulty: float,
    leg: Callable[[], Segments],
    *,
    blocks: Callable[[Segments], tuple[Obstacle, ...]] = lambda segments: (),
    after: float = 0.8,
) -> Iterator[Draft]:
    """Draw tracks of legs, as long as one aim says, with a start wide enough for its random range.

    Args:
        rng: all randomness comes from here.
        difficulty: of the start's width.
        leg: draws segments.
        blocks: draws what stands in a track.
        after: shortest last straight in m.
    """
    aim_m = float(rng.uniform(*_COURSE_M))
    while True:
        first = Straight(
            straight=cm(rng.uniform(2.2, 2.8)), width=cm(between(difficulty, 1.6, 1.15) + rng.uniform(0, 0.2))
        )
        segments: Segments = [first, *leg()]
        last_m = cm(after + rng.uniform(0.0, 0.8))
        while course_m(segments) + last_m < aim_m - 1.5:
            more = leg()
            if course_m([*segments, *more]) + last_m > _LONGEST_M:
                break
            segments += more
        end = segments[-1]
        assert isinstance(end, Straight)
        segments.append(Straight(straight=last_m, width=end.width))
        yield Draft(segments, blocks(segments))


def _sharp(rng: np.random.Generator, turn_deg: float, width: float) -> tuple[Straight, Turn, Straight]:
    turn = Turn(turn=float(turn_deg), width=width)
    lead, out = (cm(corner_extent(turn, width) + rng.uniform(0.3, 1.0)) for _ in range(2))
    return Straight(straight=lead, width=width), turn, Straight(straight=out, width=width)


def _width(rng: np.random.Generator, difficulty: float, easy: float, hard: float) -> float:
    return cm(between(difficulty, easy, hard) + rng.uniform(0.0, _SPREAD_M))


def _roomy(segments: Segments, least_m: float, width_m: float) -> list[Stretch]:
    """Return the stretches, not the first and last, that are at least so long and so wide."""
    return [at for at in stretches(segments)[1:-1] if at.length_m >= least_m and at.width_m >= width_m]


def _buttress(wall: str, at_m: float, depth: float) -> Buttress:
    return Buttress(buttress="left" if wall == "left" else "right", at_m=cm(at_m), length=_BUTTRESS_M, depth=depth)
