"""How the cars drive: manoeuvres, the ways of all episodes, and the failure atlas."""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.comparison.manifest import Manifest
from zebrat_bullet.report.comparison.atlas import atlas_card, group_failures
from zebrat_bullet.report.comparison.document import Block, Cards, Cell, Grid, Picture, Row, Section, Text
from zebrat_bullet.report.comparison.evidence import METHODS, REAL, TRACKS, Drive, Evidence, Scope
from zebrat_bullet.report.comparison.figures import draw_spreads
from zebrat_bullet.report.comparison.paths import draw_ways
from zebrat_bullet.report.comparison.rules import mean_time_s
from zebrat_bullet.report.comparison.section_evaluation import WORLDS
from zebrat_bullet.report.comparison.settings import key_of, options_of
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import load_world

SHOWN: tuple[tuple[Scope, str, tuple[str, ...]], ...] = (
    ("paper", "the paper's budget", METHODS),
    (
        "scale",
        "at scale, fairer rivals",
        ("DWA", "TEB", "IL", "RL_FT", "RL_FOT", "RL_FMT", "RL_FOMT", "shipped", "allround"),
    ),
)
"""Whose drives are drawn: scope, title, methods."""
_PLACES = (*WORLDS, *REAL)
_MOST_GROUPS = 12


def manoeuvre_section(evidence: Evidence) -> Section:
    """Return the section on how the successes were driven."""
    said = Text(
        "**The paper** says that TEB may turn the robot's heading round, that DDPG and O bring backing up, and shows "
        "times in a picture. **Ours**: all successes on Tracks 1 to 8; of the others, only how often the car was told "
        "to reverse, in the last column. Clearance is the smallest V_obs - V_range along the 32 bearings of the safety "
        "region; steering effort the sum of all changes of the commanded steering for each metre driven; time is that "
        "of the drive divided by the mean time of the oracle (a planner with map, pose and goal) in the same track. "
        "Box: quartiles, whiskers 5-95 %."
    )
    oracle = {place: mean_time_s(evidence.drives_of("scale", "oracle", place)) for place in TRACKS}
    blocks: list[Block] = [said]
    for scope, title, methods in SHOWN:
        driven = {name: [d for at in TRACKS for d in evidence.shown(scope, name, at)] for name in methods}
        drives = {name: [d for d in of_name if d.success] for name, of_name in driven.items() if of_name}
        if any(drives.values()):
            drawn = draw_spreads(
                {what: {n: _values(what, of, oracle) for n, of in drives.items() if of} for what in _MEASURES}
            )
            blocks.append(Picture(f"manoeuvres_{scope}", drawn, f"Manoeuvres: {title}", f"{title.capitalize()}."))
            blocks.append(_medians(evidence, scope, driven, oracle))
    return Section("Manoeuvres", tuple(blocks if len(blocks) > 1 else [*blocks, Text("*Not driven at this budget.*")]))


_MEASURES = ("reversals commanded", "smallest clearance, m", "steering effort, rad/m", "time / oracle's time")


def _medians(evidence: Evidence, scope: Scope, driven: dict[str, list[Drive]], oracle: dict[str, float | None]) -> Grid:
    rows: list[Row] = []
    for name, of_name in driven.items():
        if of_name:
            left, others = ([drive for drive in of_name if drive.success is so] for so in (True, False))
            measured = [_values(what, left, oracle) for what in _MEASURES] + [_values(_MEASURES[0], others, oracle)]
            rows.append((evidence.label(scope, name), Cell(f"{len(left)}", "number"), *map(_median, measured)))
    head = ("method", "successes", *_MEASURES, f"{_MEASURES[0]} where it does not leave")
    return Grid(head, tuple(rows), "Median, and quartiles in brackets.")


def _median(values: Sequence[float]) -> Cell:
    if not values:
        return Cell("-", "number")
    low, middle, high = np.percentile(values, (25, 50, 75))
    return Cell(f"{middle:.2f} ({low:.2f}-{high:.2f})", "number")


