"""Walls that give no return, as dark, glassy or mirroring ones do: the same places throughout an episode."""

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.geometry import rotation_2d

PATCH_M = 0.4
"""Size of the patches that are dark or not."""

_MIX = np.uint64(0x9E3779B97F4A7C15)


class DarkWalls:
    """A share of the plan, in square patches, in which whatever stands gives no return to any beam.

    Args:
        share: of the patches, in [0, 1].
        rng: draws which they are.
    """

    def __init__(self, share: float, rng: np.random.Generator) -> None:
        self._share = share
        # Patches stand askew: walls along their borders would flicker between two of them.
        self._turn = rotation_2d(rng.uniform(0.1, 1.4)) / PATCH_M
        self._shift = rng.uniform(0.0, 1.0, 2)
        self._keys = rng.integers(2**63, size=2, dtype=np.uint64)

    def apply(
        self,
        ranges_m: NDArray[np.float32],
        origin_world: NDArray[np.float64],
        directions_world: NDArray[np.float64],
        range_max_m: float,
    ) -> NDArray[np.float32]:
        """Return the ranges with those of dark places at the reach.

        Args:
            ranges_m: (M,) float32, m; `range_max_m` stands for no return, in and out.
            origin_world: (3,) where the beams start.
            directions_world: (M, 3) unit vectors.
            range_max_m: the reach.
        """
        hits = origin_world[:2] + ranges_m[:, None] * directions_world[:, :2]
        return np.where(self.dark(hits), np.float32(range_max_m), ranges_m)

    def dark(self, points_world: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return (M,) which of (M, 2) points, m, world frame, are dark."""
        cells = np.floor(points_world @ self._turn.T + self._shift).astype(np.int64).astype(np.uint64)
        with np.errstate(over="ignore"):
            mixed = _mixed(cells[:, 0] * _MIX + self._keys[0])
            mixed = _mixed((mixed ^ cells[:, 1]) * _MIX + self._keys[1])
        return (mixed >> np.uint64(11)) * 2.0**-53 < self._share


def _mixed(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return (M,) numbers of which each bit depends on every bit of those given (the finaliser of splitmix64)."""
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))
