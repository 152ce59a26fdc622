"""What is drawn beside the car's senses, as markers: the safety region and the walls."""

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.recording.messages import BASE, MAP, Message
from zebrat_bullet.recording.stamps import header
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.sensing.safety_region import SafetyRegion
from zebrat_bullet.types import Clearance
from zebrat_bullet.world import World

LINE_STRIP, LINE_LIST, TRIANGLE_LIST = 4, 5, 11
GREEN, RED, GREY, CLAY = (0.2, 0.8, 0.3, 1.0), (0.9, 0.1, 0.1, 1.0), (0.6, 0.6, 0.6, 0.8), (0.75, 0.68, 0.6, 1.0)
_LINE_M = 0.01
_HEIGHT_M = 0.02
"""Above the floor, so that the floor's grid does not cover it."""


def region_markers(
    region: SafetyRegion, n_bearings: int, clearance: Clearance, robot: RobotModel, time_s: float
) -> Message:
    """Return the safety region as a `MarkerArray` in the base frame.

    Its outline (id 0) is green, red where anything fires; along each bearing a line from the lidar to V_range (id 1,
    two points a bearing, in their order) is grey, red where V_obs <= V_range.
    """
    fires = clearance.obs_m <= clearance.range_m
    lidar = robot.lidar_xyz_base[:2]
    outline = np.concatenate([region.outline_lidar, region.outline_lidar[:1]]) + lidar
    bearings = beam_bearings(n_bearings)[region.indices]
    ends = lidar + clearance.range_m[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    rays = np.stack([np.broadcast_to(lidar, ends.shape), ends], axis=1).reshape(-1, 2)
    colours = [RED if fire else GREY for fire in fires for _ in range(2)]
    strip = _marker(0, LINE_STRIP, "safety_region", BASE, time_s, _flat(outline))
    lines = _marker(1, LINE_LIST, "safety_region", BASE, time_s, _flat(rays))
    return {
        "markers": [
            strip | {"scale": {"x": 2.0 * _LINE_M}, "color": _colour(RED if fires.any() else GREEN)},
            lines | {"scale": {"x": _LINE_M}, "colors": [_colour(each) for each in colours]},
        ]
    }


def wall_markers(world: World) -> Message:
    """Return the walls and obstacles as a `MarkerArray` of one list of triangles in the map."""
    corners = world.mesh.vertices[world.mesh.faces].reshape(-1, 3)
    walls = _marker(0, TRIANGLE_LIST, "walls", MAP, 0.0, corners)
    return {"markers": [walls | {"scale": {"x": 1.0, "y": 1.0, "z": 1.0}, "color": _colour(CLAY)}]}


def _marker(number: int, kind: int, what: str, frame: str, time_s: float, points: NDArray[np.float64]) -> Message:
    return {
        "header": header(time_s, frame),
        "ns": what,
        "id": number,
        "type": kind,
        "pose": {"orientation": {"w": 1.0}},
        "frame_locked": True,
        "points": [dict(zip("xyz", point, strict=True)) for point in points.tolist()],
    }


def _flat(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (P, 2) points as (P, 3), just above the floor."""
    return np.column_stack([points, np.full(len(points), _HEIGHT_M)])


def _colour(rgba: tuple[float, float, float, float]) -> Message:
    return dict(zip("rgba", rgba, strict=True))
