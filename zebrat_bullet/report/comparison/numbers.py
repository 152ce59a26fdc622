"""Shares and differences as the tables of the report print them."""

import math
from collections.abc import Sequence

from zebrat_bullet.report.comparison.document import Cell
from zebrat_bullet.report.comparison.evidence import Drive, rate
from zebrat_bullet.report.comparison.statistics import ENOUGH_SEEDS, seeds_difference

MISSING = Cell("not driven", "missing")


def share_cell(drives: Sequence[Drive] | None) -> Cell:
    """Return the success of drives."""
    return Cell(f"{100 * rate(drives).share:.0f} %", "number") if drives else MISSING


def seeds_cell(shares: Sequence[float] | None) -> Cell:
    """Return the mean of a share a run and, of more than one, from the least to the greatest."""
    if not shares:
        return MISSING
    said = f"{100 * sum(shares) / len(shares):.0f} %"
    return Cell(said + (f" ({100 * min(shares):.0f}-{100 * max(shares):.0f})" if len(shares) > 1 else ""), "number")


def points(a: Sequence[float], b: Sequence[float]) -> str:
    """Return how many points of 100 more the one is over its runs, with its interval where seeds differ."""
    if min(len(a), len(b)) < ENOUGH_SEEDS:
        return "too few seeds"
    at = seeds_difference(a, b)
    if math.isnan(at.low):
        return f"{100 * at.value:+.1f}"
    low, high = max(at.low, -1.0), min(at.high, 1.0)  # of shares none is further apart
    return f"{100 * at.value:+.1f} ({100 * low:+.1f} to {100 * high:+.1f})"
