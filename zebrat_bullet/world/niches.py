"""Pockets in the walls of a corridor: dead ends that a car can stand in, turn in or take for the way on."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from shapely import affinity

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.elements import Niche
from zebrat_bullet.world.track import THINNEST_WALL_M, WAY_OUT_M, Track, join_ground, strip

# A pocket reaches so far back into its corridor, so that the two overlap.
_OVERLAP_M = 0.01
_ON_WALL_M = 1e-3


def open_niches(track: Track, niches: Sequence[Niche], source: str) -> Track:
    """Return the track with pockets in its walls; its centre line and widths stay those of the corridor.

    Raises:
        WorldError: a pocket opens where there is no straight wall, or runs into the track, its way out or another.
    """
    if not niches:
        return track
    way_out = strip(track.exit, 0.0, WAY_OUT_M, float(track.widths_m[-1]))
    wall = track.free_space.boundary.buffer(_ON_WALL_M)
    pockets: list[shapely.Polygon] = []
    for i, niche in enumerate(niches):
        half = float(np.interp(niche.at_m, track.distances_m, track.widths_m)) / 2
        pose = track.pose_at(niche.at_m)
        if niche.at_m > track.length_m or not wall.contains(_beside(pose, niche, half, half)):
            raise WorldError(
                f"{source}: niches[{i}].at_m: no straight wall is {niche.length} m long to the {niche.niche} of "
                f"{niche.at_m} m; move the niche or make it shorter"
            )
        far = _beside(pose, niche, half + THINNEST_WALL_M, half + niche.depth)
        if shapely.distance(far, [track.free_space, way_out, *pockets]).min() < THINNEST_WALL_M - _ON_WALL_M:
            raise WorldError(
                f"{source}: niches[{i}]: runs into the track, its way out or another niche; make it shorter or "
                "less deep, or move it"
            )
        pockets.append(_beside(pose, niche, half - _OVERLAP_M, half + niche.depth))
    return replace(track, free_space=join_ground([track.free_space, *pockets]))


def _beside(pose: Pose2, niche: Niche, near: float, far: float) -> shapely.Geometry:
    """Return what lies along a niche's mouth, from `near` to `far` m beside a pose; a line where these are equal."""
    side, half = (1.0 if niche.niche == "left" else -1.0), niche.length / 2
    near, far = side * near, side * far
    corners = [(-half, near), (half, near), (half, far), (-half, far)]
    shape = shapely.LineString(corners[:2]) if near == far else shapely.Polygon(corners)
    turned = affinity.rotate(shape, pose.yaw, origin=(0, 0), use_radians=True)
    return affinity.translate(turned, pose.x, pose.y)
