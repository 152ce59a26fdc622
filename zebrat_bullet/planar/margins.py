"""How near a wall counts as touched while a policy learns: one distance, a range, or by family of tracks."""

from collections.abc import Mapping, Sequence
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import Range
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown
from zebrat_bullet.world import check_family

Margins = float | Range | Mapping[str, float | Range]
"""A margin in m, a range of which each episode draws its own, or either by family of tracks, `OTHER` for the rest."""
OTHER = "other"
NEAR_M = 0.2
"""Walls farther from the outline than this are looked for anew: a car moves about so far in a control step."""


def margins_of(margin_m: Margins) -> dict[str, Range]:
    """Return least and greatest margin in m by family, `OTHER` among them.

    Raises:
        ConfigError: one is out of range, `OTHER` is missing, or there is no such family.
    """
    given = margin_m if isinstance(margin_m, Mapping) else {OTHER: margin_m}
    if OTHER not in given:
        raise ConfigError(f"margin_m by family needs {OTHER!r} for the rest, got {dict(given)}")
    for family in given.keys() - {OTHER}:
        check_family(family, None)
    return {family: _range_of(margin) for family, margin in given.items()}


def _range_of(margin_m: float | Range) -> Range:
    ends = tuple(margin_m) if isinstance(margin_m, Sequence) else (margin_m, margin_m)
    if len(ends) != 2 or not all(isinstance(end, Real) for end in ends) or not 0.0 <= ends[0] <= ends[1] < NEAR_M:
        raise ConfigError(f"margin_m must be in [0, {NEAR_M}), or a range in there, got {shown(repr(margin_m))}")
    return ends


def draw_margins(
    margins: NDArray[np.float64], worlds: NDArray[np.int32], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return a margin in m for an episode in each of some worlds.

    Args:
        margins: (W, 2), least and greatest of each world there is.
        worlds: (K,) places of those that are driven in.
        rng: asked only where some world has a range.
    """
    least, most = margins.T
    if (least < most).any():
        return rng.uniform(least[worlds], most[worlds]).astype(np.float32)
    return least[worlds].astype(np.float32)
