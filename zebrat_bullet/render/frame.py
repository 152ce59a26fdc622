"""What one picture shows: the car's pose and joints, what it senses, and the numbers beside it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.types import Clearance, FlatScan, Pose2


def _empty_path() -> NDArray[np.float64]:
    return np.empty((0, 2))


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One moment of a drive, ready to be drawn; everything but the pose may be left out.

    Attributes:
        pose: base frame in the world.
        knuckle_rad: (2,) left and right steering hinge angles.
        wheel_rad: (4,) rolling angles of rear-left, rear-right, front-left, front-right wheel.
        cloud_world: (N, 3) m, the lidar returns in the world frame; None draws no cloud.
        scan: the flattened scan taken at `scan_pose`; None draws none.
        scan_pose: base frame when cloud and scan were taken; None means `pose`.
        clearance: colours the safety region from green over amber to red; None draws no region.
        region_base: (K, 2) m, outline of the safety region in the base frame; None means the car's footprint.
        path_world: (K, 2) m, where the car's body centre has been.
        speed_mps, steering_rad, time_s: shown as numbers and gauges.
        terms: reward term name to its weighted value in the last control step.
        title: what is driven by whom.
        status: outcome of the episode, or that the supervisor has stopped the car; else empty.
    """

    pose: Pose2
    knuckle_rad: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    wheel_rad: NDArray[np.float64] = field(default_factory=lambda: np.zeros(4))
    cloud_world: NDArray[np.float64] | None = None
    scan: FlatScan | None = None
    scan_pose: Pose2 | None = None
    clearance: Clearance | None = None
    region_base: NDArray[np.float64] | None = None
    path_world: NDArray[np.float64] = field(default_factory=_empty_path)
    speed_mps: float = 0.0
    steering_rad: float = 0.0
    time_s: float = 0.0
    terms: Mapping[str, float] = field(default_factory=dict)
    title: str = ""
    status: str = ""

    @property
    def gap_m(self) -> float | None:
        """Smallest distance between the safety region and what the lidar sees; None without a clearance."""
        return None if self.clearance is None else float(np.min(self.clearance.obs_m - self.clearance.range_m))
