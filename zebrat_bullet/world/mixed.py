"""Mixed tracks: turns of every kind, drawn like the shipped worlds, and not yet checked."""

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np

from zebrat_bullet.world.elements import Boxes, Buttress, Straight, Turn, Wall
from zebrat_bullet.world.pieces import Draft, Segments, cm, one_of_sides
from zebrat_bullet.world.track import corner_extent

_WIDEST_M = 2.0
_COURSE_M = (6.0, 15.0)
# Shares of tight turns that are runs of right angles, and of turns that a long narrow place follows.
_RUN_SHARE, _NARROW_SHARE = 0.15, 0.1
# Share of the tracks whose walls are rows of cardboard boxes.
_BOXED_SHARE = 0.15
# Shares of tracks that ask for at least one buttress, and for at least two.
_BUTTRESSES_APART_M = 2.0
_BUTTRESSES = (0.55, 0.25)


def mixed(rng: np.random.Generator, difficulty: float, car_width_m: float) -> Iterator[Draft]:
    """Draw chains of straights and turns; `difficulty` is the share of tight turns, as wide for any car.

    Tight ones are right-angled corners 1.1-1.4 m wide and U-turns of 1.2-1.5 m.
    """
    aim_m = float(rng.uniform(*_COURSE_M))
    # Drawn once: a row of boxes is refused more often than a smooth wall, and would become rarer.
    boxed = float(rng.random()) < _BOXED_SHARE
    while True:
        yield _draw_track(rng, aim_m, difficulty, boxed)


def _draw_track(rng: np.random.Generator, length_m: float, tightness: float, boxed: bool) -> Draft:
    """Return a track of about the given length; walls of boxes have sharp corners only: there are no round ones."""
    first = Straight(straight=cm(rng.uniform(2.4, 3.2)), width=cm(rng.uniform(1.2, 1.7)))
    segments: Segments = [first]
    travelled = first.straight
    while travelled < length_m - 2.0:
        leg = _draw_leg(rng, tightness, boxed)
        segments += leg
        travelled += sum(map(_run_m, leg))
    last = segments[-1]
    assert isinstance(last, Straight)
    segments.append(Straight(straight=cm(rng.uniform(0.8, 1.6)), width=last.width))
    wall = box_walls(rng) if boxed else Wall()
    return Draft(segments, _draw_buttresses(rng, segments), wall=wall)


def _draw_leg(rng: np.random.Generator, tightness: float, boxed: bool) -> Segments:
    """Return one or more turns, with the straights that lead there and away."""
    if rng.random() < _RUN_SHARE * tightness:
        turns, width = _draw_right_angles(rng)
    elif boxed:
        turn, width = _draw_sharp_turn(rng, tightness)
        turns = [turn]
    else:
        turn, width = _draw_turn(rng, tightness)
        turns = [turn]
    begin, end = turns[0], turns[-1]
    assert isinstance(begin, Turn) and isinstance(end, Turn)
    lead = cm(rng.uniform(0.2, 0.8) + corner_extent(begin, width))
    leg = [Straight(straight=lead, width=width), *turns, *_straights(rng, width, corner_extent(end, width))]
    return leg + _narrow_place(rng) if rng.random() < _NARROW_SHARE else leg


def _draw_turn(rng: np.random.Generator, tightness: float) -> tuple[Turn, float]:
    """Return a turn and the width of the corridor through it."""
    side = one_of_sides(rng)
    if rng.random() < tightness:
        kind = rng.random()
        if kind < 0.4:
            width = cm(rng.uniform(1.1, 1.4))
            return Turn(turn=90.0 * side, radius=0.0, width=width), width
        if kind < 0.7:
            width = cm(rng.uniform(1.1, 1.4))
            return Turn(turn=90.0 * side, radius=cm(rng.uniform(max(0.75, width / 2 + 0.05), 1.1)), width=width), width
        # Passable in one go: the outer corner of the car sweeps 1.36 m about the turning centre.
        width = cm(rng.uniform(1.2, 1.5))
        radius = cm(rng.uniform(max(width / 2 + 0.05, 1.42 - width / 2), 1.1))
        return Turn(turn=180.0 * side, radius=radius, width=width), width
    width = cm(rng.uniform(1.1, 1.9))
    if rng.random() < 0.5:
        return Turn(turn=side * float(rng.choice([30.0, 45.0, 60.0])), radius=0.0, width=width), width
    radius = cm(rng.uniform(max(width / 2 + 0.05, 1.0), 1.8))
    return Turn(turn=side * round(float(rng.uniform(30.0, 180.0))), radius=radius, width=width), width


