"""What drawn tracks are put together from: drafts, numbers in whole centimetres, and places along a course."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import numpy as np

from zebrat_bullet.world.elements import Niche, Obstacle, Straight, Turn, Wall
from zebrat_bullet.world.schema import StartSpec
from zebrat_bullet.world.track import corner_extent, course_m

Segments = list[Straight | Turn]
Side = Literal["left", "right"]


@dataclass(frozen=True)
class Draft:
    """The fields of a world file that are drawn; not yet checked."""

    segments: Segments
    obstacles: tuple[Obstacle, ...] = ()
    niches: tuple[Niche, ...] = ()
    wall: Wall = field(default_factory=Wall)
    start: StartSpec = field(default_factory=StartSpec)


@dataclass(frozen=True)
class Stretch:
    """Where along the centre line of a draft a straight wall runs on both sides, in m, and how wide it is there."""

    begin_m: float
    end_m: float
    width_m: float

    @property
    def length_m(self) -> float:
        """How long it is."""
        return self.end_m - self.begin_m


def stretches(segments: Segments) -> list[Stretch]:
    """Return one for each straight, without what the corners beside it take."""
    takes = [0.0, *(corner_extent(segment, segment.width or 0.0) for segment in segments), 0.0]
    ends = np.cumsum([0.0, *(course_m([segment]) for segment in segments)]).tolist()
    return [
        Stretch(begin + takes[i], end - takes[i + 2], segment.width)
        for i, (segment, (begin, end)) in enumerate(zip(segments, pairwise(ends), strict=True))
        if isinstance(segment, Straight)
    ]


def corners_m(segments: Segments) -> list[tuple[float, Turn]]:
    """Return the sharp corners of a draft, each with the distance of its corner point along the centre line in m."""
    ends = np.cumsum([course_m([segment]) for segment in segments]).tolist()
    return [(at, turn) for at, turn in zip(ends, segments, strict=True) if isinstance(turn, Turn) and not turn.radius]


def one_of_sides(rng: np.random.Generator) -> float:
    """Return 1 (left) or -1 (right)."""
    return 1.0 if rng.random() < 0.5 else -1.0


def wall_of(side: float) -> Side:
    """Return the wall to the left of the centre line for 1, to the right for -1."""
    return "left" if side > 0 else "right"


def cm(value: float) -> float:
    """Round up to whole centimetres, so that a generated track can be written down and built again."""
    return math.ceil(float(value) * 100 - 1e-6) / 100


def between(difficulty: float, easy: float, hard: float) -> float:
    """Return what lies so far from easy to hard."""
    return easy + difficulty * (hard - easy)
