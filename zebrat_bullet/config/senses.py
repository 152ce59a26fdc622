"""Settings of the senses: lidar, its noise, flattening, safety region."""

import math
from dataclasses import dataclass

from zebrat_bullet.config.checks import of_their_kinds, require, within
from zebrat_bullet.files import shown

CASTERS = ("bullet", "embree", "mujoco")


@dataclass(frozen=True, kw_only=True)
class LidarConfig:
    """The beams of the lidar (defaults: Velodyne VLP-16 at one degree).

    Attributes:
        n_channels, n_bearings: beams above each other, and around.
        elevation_min_rad, elevation_max_rad: lowest and highest channel.
        range_max_m: reach.
        caster: "bullet" (rayTestBatch) and "mujoco" (mj_multiRay) cast in the engine of that name, "embree" (Open3D
            RaycastingScene) beside either.
        bearings: "all", or "region": a drive casts only the bearings that the safety region and the open-space rule
            look at, a tenth of them, while nobody asks for whole scans; what these two see is the same to the last bit.
    """

    n_channels: int = 16
    n_bearings: int = 360
    elevation_min_rad: float = math.radians(-15.0)
    elevation_max_rad: float = math.radians(15.0)
    range_max_m: float = 6.0
    caster: str = "bullet"
    bearings: str = "all"

    def __post_init__(self) -> None:
        of_their_kinds(self)
        require(self.caster in CASTERS, f"caster must be one of {', '.join(CASTERS)}, got {shown(self.caster)!r}")
        require(self.bearings in ("all", "region"), f"bearings must be 'all' or 'region', got {self.bearings!r}")
        require(self.n_channels >= 1 and self.n_bearings >= 8, "a lidar needs at least 1 channel and 8 bearings")
        require(
            -math.pi / 2 < self.elevation_min_rad <= self.elevation_max_rad < math.pi / 2,
            "elevations must satisfy -pi/2 < min <= max < pi/2",
        )
        require(self.range_max_m > 0, f"range_max_m must be above 0, got {self.range_max_m}")
        within(self, n_channels=(1, 1024), n_bearings=(8, 36_000), range_max_m=(0.01, 1000.0))
        n_beams = self.n_channels * self.n_bearings
        require(n_beams <= 2_000_000, f"a lidar has at most 2,000,000 beams, got {n_beams}")


@dataclass(frozen=True, kw_only=True)
class NoiseConfig:
    """Lidar imperfections, applied between cloud and scan; all off by default.

    Attributes:
        range_sigma_m: Gaussian range noise along each ray (VLP-16: 0.008 m in the authors' URDF).
        dropout: probability that a return is lost.
        mount_xyz_m, mount_yaw_rad: error of the mount that the flattening does not know of.
    """

    range_sigma_m: float = 0.0
    dropout: float = 0.0
    mount_xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        of_their_kinds(self)
        require(self.range_sigma_m >= 0, f"range_sigma_m must be at least 0, got {self.range_sigma_m}")
        require(0 <= self.dropout <= 1, f"dropout is a probability, got {self.dropout}")
        within(self, range_sigma_m=(0.0, 100.0), mount_xyz_m=(-10.0, 10.0), mount_yaw_rad=(-10.0, 10.0))


VLP16_NOISE = NoiseConfig(range_sigma_m=0.008, dropout=0.01)
"""The noise of the authors' lidar, and one return in a hundred lost."""


@dataclass(frozen=True, kw_only=True)
class FlattenConfig:
    """The height band whose points make the 2D scan.

    Attributes:
        height_min_m, height_max_m: its ends, in m above the floor.
    """

    height_min_m: float = 0.05
    height_max_m: float = 0.80

    def __post_init__(self) -> None:
        of_their_kinds(self)
        require(
            self.height_min_m < self.height_max_m,
            f"height_min_m {self.height_min_m} must be below height_max_m {self.height_max_m}",
        )
        within(self, height_min_m=(-1000.0, 1000.0), height_max_m=(-1000.0, 1000.0))


@dataclass(frozen=True, kw_only=True)
class SafetyRegionConfig:
    """Which representation watches the car's outline, and how finely (paper, Algorithm 1).

    Attributes:
        kind: "sr" (safety region), "firect" (even angles, outline ranges) or "fifr" (even angles, one range).
        resolution_m: r of Algorithm 1, outline length between two bearings; 0.095 gives 32 of them on ZebraT.
        margin_m: how far the outline is enlarged on every side.
        gap_rad: greatest angle between two bearings of "sr"; where those along the outline lie farther apart, as ahead
            of a lidar on the nose, more are put evenly between them. The paper has none of these.
    """

    kind: str = "sr"
    resolution_m: float = 0.095
    margin_m: float = 0.0
    gap_rad: float = 2.0 * math.pi

    def __post_init__(self) -> None:
        of_their_kinds(self)
        require(self.kind in ("sr", "firect", "fifr"), f"kind must be 'sr', 'firect' or 'fifr', got {self.kind!r}")
        require(self.resolution_m > 0, f"resolution_m must be above 0, got {self.resolution_m}")
        require(self.margin_m >= 0, f"margin_m must be at least 0, got {self.margin_m}")
        within(self, resolution_m=(0.001, 100.0), margin_m=(0.0, 100.0), gap_rad=(0.001, 2.0 * math.pi))
