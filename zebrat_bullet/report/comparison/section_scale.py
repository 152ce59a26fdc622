"""At scale: the sets over their seeds, on the tracks and on the held-out sets; fairer rivals."""

from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any

from zebrat_bullet.evaluation.endings import BACKED_M
from zebrat_bullet.report.comparison.document import Block, Cell, Grid, Picture, Row, Section, Text
from zebrat_bullet.report.comparison.evidence import (
    STRAIGHT_OUT,
    TRACKS,
    VARIANTS,
    Drive,
    Evidence,
    collided,
    failed,
    rate,
)
from zebrat_bullet.report.comparison.figures import draw_seed_lines
from zebrat_bullet.report.comparison.numbers import points, seeds_cell, share_cell
from zebrat_bullet.report.comparison.rules import mean_time_s
from zebrat_bullet.report.comparison.section_evaluation import ABLATION, comparison_blocks, seeds_blocks
from zebrat_bullet.report.comparison.section_longer import longer_blocks

_MOST_REVERSALS = 6
_POLICIES = (*ABLATION, "shipped", "allround")


def scale_section(evidence: Evidence) -> Section:
    """Return the section on what holds after many times the paper's training."""
    said = Text(
        "**The paper** trains 1,000 episodes in one world, which it puts at 300,000 to 1,000,000 steps; ours end "
        "sooner (above). **Ours**: planar cars in generated tracks, at least 10 million steps a run; judged in "
        "PyBullet with the 3D lidar on the paper's tracks, which these runs have never seen, and as planar cars on "
        "held-out tracks. `shipped` and `allround` are the package's own policies, which learned longer and, "
        "`allround`, also in tracks that need reversing."
    )
    parts = (
        Section("In the paper's tracks, at scale", tuple(comparison_blocks(evidence, "scale", _POLICIES, "scale"))),
        Section("Over seeds", tuple(_over_seeds(evidence))),
        Section("By held-out set", tuple(_held_out(evidence, _by_set))),
        Section("A dearer contact, and a margin", tuple(_variants(evidence))),
        Section("By certified reversals", tuple(_by_reversals(evidence))),
        Section("The paper's algorithms, longer", tuple(longer_blocks(evidence))),
    )
    return Section("At scale", (said,), parts)


def rivals_section(evidence: Evidence) -> Section:
    """Return the section on every setting of the rivals that are not trained here."""
    said = Text(
        "**The paper** gives DWA and TEB a premade map and tells nothing of an error in it or in the pose; it reports "
        "more collisions at a dilation radius of 0.3 and more failures at 0.5. **Ours**: the paper's settings, and "
        "beside them whatever else was driven: tuned ones, a costmap from the live scan, a pose with error."
    )
    found: dict[tuple[str, str], dict[str, list[Drive]]] = defaultdict(lambda: defaultdict(list))
    for drive in evidence.drives:
        if drive.study == "rivals" and drive.sim == "bullet" and drive.place in TRACKS:
            setting = ", ".join(filter(None, (drive.setting, drive.noise)))
            found[drive.method, setting][drive.place].append(drive)
    if not found:
        return Section("Rivals", (said, Text("*Not driven at this budget.*")))
    rows: list[Row] = []
    for (method, setting), places in sorted(found.items()):
        drives = [drive for of_place in places.values() for drive in of_place]
        shares = (rate(drives), rate(drives, failed), rate(drives, collided))
        time_s = mean_time_s(drives)
        numbers = (str(len(drives)), str(shares[0]), *(f"{each.share:.0%}" for each in shares[1:]), _seconds(time_s))
        track = [share_cell(places.get(place)) for place in TRACKS]
        rows.append((method, setting or "-", *(Cell(text, "number") for text in numbers), *track))
    head = ("method", "setting", "episodes", "success (95 %)", "fail", "collision", "time, s", *TRACKS)
    return Section("Rivals", (said, Grid(head, tuple(rows), "Success by track in the last eight columns.")))


def _seconds(time_s: float | None) -> str:
    return "-" if time_s is None else f"{time_s:.1f}"


def _label(evidence: Evidence, method: str, run: str | None) -> str:
    return " ".join(filter(None, (method, evidence.variant(run))))


def _over_seeds(evidence: Evidence) -> list[Block]:
    """Return success on Tracks 1 to 8 of every run at scale, by set and variant."""
    of_run: dict[tuple[str, str], dict[str, list[Drive]]] = defaultdict(lambda: defaultdict(list))
    for drive in evidence.drives:
        if drive.study == "scale" and drive.run is not None and drive.sim == "bullet" and drive.place in TRACKS:
            of_run[_label(evidence, drive.method, drive.run), drive.run][drive.place].append(drive)
    values: dict[str, list[float]] = defaultdict(list)
    for (label, _), places in sorted(of_run.items()):
        if len(places) == len(TRACKS):
            values[label].append(sum(rate(drives).share for drives in places.values()) / len(TRACKS))
    if not values:
        return [Text("*Not driven at this budget.*")]
    return seeds_blocks(values, "scale_seeds", "Success over seeds at scale")


