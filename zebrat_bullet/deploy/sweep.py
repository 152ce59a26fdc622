"""Where a car's outline goes under commands, and how near it comes to points: a few poses, all points at once."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.deploy.car import Car
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.types import Command, FlatScan

TIME_STEP_S = 1.0 / 60.0
"""Between two poses; at 0.6 m/s a car moves 1 cm, and what it touches between them but at neither is under 0.1 mm."""
PULL = 1.5
"""A car may speed up so many times harder than the braking that is counted on."""
APART_M, JOINED_M = 0.02, 0.1
"""Returns of neighbouring bearings that are farther apart than the first but no farther than the second have wall
between them, for no car fits through."""
_BETWEEN = np.array([0.25, 0.5, 0.75])[:, None, None]

SAME_WALL_M = 0.3
"""Returns so near to one that is touched are of the same wall: a car that leaves it swings its corner along it."""
Phase = tuple[float, Command]
"""How long in s a command holds."""


def motion(
    car: Car, speed_mps: float, steering_rad: float, phases: Sequence[Phase], lag_s: float
) -> tuple[NDArray[np.float64], float, float]:
    """Return where a car goes that obeys some commands, one after the other; the last is held for its time, then ends.

    Args:
        car: the car; its speed falls by its deceleration and rises by `PULL` times that.
        speed_mps, steering_rad: how it moves now.
        phases: what it is told; a duration of infinity goes on until the car has the commanded speed.
        lag_s: the steering closes its error in an exponential of this time constant, at its rate at most; 0: at its
            rate.

    Returns:
        (T, 4) x, y in m and yaw in rad of the base frame in the base frame of now, and the time in s; then speed and
        steering at the end.
    """
    axle, base = car.rear_axle_x_m, car.wheelbase_m
    x, y, yaw, time = axle, 0.0, 0.0, 0.0
    rows = [(0.0, 0.0, 0.0, 0.0)]
    for duration_s, command in phases:
        if math.isinf(duration_s):
            duration_s = abs(speed_mps - command.speed_mps) / car.deceleration_mps2
        n = math.ceil(duration_s / TIME_STEP_S - 1e-9)
        for _ in range(n):
            dt = duration_s / n
            wheel = steering_rad
            speed_mps, metres = _ramp(speed_mps, command.speed_mps, car.deceleration_mps2, dt)
            error = command.steering_rad - steering_rad
            turn = error * (1.0 - math.exp(-dt / lag_s)) if lag_s > 0.0 else error
            most = car.steering_rate_radps * dt
            steering_rad += max(-most, min(most, turn))
            turned = metres * math.tan(0.5 * (wheel + steering_rad)) / base
            x += metres * math.cos(yaw + 0.5 * turned)
            y += metres * math.sin(yaw + 0.5 * turned)
            yaw += turned
            time += dt
            rows.append((x - axle * math.cos(yaw), y - axle * math.sin(yaw), yaw, time))
    return np.array(rows), speed_mps, steering_rad


def _ramp(speed_mps: float, wanted_mps: float, deceleration_mps2: float, time_s: float) -> tuple[float, float]:
    """Return the speed after some time in which it goes to another, and the metres driven."""
    metres = 0.0
    between = wanted_mps if speed_mps * wanted_mps > 0.0 else 0.0  # a car that turns round stands still for a moment
    slower = between if abs(between) < abs(speed_mps) else speed_mps
    for end, rate in ((slower, deceleration_mps2), (wanted_mps, PULL * deceleration_mps2)):
        part = min(time_s, abs(end - speed_mps) / rate)
        after = end if part < time_s else speed_mps + math.copysign(part * rate, end - speed_mps)
        metres += 0.5 * (speed_mps + after) * part
        speed_mps, time_s = after, time_s - part
    return speed_mps, metres + speed_mps * time_s


def scan_points(scan: FlatScan, car: Car) -> NDArray[np.float64]:
    """Return the (N, 2) returns of a scan in m, base frame, and points between neighbours that are near each other."""
    bearings = beam_bearings(len(scan.ranges_m))
    ranges = scan.ranges_m.astype(np.float64)
    points = np.stack([np.cos(bearings), np.sin(bearings)], axis=1) * ranges[:, None] + car.lidar_xyz_base[:2]
    seen = ranges < scan.range_max_m
    after = np.roll(points, -1, axis=0)
    apart = np.hypot(*(after - points).T)
    joined = seen & np.roll(seen, -1) & (apart > APART_M) & (apart <= JOINED_M)
    between = points[joined] + _BETWEEN * (after[joined] - points[joined])
    return np.concatenate([points[seen], between.reshape(-1, 2)])


class Outline:
    """A convex outline of which is known how far points are outside of it.

    Args:
        corners_base: (K, 2) m, counter-clockwise.
    """

    def __init__(self, corners_base: Sequence[Sequence[float]]) -> None:
        corners = np.asarray(corners_base, dtype=np.float64)
        along = np.roll(corners, -1, axis=0) - corners
        self._normals = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
        self._offsets = (self._normals * corners).sum(axis=1)
        self._radius_m = float(np.hypot(*corners.T).max())
        turns = (self._normals * np.roll(self._normals, 1, axis=0)).sum(axis=1)
        self._spike = float(np.sqrt(2.0 / (1.0 + turns)).max())  # how far a corner moves out with its two sides

    def moved_m(self, poses: NDArray[np.float64], margin_m: float) -> float:
        """Return a bound on how far any point of the outline with a margin moves from the origin's pose to others."""
        radius = self._radius_m + margin_m * self._spike
        return float((np.hypot(poses[:, 0], poses[:, 1]) + radius * np.abs(poses[:, 2])).max())

    def gaps(self, points: NDArray[np.float64], poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (T, N) how far in m N points are outside of the outline at T poses, below 0 inside.

        It is the distance by which every side of the outline may move outwards until the point lies on one of them:
        the margin of the safety region. Beside a side it is the distance, off a corner somewhat less.

        Args:
            points: (N, 2) m.
            poses: (T, 3 or more) x, y in m and yaw in rad, in the frame of the points.
        """
        c, s = np.cos(poses[:, 2:3]), np.sin(poses[:, 2:3])
        dx, dy = points[:, 0] - poses[:, 0:1], points[:, 1] - poses[:, 1:2]
        x, y = c * dx + s * dy, c * dy - s * dx
        gap = np.full(x.shape, -np.inf)
        for (nx, ny), offset in zip(self._normals, self._offsets, strict=True):
            np.maximum(gap, nx * x + ny * y - offset, out=gap)
        return gap


def apart(points: NDArray[np.float64], gaps_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return those of (N, 2) points that are outside, of a wall of which no point is inside."""
    inside, outside = points[gaps_m < 0.0], points[gaps_m >= 0.0]
    near = np.hypot(*(outside[:, None] - inside).transpose(2, 0, 1)) <= SAME_WALL_M
    return outside[~near.any(axis=1)]
