"""The four representations of a scan, with as many rays and as wide a margin as one likes."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import SafetyRegionConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.safety_region import SafetyRegion, make_region

RAY_REPRESENTATIONS = ("sr", "firect", "fifr")
KINDS = (*RAY_REPRESENTATIONS, "cloud")


@dataclass(frozen=True, kw_only=True)
class Representation:
    """What watches the outline.

    Attributes:
        kind: "sr", "firect", "fifr" (see `SafetyRegionConfig`) or "cloud": every point of the height band.
        n_rays: bearings watched; the cloud takes all there are, and 0 stands for that.
        margin_m: how far the outline is enlarged.
    """

    kind: str
    n_rays: int = 32
    margin_m: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ConfigError(f"no representation {self.kind!r}; there are {', '.join(KINDS)}")
        if self.n_rays < 0 or (self.kind == "cloud") != (self.n_rays == 0):
            raise ConfigError(f"n_rays is 0 for the cloud and above 0 otherwise, got {self.n_rays} for {self.kind}")
        if not 0.0 <= self.margin_m < math.inf:
            raise ConfigError(f"margin_m must be at least 0, got {self.margin_m}")


def fires(
    what: Representation, robot: str, scans: NDArray[np.float32], cloud_gaps_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return (M,) whether a representation reports a collision.

    Args:
        what: the representation.
        robot: URDF name or path of the car whose outline it watches.
        scans: (M, B) flattened ranges in m.
        cloud_gaps_m: (M,) `sensing.cloud_check.cloud_gap` of the same sweeps, for the outline without margin.
    """
    if what.kind == "cloud":
        return np.asarray(cloud_gaps_m <= what.margin_m)
    region = region_of(what, robot, scans.shape[1])
    return np.any(scans[:, region.indices] <= region.range_m, axis=1)


@lru_cache(maxsize=1024)
def region_of(what: Representation, robot: str, n_bearings: int) -> SafetyRegion:
    """Return the region with the number of rays nearest to the one asked for, on an outline with the margin.

    Algorithm 1 takes a spacing, not a number: a spacing that gives so many rays is searched for. None may: every axis
    and corner takes a ray, so a hexagon has 10 or more, and mirrored sides gain theirs together.
    """
    model = load_robot(robot)
    low, high = 1e-3, 10.0
    spacing = shapely.Polygon(model.footprint_base).length / what.n_rays
    best: SafetyRegion | None = None
    for _ in range(30):
        region = make_region(
            model, SafetyRegionConfig(kind=what.kind, resolution_m=spacing, margin_m=what.margin_m), n_bearings
        )
        n = len(region.indices)
        if best is None or abs(n - what.n_rays) < abs(len(best.indices) - what.n_rays):
            best = region
        if n == what.n_rays:
            break
        low, high = (low, spacing) if n < what.n_rays else (spacing, high)
        spacing = float(np.sqrt(low * high))
    assert best is not None
    return best
