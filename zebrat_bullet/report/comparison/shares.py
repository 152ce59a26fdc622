"""How often a method's drives are so, and how much oftener than another's; over seeds where there are enough."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zebrat_bullet.report.comparison.evidence import Drive, Evidence, Scope, rate, succeeded
from zebrat_bullet.report.comparison.statistics import (
    ENOUGH_SEEDS,
    Difference,
    Rate,
    rate_difference,
    seeds_difference,
    seeds_interval,
)

What = Callable[[Drive], bool]


@dataclass(frozen=True, slots=True)
class Share:
    """How often, its 95 % interval, and both in words."""

    value: float
    interval: tuple[float, float]
    words: str


@dataclass(frozen=True, slots=True)
class Compared:
    """Two shares, how much greater the first is, and all in words."""

    shares: tuple[float, float]
    difference: Difference
    words: str


def share(evidence: Evidence, scope: Scope, method: str, places: Sequence[str], what: What = succeeded) -> Share | None:
    """Return how often a method's drives in some worlds are so.

    The mean over runs where enough were judged (over all their episodes where none differs from another), else over
    the episodes of the one shown; None where it has not driven in all of these worlds.
    """
    of_runs = evidence.seeds(scope, method, places, what)
    if len(of_runs) >= ENOUGH_SEEDS:
        low, high = seeds_interval(of_runs)
        if math.isnan(low):
            low, high = _all_of_them(evidence, scope, method, places, what).interval
        low, high = max(low, 0.0), min(high, 1.0)
        mean = float(np.mean(of_runs))
        return Share(mean, (low, high), f"{mean:.0%} (mean of {len(of_runs)} runs; {low:.0%}-{high:.0%})")
    pool = evidence.pool(scope, method, places)
    if not pool:
        return None
    at = rate(pool, what)
    return Share(at.share, at.interval, str(at))


def compare(
    evidence: Evidence, scope: Scope, a: str, b: str, places: Sequence[str], what: What = succeeded
) -> Compared | None:
    """Return how much oftener the drives of `a` in some worlds are so than those of `b`.

    Over runs where enough of either were judged (over all their episodes where none differs from another), else over
    the episodes of those shown; None where one of them has not driven in all of these worlds.
    """
    x, y = (evidence.seeds(scope, method, places, what) for method in (a, b))
    if min(len(x), len(y)) >= ENOUGH_SEEDS:
        words = "; ".join(f"{m} {np.mean(v):.0%} (mean of {len(v)} runs)" for m, v in ((a, x), (b, y)))
        difference = seeds_difference(x, y)
        if math.isnan(difference.low):  # no seed differs from another: what is left is how many drives they are
            difference = rate_difference(*(_all_of_them(evidence, scope, each, places, what) for each in (a, b)))
        return Compared((float(np.mean(x)), float(np.mean(y))), difference, words)
    pools = [evidence.pool(scope, method, places) for method in (a, b)]
    if not all(pools):
        return None
    one, other = (rate(pool, what) for pool in pools)
    return Compared((one.share, other.share), rate_difference(one, other), f"{a} {one}; {b} {other}")


def compare_places(
    evidence: Evidence, scope: Scope, method: str, places: Sequence[str], others: Sequence[str], what: What
) -> Compared | None:
    """Return how much oftener a method's drives are so in some worlds than in others.

    Over runs, each by its own difference, where enough were judged and differ, else over episodes; None where it has
    not driven in all of these worlds, or too few of the runs that stand for it in some have.
    """
    runs = evidence.of_seeds(scope, method, (*places, *others))
    if len(runs) < ENOUGH_SEEDS <= len(evidence.of_seeds(scope, method, places)):
        return None
    over = f" (mean of {len(runs)} runs)"
    if len(runs) >= ENOUGH_SEEDS:
        both = [[_mean_share(at, of, what) for of in (places, others)] for at in runs]
        one, other = (float(mean) for mean in np.mean(both, axis=0))
        low, high = seeds_interval([here - there for here, there in both])
        difference = Difference(one - other, low, high)
        if math.isnan(low):
            pools = ([drive for at in runs for place in of for drive in at[place]] for of in (places, others))
            difference = rate_difference(*(rate(pool, what) for pool in pools))
    else:
        pooled = [evidence.pool(scope, method, of) for of in (places, others)]
        if not all(pooled):
            return None
        a, b = (rate(pool, what) for pool in pooled)
        one, other, difference, over = a.share, b.share, rate_difference(a, b), f" ({b.k} of {b.n})"
    return Compared((one, other), difference, f"{one:.0%}; elsewhere {other:.0%}{over}")


def _mean_share(at: Mapping[str, Sequence[Drive]], places: Sequence[str], what: What) -> float:
    return sum(rate(at[place], what).share for place in places) / len(places)


def _all_of_them(evidence: Evidence, scope: Scope, method: str, places: Sequence[str], what: What) -> Rate:
    runs = evidence.of_seeds(scope, method, places)
    return rate([drive for at in runs for drives in at.values() for drive in drives], what)