def _draw_sharp_turn(rng: np.random.Generator, tightness: float) -> tuple[Turn, float]:
    if rng.random() < tightness:
        width = cm(rng.uniform(1.1, 1.4))
        return Turn(turn=90.0 * one_of_sides(rng), width=width), width
    width = cm(rng.uniform(1.1, 1.9))
    return Turn(turn=one_of_sides(rng) * float(rng.choice([30.0, 45.0, 60.0])), width=width), width


def _draw_right_angles(rng: np.random.Generator) -> tuple[Segments, float]:
    """Return two to four right angles with short straights between, never three to the same side in a row."""
    width = cm(rng.uniform(1.15, 1.4))
    sides = [one_of_sides(rng), one_of_sides(rng)]
    for _ in range(int(rng.integers(3))):
        sides.append(-sides[-1] if sides[-1] == sides[-2] else one_of_sides(rng))
    run: Segments = [Turn(turn=90.0 * sides[0], width=width)]
    for side in sides[1:]:
        # Each of its two corners takes half a width of a straight.
        run += [Straight(straight=cm(width + rng.uniform(0.5, 1.2)), width=width), Turn(turn=90.0 * side, width=width)]
    return run, width


def _straights(rng: np.random.Generator, width: float, taken: float) -> Segments:
    """Return what follows a turn: a straight, often with a step in its width."""
    first = Straight(straight=cm(taken + rng.uniform(0.5, 1.3)), width=width)
    if rng.random() < 0.5:
        return [first]
    stepped = cm(np.clip(width + rng.uniform(-0.4, 0.4), 1.0, _WIDEST_M))
    return [first, Straight(straight=cm(rng.uniform(0.4, 1.6)), width=stepped)]


def _narrow_place(rng: np.random.Generator) -> Segments:
    """Return straights that narrow to about a metre, stay so for a while, and widen again."""
    before, after = (cm(rng.uniform(1.15, 1.4)) for _ in range(2))
    return [
        Straight(straight=cm(rng.uniform(0.4, 0.8)), width=before),
        Straight(straight=cm(rng.uniform(1.0, 2.4)), width=cm(rng.uniform(1.0, 1.06))),
        Straight(straight=cm(rng.uniform(0.4, 0.8)), width=after),
    ]


def _draw_buttresses(rng: np.random.Generator, segments: Segments) -> tuple[Buttress, ...]:
    """Return a few blocks that stand out of the walls of different wide straights and leave at least 1.05 m."""
    draw = rng.random()
    n_asked = sum(draw <= share for share in _BUTTRESSES)
    if n_asked == 0:
        return ()
    at, places = 0.0, []
    for i, segment in enumerate(segments):
        run = _run_m(segment)
        corners = [corner_extent(beside, beside.width or 0.0) for beside in segments[max(i - 1, 0) : i + 2]]
        far_from_corners = run / 2 >= max(corners) + 0.5
        if isinstance(segment, Straight) and i > 0 and segment.width >= 1.25 and far_from_corners:
            places.append((at + run / 2, segment.width))
        at += run
    blocks: list[Buttress] = []
    while places and len(blocks) < n_asked:
        middle, width = places[int(rng.integers(len(places)))]
        places = [place for place in places if abs(place[0] - middle) >= _BUTTRESSES_APART_M]
        depth = cm(rng.uniform(0.15, min(0.5, width - 1.06)))
        side: Literal["left", "right"] = "left" if rng.random() < 0.5 else "right"
        blocks.append(Buttress(buttress=side, at_m=cm(middle), length=0.3, depth=depth))
    return tuple(blocks)


def box_walls(rng: np.random.Generator, gap_m: float = 0.03) -> Wall:
    """Return walls as the shipped `real` worlds have them, with gaps of up to `gap_m` between the boxes."""
    row = Boxes(seed=int(rng.integers(2**31)), length_m=(0.5, 0.8), height_m=(0.8, 1.2), gap_m=(0.0, gap_m))
    return Wall(thickness_m=0.35, boxes=row)


def _run_m(segment: Straight | Turn) -> float:
    return segment.straight if isinstance(segment, Straight) else abs(math.radians(segment.turn)) * segment.radius