_Shares = dict[str, dict[str, list[float]]]
"""A share a run, by set of runs and by group."""
_Counted = Mapping[str, Any]
"""A row of `Evidence.held_out`."""
_DEAD_END = "dead ends"


def _by_set(row: _Counted) -> str:
    return str(row["place"])


def _reversals(row: _Counted) -> str:
    """Return how often the certificate reverses; a dead end is apart: driven backwards all the way, it has none."""
    if row["family"] == "deadends":
        return _DEAD_END
    n = row["reversals"]
    return str(n) if n < _MOST_REVERSALS else f"{_MOST_REVERSALS}+"


def _held_out(evidence: Evidence, group: Callable[[_Counted], str]) -> list[Block]:
    """Return success on the held-out tracks: a row a set of runs, a column a group of tracks."""
    shares, numbers = _shares(evidence, group, lambda row: row["outcome"] == "success")
    if not shares:
        return [Text("*Not driven at this budget.*")]
    return [_grid(shares, numbers, "Success: mean over seeds, and in brackets from the least to the greatest.")]


def _by_reversals(evidence: Evidence) -> list[Block]:
    """Return success by the certificate's reversals, and who backs up."""
    blocks = _held_out(evidence, _reversals)
    shares, _ = _shares(evidence, _reversals, lambda row: row["outcome"] == "success")
    if not shares:
        return blocks
    plain = {label: shares[label] for label in _POLICIES if label in shares} or shares
    plain = {label: {n: v for n, v in of.items() if n != _DEAD_END} for label, of in plain.items()}
    drawn = draw_seed_lines(plain, "reversals of the certificate")
    backing = _grid(
        *_shares(evidence, _reversals, lambda row: row["backed"]),
        f"Episodes in which the car drove back at least {100 * BACKED_M:.0f} cm in one go, by the reversals of the "
        "certificate: under 0 it need not. Mean over seeds, and in brackets from the least to the greatest.",
    )
    picture = Picture("held_out_reversals", drawn, "Success by certified reversals")
    return [picture, Text("**How often they leave**"), *blocks, Text("**How often they back up**"), backing]


def _shares(
    evidence: Evidence, group: Callable[[_Counted], str], what: Callable[[_Counted], bool | None]
) -> tuple[_Shares, dict[str, int]]:
    """Return which share of a run's episodes on held-out tracks is so, and of how many by group; None is not known."""
    counts: dict[str, dict[str, dict[str, list[int]]]] = defaultdict(
        lambda: defaultdict(lambda: defaultdict(lambda: [0, 0]))
    )
    numbers: dict[str, int] = defaultdict(int)
    for row in evidence.held_out:
        if row["study"] not in ("scale", "rivals") or row["noise"]:
            continue
        is_so, label = what(row), _label(evidence, row["method"], row["run"])
        if is_so is None:
            continue
        if row["run"] is None and row["setting"]:  # of what is not trained here each setting is another driver
            label += f", {row['setting']}"
        name = group(row)
        at = counts[label][name][row["run"] or ""]
        at[0] += row["n"] if is_so else 0
        at[1] += row["n"]
        numbers[name] = max(numbers[name], at[1])
    shares = {
        label: {name: [k / n for k, n in of_run.values()] for name, of_run in sorted(of_group.items())}
        for label, of_group in sorted(counts.items())
    }
    return shares, numbers


def _grid(shares: _Shares, numbers: Mapping[str, int], caption: str) -> Grid:
    groups = sorted(numbers)
    rows: list[Row] = [("*episodes of a run*", *(Cell(f"{numbers[name]:,}", "number") for name in groups))]
    for label, of_label in shares.items():
        rows.append((label, *(seeds_cell(of_label.get(name)) for name in groups)))
    return Grid(("set", *groups), tuple(rows), caption)


def _variants(evidence: Evidence) -> list[Block]:
    """Return what a variant of the rewards changes on the held-out sets without reversals."""
    rows: list[Row] = []
    for method in ABLATION:
        plain = {outcome: evidence.on_sets(method, STRAIGHT_OUT, outcome) for outcome in ("success", "collision")}
        for variant, words in VARIANTS.items():
            its = {outcome: evidence.on_sets(method, STRAIGHT_OUT, outcome, variant) for outcome in plain}
            if its["success"]:
                apart = [points(its[outcome], plain[outcome]) if variant else "-" for outcome in plain]
                shares = [seeds_cell(of_outcome) for of_outcome in its.values()]
                rows.append((method, words or "as it is", str(len(its["success"])), *shares, *apart))
    if not any(row[1] in VARIANTS.values() for row in rows):
        return [Text("*Not driven at this budget.*")]
    head = ("set", "variant", "seeds", "success", "collision", "more success than as it is", "more collisions")
    caption = (
        "The eight held-out sets that need no reversing, together: means over seeds, and in brackets from the least to "
        "the greatest; differences with Welch's 95 % interval over seeds."
    )
    return [Grid(head, tuple(rows), caption)]
