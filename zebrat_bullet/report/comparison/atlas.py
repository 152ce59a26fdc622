"""The failure atlas: what went wrong where; each kind with a picture and a command that drives it again."""

import shlex
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fclusterdata

from zebrat_bullet.report.comparison.document import Card, Picture
from zebrat_bullet.report.comparison.evidence import Drive, Way
from zebrat_bullet.report.comparison.thumbnail import draw_place
from zebrat_bullet.world import World

_NEAR_M = 2.0
"""Failures of a group lie at most so far apart."""
_MOST_EPISODES = 12


@dataclass(frozen=True, slots=True)
class Failures:
    """Drives of one world that ended alike, near one another.

    Attributes:
        place, outcome: the world, and how they ended.
        drives: all of them, those of the method that is here the oftenest first.
        at: (x, y) mean of their ends, m, world frame.
    """

    place: str
    outcome: str
    drives: tuple[Drive, ...]
    at: tuple[float, float]


def group_failures(drives: Sequence[Drive]) -> list[Failures]:
    """Return the failures among drives, grouped by world, outcome and place; the largest groups of a world first."""
    alike: dict[tuple[str, str], list[Drive]] = defaultdict(list)
    for drive in drives:
        if not drive.success and drive.x1 is not None:
            alike[drive.place, drive.outcome].append(drive)
    groups = [
        Failures(place, outcome, tuple(members), centre)
        for (place, outcome), ended in alike.items()
        for members, centre in _near(ended)
    ]
    return sorted(groups, key=lambda group: (group.place, -len(group.drives), group.outcome, group.at))


def _near(ended: Sequence[Drive]) -> list[tuple[list[Drive], tuple[float, float]]]:
    ends = np.array([(drive.x1, drive.y1) for drive in ended], dtype=float)
    labels = np.ones(1, int) if len(ends) == 1 else fclusterdata(ends, _NEAR_M, "distance", method="complete")
    found = []
    for label in np.unique(labels):
        members = [ended[i] for i in np.flatnonzero(labels == label).tolist()]
        often = Counter(drive.method for drive in members)
        members.sort(key=lambda d: (-often[d.method], d.method, d.setting, d.agent, d.seed, d.episode))
        x, y = ends[labels == label].mean(axis=0)
        found.append((members, (float(x), float(y))))
    return found


def replay_command(drive: Drive, options: Sequence[str] = ()) -> str:
    """Return the command that drives an episode again and films it.

    Args:
        drive: the episode.
        options: of the command line under which it was driven, such as its ray caster.
    """
    words = ["zebrat", "video", "--agent", drive.agent, "--world", drive.place]
    words += ["--seed", str(drive.seed), "--episode", str(drive.episode), *options]
    return shlex.join(words)


def atlas_card(
    group: Failures,
    number: int,
    world: World,
    footprint: NDArray[np.float64],
    way: Way | None,
    options: Callable[[Drive], Sequence[str]],
) -> Card:
    """Return a group's card: its first drive is the one whose way is drawn, and that the command drives again.

    Args:
        group: the failures.
        number: of the group in its world.
        world: where.
        footprint: (K, 2) outline of the car in its base frame, m.
        way: of the first drive.
        options: of the command line under which a drive was driven.
    """
    picture = draw_place(world, footprint, group.at, group.drives, way)
    x, y = (round(value, 1) + 0.0 for value in group.at)  # no -0.0
    words = group.outcome.replace("_", " ")
    title = f"{len(group.drives)} × {words} at ({x:.1f}, {y:.1f}) m"
    return Card(
        Picture(f"failure_{group.place}_{number:02d}", picture, f"{group.place}: {title}"),
        title,
        _members(group.drives, options),
        replay_command(group.drives[0], options(group.drives[0])),
    )


def _members(drives: Sequence[Drive], options: Callable[[Drive], Sequence[str]]) -> str:
    """Return who failed, in which episodes, and what drives those again where the card's command does not."""
    said: dict[str, list[Drive]] = {}
    for drive in drives:
        name = ", ".join(filter(None, (drive.method, drive.setting, drive.noise, drive.run)))
        said.setdefault(name, []).append(drive)
    lines = []
    for name, of_name in said.items():
        episodes = [str(drive.episode) for drive in of_name]
        more = ", ..." if len(episodes) > _MOST_EPISODES else ""
        how = [_words(drive, options) for drive in (drives[0], of_name[0])]
        other = f" (`{how[1]}`)" if how[0] != how[1] else ""
        lines.append(f"**{name}**{other}: {len(of_name)}, episodes {', '.join(episodes[:_MOST_EPISODES])}{more}")
    return "; ".join(lines)


def _words(drive: Drive, options: Callable[[Drive], Sequence[str]]) -> str:
    return shlex.join(["--agent", drive.agent, *options(drive)])