def _values(measure: str, drives: Sequence[Drive], oracle: dict[str, float | None]) -> list[float]:
    """Return a measure of each drive of which it is known."""
    found = []
    for drive in drives:
        best = oracle[drive.place]
        value = {
            _MEASURES[0]: float(drive.n_reversals),
            _MEASURES[1]: drive.min_gap_m,
            _MEASURES[2]: drive.steering_effort_rad / drive.distance_m
            if drive.distance_m and drive.steering_effort_rad is not None
            else None,
            _MEASURES[3]: drive.duration_s / best if best else None,
        }[measure]
        if value is not None:
            found.append(value)
    return found


def paths_section(evidence: Evidence) -> Section:
    """Return the section with the ways of all episodes, a picture a track and budget."""
    footprint = load_robot().footprint_base
    parts = []
    for place in _PLACES:
        blocks: list[Block] = []
        for scope, title, methods in SHOWN:
            ways = {name: _ways(evidence, evidence.shown(scope, name, place)) for name in methods}
            ways = {name: of_name for name, of_name in ways.items() if of_name}
            if ways:
                alt = f"Trajectories in {place}, {title}: {', '.join(ways)}"
                drawn = draw_ways(load_world(place), footprint, ways)
                blocks.append(Picture(f"ways_{scope}_{place}", drawn, alt, f"{title.capitalize()}."))
        if blocks:
            parts.append(Section(f"Trajectories in {place}", tuple(blocks), folded=True))
    said = (
        "Every episode of the policy or setting that stands for a method (*Evaluation in the tracks* says which); a "
        "cross is where one ended without success."
    )
    return Section("Trajectories", (Text(said if parts else "*None is recorded.*"),), tuple(parts))


def _ways(evidence: Evidence, drives: Sequence[Drive]) -> list[tuple[Drive, NDArray[np.float32]]]:
    return [(drive, way) for drive in drives if (way := evidence.way(drive)) is not None]


def atlas_section(evidence: Evidence, manifest: Manifest) -> Section:
    """Return the failures of every seed and setting at either budget, grouped, each group with its replay."""
    options = options_of(manifest)
    shown = [
        drive
        for scope, _, methods in SHOWN
        for place in _PLACES
        for name in methods
        for drive in evidence.drives_of(scope, name, place)
    ]
    footprint = load_robot().footprint_base
    by_place = defaultdict(list)
    for group in group_failures(shown):
        by_place[group.place].append(group)
    parts = []
    for place in sorted(by_place, key=_PLACES.index):
        groups, world = by_place[place], load_world(place)
        cards = []
        for i, group in enumerate(groups[:_MOST_GROUPS]):
            way = evidence.way(group.drives[0])
            cards.append(atlas_card(group, i, world, footprint, way, lambda drive: options.get(key_of(drive), ())))
        left_out = groups[_MOST_GROUPS:]
        blocks: list[Block] = [Cards(tuple(cards))]
        if left_out:
            n = sum(len(group.drives) for group in left_out)
            blocks.append(Text(f"Not shown: {len(left_out)} smaller groups with {n} failures together."))
        parts.append(Section(f"Failures in {place}", tuple(blocks), folded=True))
    said = (
        f"{len(shown):,} drives of every seed and setting, {sum(not drive.success for drive in shown):,} failures, "
        "grouped by track, kind and place (ends of a group lie within 2 m). Runs with a dearer contact or a margin, "
        "runs after fine-tuning or under the paper's algorithms for longer, the oracle and the held-out sets are not "
        "among them. The filled car is the first of a group, in "
        "blue the way it came; its command drives it again and films it. The others need another `--episode`, and the "
        "`--agent` and options that stand beside them."
    )
    return Section("Failure atlas", (Text(said if shown else "*Not driven at this budget.*"),), tuple(parts))


def replay_commands(section: Section) -> list[str]:
    """Return every command of an atlas."""
    cards = [card for block in section.blocks if isinstance(block, Cards) for card in block.cards]
    return [card.command for card in cards] + [command for part in section.parts for command in replay_commands(part)]
