"""Rates, differences and tests: every number of the report that is not a count comes from here."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.stats import binomtest, t

from zebrat_bullet.evaluation.metrics import wilson_interval

LEVEL = 0.05
"""Of every test."""
_ALIKE = 1e-9
"""Shares of seeds no further apart than this are the same, but for rounding."""
ENOUGH_SEEDS = 3
"""From so many runs of a set on, sets are compared over runs, else over episodes."""


@dataclass(frozen=True, slots=True)
class Rate:
    """`k` of `n` episodes."""

    k: int
    n: int

    @property
    def share(self) -> float:
        """Return k / n."""
        return self.k / self.n

    @property
    def interval(self) -> tuple[float, float]:
        """Return its 95 % Wilson interval."""
        return wilson_interval(self.k, self.n)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.k} of {self.n} ({self.share:.0%}; {low:.0%}-{high:.0%})"


@dataclass(frozen=True, slots=True)
class Difference:
    """How much greater one value is than another, with its 95 % interval; NaN where nothing says how wide it is."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        points = f"{100 * self.value:+.0f} points"
        return points if np.isnan(self.low) else f"{points}, {self.span}"

    @property
    def span(self) -> str:
        """Its interval in words, of two shares: no further than from -100 to 100 points."""
        return f"{100 * max(self.low, -1.0):+.0f} to {100 * min(self.high, 1.0):+.0f}"


def rate_difference(a: Rate, b: Rate) -> Difference:
    """Return a - b with Newcombe's interval (1998, method 10): of two rates, from their Wilson intervals."""
    (low_a, high_a), (low_b, high_b), d = a.interval, b.interval, a.share - b.share
    low = d - np.hypot(a.share - low_a, high_b - b.share)
    return Difference(d, float(low), float(d + np.hypot(high_a - a.share, b.share - low_b)))


def seeds_difference(a: Sequence[float], b: Sequence[float], level: float = LEVEL) -> Difference:
    """Return the difference of two means over seeds with Welch's t-interval, which misses it in `level` of the cases.

    For a handful of seeds a bootstrap is too narrow (Colas et al. 2019). Where no seed differs from another there is
    nothing to tell the width by.
    """
    x, y = np.array(a, dtype=float), np.array(b, dtype=float)
    value = float(x.mean() - y.mean())
    if max(np.ptp(x), np.ptp(y)) <= _ALIKE:
        return Difference(value, np.nan, np.nan)
    squares = [of.var(ddof=1) / len(of) for of in (x, y)]
    freedom = sum(squares) ** 2 / sum(s**2 / (len(of) - 1) for s, of in zip(squares, (x, y), strict=True))
    half = float(t.ppf(1.0 - level / 2.0, freedom) * np.sqrt(sum(squares)))
    return Difference(value, value - half, value + half)


def seeds_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the t-interval of a mean over seeds; NaN where no seed differs from another."""
    x = np.array(values, dtype=float)
    if np.ptp(x) <= _ALIKE:
        return np.nan, np.nan
    half = float(t.ppf(1.0 - LEVEL / 2.0, len(x) - 1) * x.std(ddof=1) / np.sqrt(len(x)))
    return float(x.mean()) - half, float(x.mean()) + half


@dataclass(frozen=True, slots=True)
class Paired:
    """What two drivers made of the same starts.

    Attributes:
        n: starts that both had.
        better, worse: starts at which only the one, only the other succeeded.
        p: of McNemar's exact test, two-sided; 1 where they never differ.
    """

    n: int
    better: int
    worse: int
    p: float


def paired_test(one: Mapping[Hashable, bool], other: Mapping[Hashable, bool]) -> Paired:
    """Return McNemar's exact test of success by start."""
    both = one.keys() & other.keys()
    better = sum(one[at] and not other[at] for at in both)
    worse = sum(other[at] and not one[at] for at in both)
    p = float(binomtest(better, better + worse).pvalue) if better + worse else 1.0
    return Paired(len(both), better, worse, p)


def sign_flip_test(differences: Sequence[float]) -> float:
    """Return the two-sided p-value that a mean difference is 0, exact: of each it might as well be the other sign.

    Of n differences it is at least 2 / 2**n.
    """
    by = np.array(differences, dtype=float)
    flipped = np.abs(np.array(list(product((-1.0, 1.0), repeat=len(by)))) @ by)
    return float(np.mean(flipped >= abs(by.sum()) - 1e-9))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return the p-values corrected for being many (Holm 1979), in their order."""
    corrected, least = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(np.argsort(p_values, kind="stable")):
        least = max(least, min(1.0, (len(p_values) - rank) * p_values[i]))
        corrected[i] = least
    return corrected
