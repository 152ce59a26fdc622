"""How far a wall is from the whole footprint, and how that changes as the car moves."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Contact = tuple[float, float, float, float, float]


@njit(cache=True, error_model="numpy")
def _nearest_on_segment(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> tuple[float, float]:
    """Return the point of the segment a-b that is nearest to p."""
    dx, dy = bx - ax, by - ay
    along = ((px - ax) * dx + (py - ay) * dy) / max(dx * dx + dy * dy, 1e-18)
    along = min(1.0, max(0.0, along))
    return ax + along * dx, ay + along * dy


@njit(cache=True, error_model="numpy")
def _overlap(outline: Floats, ax: float, ay: float, bx: float, by: float) -> Contact:
    """Return the widest gap along any normal of outline and segment; below 0 it is the depth of their overlap.

    Also the unit normal from the outline to the segment along which that is, and the point of the segment.
    """
    best, nx, ny, qx, qy = -np.inf, 0.0, 0.0, ax, ay
    n = len(outline)
    for k in range(n):
        vx, vy = outline[k, 0], outline[k, 1]
        ex, ey = outline[(k + 1) % n, 0] - vx, outline[(k + 1) % n, 1] - vy
        length = math.hypot(ex, ey)
        mx, my = ey / length, -ex / length
        gap_a, gap_b = mx * (ax - vx) + my * (ay - vy), mx * (bx - vx) + my * (by - vy)
        if min(gap_a, gap_b) > best:
            best, nx, ny = min(gap_a, gap_b), mx, my
            qx, qy = (ax, ay) if gap_a < gap_b else (bx, by)
    length = math.hypot(bx - ax, by - ay)
    if length < 1e-9:
        return best, nx, ny, qx, qy
    mx, my = (by - ay) / length, -(bx - ax) / length
    for side in (-1.0, 1.0):
        gap, vx, vy = np.inf, 0.0, 0.0
        for k in range(n):
            here = side * (mx * (outline[k, 0] - ax) + my * (outline[k, 1] - ay))
            if here < gap:
                gap, vx, vy = here, outline[k, 0], outline[k, 1]
        if gap > best:
            best, nx, ny = gap, -side * mx, -side * my
            qx, qy = vx + gap * nx, vy + gap * ny
    return best, nx, ny, qx, qy


@njit(cache=True, error_model="numpy")
def _apart(outline: Floats, ax: float, ay: float, bx: float, by: float) -> Contact:
    """Return the distance of a segment from an outline that it does not touch, the unit normal to it, and its point."""
    best, nx, ny, qx, qy = np.inf, 0.0, 0.0, 0.0, 0.0
    n = len(outline)
    for k in range(n):
        vx, vy = outline[k, 0], outline[k, 1]
        px, py = _nearest_on_segment(vx, vy, ax, ay, bx, by)
        squared = (px - vx) ** 2 + (py - vy) ** 2
        if squared < best:
            best, nx, ny, qx, qy = squared, px - vx, py - vy, px, py
        for sx, sy in ((ax, ay), (bx, by)):
            px, py = _nearest_on_segment(sx, sy, vx, vy, outline[(k + 1) % n, 0], outline[(k + 1) % n, 1])
            squared = (px - sx) ** 2 + (py - sy) ** 2
            if squared < best:
                best, nx, ny, qx, qy = squared, sx - px, sy - py, sx, sy
    distance = math.sqrt(best)
    return distance, nx / distance, ny / distance, qx, qy


@njit(cache=True, error_model="numpy")
def clearance(outline: Floats, pose: Floats, segment: Floats, felt: float) -> tuple[float, float, float, float]:
    """Return the distance in m from a convex outline to a wall segment, and its derivatives by x, y and yaw.

    Where they overlap it is minus the depth, so that a band which runs through a wall is still pushed out of it.

    Args:
        outline: (K, 2) float64, counter-clockwise, m, in the frame of the pose.
        pose: (3,) float64, x, y in m and yaw in rad.
        segment: (4,) float64, x and y of both ends in m.
        felt: distance in m that matters: beyond it a lower bound that is beyond it too may be returned.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ax, ay, bx, by = segment[0] - pose[0], segment[1] - pose[1], segment[2] - pose[0], segment[3] - pose[1]
    ax, ay, bx, by = c * ax + s * ay, c * ay - s * ax, c * bx + s * by, c * by - s * bx
    distance, nx, ny, qx, qy = _overlap(outline, ax, ay, bx, by)
    if 1e-9 < distance < felt:
        distance, nx, ny, qx, qy = _apart(outline, ax, ay, bx, by)
    return distance, -(c * nx - s * ny), -(s * nx + c * ny), nx * qy - ny * qx


@njit(cache=True, error_model="numpy")
def distance_to_point(segment: Floats, x: float, y: float) -> float:
    """Return the distance in m of a point from a segment."""
    px, py = _nearest_on_segment(x, y, segment[0], segment[1], segment[2], segment[3])
    return math.hypot(px - x, py - y)
