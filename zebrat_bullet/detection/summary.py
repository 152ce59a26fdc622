"""Numbers that answer the question: counts with intervals, each against the safety region, and the margin to take."""

import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import DegenerateDataWarning, bootstrap

from zebrat_bullet.detection.cases import Case
from zebrat_bullet.detection.representations import KINDS
from zebrat_bullet.detection.study import Tally
from zebrat_bullet.evaluation.metrics import wilson_interval

PAPER_COUNTS = {"sr": 508, "firect": 407, "fifr": 363}
"""Collisions detected with 32 rays (paper, Fig. 4c)."""
RECALL_WANTED = 0.999

Results = Mapping[tuple[str, Case], Tally]
"""By the kind of walls and the case."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """One case with one kind of walls.

    Attributes:
        contacts: true contacts.
        in_time, within_1_s: contacts reported by the first sweep after them, or at most 1 s after them.
        recall, recall_ci: in_time / contacts with its 95 % Wilson interval.
        overlap_sweeps, overlap_reports: sweeps taken in collision, and those of them that reported it.
        false_alarms: reports without a contact within 1 s; sweeps in a row count once.
        clear_minutes: time driven in which a report is a false alarm.
        precision: in_time / (in_time + false_alarms); None where nothing was reported.
        lead_s: median time from the first report to the contact, of those reported; None without any.
    """

    contacts: int
    in_time: int
    within_1_s: int
    recall: float
    recall_ci: tuple[float, float]
    overlap_sweeps: int
    overlap_reports: int
    false_alarms: int
    clear_minutes: float
    precision: float | None
    lead_s: float | None


def summarise(tally: Tally) -> Summary:
    """Return the counts of a tally."""
    n, n_in_time = len(tally.events), int(tally.in_time.sum())
    reported = np.isfinite(tally.lead_s)
    alarms = n_in_time + tally.false_alarms
    return Summary(
        contacts=n,
        in_time=n_in_time,
        within_1_s=int(reported.sum()),
        recall=n_in_time / n,
        recall_ci=wilson_interval(n_in_time, n),
        overlap_sweeps=int(tally.overlap_sweeps.sum()),
        overlap_reports=int(tally.overlap_reports.sum()),
        false_alarms=tally.false_alarms,
        clear_minutes=tally.clear_s / 60.0,
        precision=n_in_time / alarms if alarms else None,
        lead_s=float(np.median(tally.lead_s[reported])) if reported.any() else None,
    )


COUNTS = ("in_time", "within_1_s", "overlap_reports")


def event_counts(tally: Tally, count: str) -> NDArray[np.float64]:
    """Return the (E,) share that each event has in one of `COUNTS`."""
    values = {
        "in_time": tally.in_time,
        "within_1_s": np.isfinite(tally.lead_s),
        "overlap_reports": tally.overlap_reports,
    }
    return np.asarray(values[count], float)


def relative_difference(tally: Tally, reference: Tally, count: str) -> tuple[float, float, float]:
    """Return how much less a tally counts than a reference on the same events, and its 95 % bootstrap interval.

    -0.2 is a fifth less. The events are drawn anew, in pairs, 2,000 times. All NaN where the reference counts nothing,
    or there is but one event; the interval alone where some draw finds nothing that the reference counts.
    """
    mine, theirs = event_counts(tally, count), event_counts(reference, count)
    if not theirs.any() or len(theirs) < 2:
        return (float("nan"),) * 3

    def difference(a: NDArray[np.float64], b: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
        counted = b.sum(axis=axis)
        return np.asarray(a.sum(axis=axis) / np.where(counted > 0, counted, np.nan) - 1.0)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DegenerateDataWarning)  # few events: the NaN says it
        made = bootstrap(
            (mine, theirs), difference, paired=True, n_resamples=2000, method="percentile", rng=np.random.default_rng(0)
        ).confidence_interval
    return float(difference(mine, theirs)), float(made.low), float(made.high)


def base_tallies(results: Results, walls: str) -> dict[str, Tally]:
    """Return the base case of each representation."""
    return {c.representation.kind: t for (w, c), t in results.items() if w == walls and c.panel == "base"}


def base_cases(results: Results) -> dict[str, Case]:
    """Return the base case of each representation itself: the same with either kind of walls."""
    return {case.representation.kind: case for _, case in results if case.panel == "base"}


def summaries(results: Results) -> dict[str, dict[str, dict[str, object]]]:
    """Return the summary of each base case as plain values for JSON, by the kind of walls and the representation."""
    return {
        walls: {kind: asdict(summarise(tally)) for kind, tally in base_tallies(results, walls).items()}
        for walls in dict.fromkeys(walls for walls, _ in results)
    }


def recommended_margins(results: Results, walls: str) -> dict[str, tuple[float, Summary]]:
    """Return, for each representation, the margin with at least 99.9 % recall that gives the fewest false alarms.

    A representation that reaches it with none of the margins tried is absent, and so are all without their panel.
    """
    best: dict[str, tuple[float, Summary]] = {}
    for kind in KINDS:
        tried = [
            (case.representation.margin_m, summarise(tally))
            for (w, case), tally in results.items()
            if w == walls and case.panel == "margin" and case.representation.kind == kind
        ]
        good = [(margin, at) for margin, at in tried if at.recall >= RECALL_WANTED]
        if good:
            best[kind] = min(good, key=lambda one: (one[1].false_alarms, one[0]))
    return best
