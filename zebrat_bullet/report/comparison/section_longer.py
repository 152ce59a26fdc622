"""The paper's algorithms and rewards on planar cars in generated tracks, its budget many times over."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

from zebrat_bullet.report.comparison.document import Block, Cell, Grid, Picture, Row, Text
from zebrat_bullet.report.comparison.evidence import TRACKS, Drive, Evidence
from zebrat_bullet.report.comparison.figures import draw_bands
from zebrat_bullet.report.comparison.numbers import points, seeds_cell, share_cell
from zebrat_bullet.report.comparison.section_training import learning_bands

_STUDY = "paper-at-scale"
_Set = tuple[str, str]
"""An algorithm and a reward."""


@dataclass
class _Own:
    """What runs of one set and length say of themselves: a value a completed run.

    Attributes:
        n_asked, n_complete: how many they are.
        best: success and collisions of the policy kept, the best of a run's evaluations.
        last: success at the last evaluation.
    """

    n_asked: int = 0
    n_complete: int = 0
    best: dict[str, list[float]] = field(default_factory=lambda: {"success": [], "collision": []})
    last: list[float] = field(default_factory=list)


def longer_blocks(evidence: Evidence) -> list[Block]:
    """Return curves, shares and differences of the sets of every length, the shortest first."""
    runs = [run for run in evidence.runs if run["study"] == _STUDY]
    if not runs:
        return [Text("*Not driven at this budget.*")]
    steps: dict[str, int] = defaultdict(int)
    for run in runs:
        steps[run["asked"] or ""] = max(steps[run["asked"] or ""], run["steps"] or 0)
    lengths = sorted(steps, key=lambda asked: (steps[asked], asked))
    own = _own(evidence, runs)
    drawn = [_curve(evidence, asked, f"curve_longer_{n}") for n, asked in enumerate(lengths, start=1)]
    return [*filter(None, drawn), _reached(evidence, runs, own, lengths), _apart(own, lengths)]


def _own(evidence: Evidence, runs: Sequence[Mapping[str, Any]]) -> dict[tuple[_Set, str], _Own]:
    last: dict[str, tuple[int, float]] = {}
    for row in evidence.learning:
        if row["success"] is not None:
            last[row["run"]] = max(last.get(row["run"], (-1, 0.0)), (row["total_steps"] or 0, row["success"]))
    found: dict[tuple[_Set, str], _Own] = defaultdict(_Own)
    for run in runs:
        at = found[(run["algorithm"], run["reward"]), run["asked"] or ""]
        at.n_asked += 1
        if run["state"] == "complete":
            at.n_complete += 1
            for what, of_runs in at.best.items():
                if run[f"best_{what}"] is not None:
                    of_runs.append(run[f"best_{what}"])
            if run["run"] in last:
                at.last.append(last[run["run"]][1])
    return dict(found)


def _reached(
    evidence: Evidence, runs: Sequence[Mapping[str, Any]], own: Mapping[tuple[_Set, str], _Own], lengths: Sequence[str]
) -> Grid:
    """Return what each set reaches: in its own evaluations, on the tracks, on held-out tracks."""
    tracks: dict[str | None, list[Drive]] = defaultdict(list)
    for drive in evidence.drives:
        if drive.study == _STUDY and drive.place in TRACKS:
            tracks[drive.run].append(drive)
    held_out: dict[str | None, Counter[str]] = defaultdict(Counter)
    for row in evidence.held_out:
        if row["study"] == _STUDY and row["reversals"] == 0 and row["family"] != "deadends":
            held_out[row["run"]][row["outcome"]] += row["n"]
    rows: list[Row] = []
    for who, asked in sorted(own, key=lambda at: (at[0], lengths.index(at[1]))):
        at = own[who, asked]
        names = [run["run"] for run in runs if (run["algorithm"], run["reward"], run["asked"] or "") == (*who, asked)]
        counts = [held_out[name] for name in names if held_out[name]]
        judged = [drive for name in names for drive in tracks[name]]
        shares = [seeds_cell([n[what] / n.total() for n in counts]) for what in ("success", "collision")]
        cells = (*map(seeds_cell, (*at.best.values(), at.last)), share_cell(judged), *shares)
        rows.append((_name(who), asked, f"{at.n_complete} of {at.n_asked}", *cells))
    evaluations = ("own evaluations: success", "collision", "the last one's: success")
    judgements = ("Tracks 1-8, best seed", "held out, best seed: success", "collision")
    caption = (
        "Own evaluations: the best policy of each run in the generated tracks that it was chosen by, so they flatter "
        "most what swings most from one evaluation to the next; beside them that of the last evaluation. Means over "
        "seeds, and in brackets from the least to the greatest. Held out: the best seed in the "
        "held-out tracks that need no reversing, dead ends not among them. What neither leaves nor touches stalls, "
        "leaves where there is no exit, or runs out of time."
    )
    return Grid(("set", "asked for", "seeds complete", *evaluations, *judgements), tuple(rows), caption)


def _apart(own: Mapping[tuple[_Set, str], _Own], lengths: Sequence[str]) -> Grid:
    """Return how far apart two sets are of one length that differ in algorithm or reward alone."""
    rows: list[Row] = []
    for a, b in _pairs(sorted({who for who, _ in own})):
        for asked in lengths:
            if (a, asked) in own and (b, asked) in own:
                one, other = own[a, asked], own[b, asked]
                apart = [points(one.best[what], other.best[what]) for what in one.best]
                cells = (apart[0], points(one.last, other.last), apart[1])
                rows.append((f"{_name(a)} - {_name(b)}", asked, *(Cell(text, "number") for text in cells)))
    head = ("set - set", "asked for", "success, best evaluations", "success, last evaluations", "collision, best")
    caption = "Points of 100 between the means over seeds of their own evaluations, with Welch's 95 % interval."
    return Grid(head, tuple(rows), caption)


def _pairs(sets: Sequence[_Set]) -> Iterator[tuple[_Set, _Set]]:
    """Yield the pairs of sets that differ in one thing: first in the reward, then in the algorithm."""
    for same, differs in ((0, 1), (1, 0)):
        yield from ((a, b) for a, b in combinations(sets, 2) if a[same] == b[same] and a[differs] != b[differs])


def _name(who: _Set) -> str:
    algorithm, reward = who
    return f"{algorithm.upper()} {reward.upper()}"


def _curve(evidence: Evidence, asked: str, name: str) -> Picture | None:
    """Draw the evaluations of the runs of one length; None where there are none."""

    def keep(run: dict[str, Any]) -> bool:
        return run["study"] == _STUDY and (run["asked"] or "") == asked

    if not (bands := learning_bands(evidence, "success", keep, "set", "total_steps")):
        return None
    title = f"Success in evaluations without exploration, DDPG and SAC on generated tracks, {asked}"
    drawn = draw_bands(bands, "steps", "success in evaluations")
    return Picture(name, drawn, title, title)
