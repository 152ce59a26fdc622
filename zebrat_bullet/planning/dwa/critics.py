"""What a rollout costs: walls, grid distances to path and goal, and driving to and fro. One small function a critic."""

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.geometry import wrap_angle
from zebrat_bullet.planning.compiled import compiled
from zebrat_bullet.planning.dwa.config import DwaConfig
from zebrat_bullet.planning.grid import INSCRIBED, LETHAL
from zebrat_bullet.types import Pose2


def footprint_scale(speed: NDArray[np.float64], config: DwaConfig, max_speed_mps: float) -> NDArray[np.float64]:
    """Return how much larger than the car the outline is checked that drives at (K,) speeds in m/s."""
    over = np.maximum(np.abs(speed) - config.scaling_speed_mps, 0.0)
    return 1.0 + config.max_scaling_factor * over / max(max_speed_mps - config.scaling_speed_mps, 1e-9)


def outline_points(footprint_base: NDArray[np.float64], padding_m: float, spacing_m: float) -> NDArray[np.float64]:
    """Return (P, 2) points along a (K, 2) outline moved out by `padding_m`, its corners among them.

    Neighbours are at most `spacing_m` apart.
    """
    padded = shapely.Polygon(footprint_base).buffer(padding_m, join_style="mitre")
    return shapely.get_coordinates(shapely.segmentize(padded.exterior, spacing_m))[:-1]


@compiled
def obstacle_costs(
    costs: NDArray[np.uint8],
    origin: NDArray[np.float64],
    resolution_m: float,
    rollouts: NDArray[np.float64],
    outline: NDArray[np.float64],
    scale: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the highest costmap cost under centre and outline along each rollout; inf where it meets a wall.

    Args:
        costs: (H, W) uint8 costmap; outside it there is a wall.
        origin: (2,) m, world, lower left corner of cell (0, 0).
        resolution_m: edge of a cell.
        rollouts: (K, T, 3) poses.
        outline: (P, 2) points in m, base frame.
        scale: (K,) how much the outline grows in each rollout.
    """
    n_rows, n_cols = costs.shape
    worst = np.zeros(len(rollouts))
    for k in range(len(rollouts)):
        for t in range(rollouts.shape[1]):
            x, y, yaw = rollouts[k, t]
            c, s = np.cos(yaw) * scale[k], np.sin(yaw) * scale[k]
            for p in range(-1, len(outline)):
                px = x if p < 0 else x + c * outline[p, 0] - s * outline[p, 1]
                py = y if p < 0 else y + s * outline[p, 0] + c * outline[p, 1]
                col = int(np.floor((px - origin[0]) / resolution_m))
                row = int(np.floor((py - origin[1]) / resolution_m))
                inside = 0 <= row < n_rows and 0 <= col < n_cols
                if not inside or costs[row, col] >= LETHAL:
                    worst[k] = np.inf
                    break
                worst[k] = max(worst[k], float(costs[row, col]))
            if worst[k] == np.inf:
                break
    return worst


@compiled
def grid_distances(costs: NDArray[np.uint8], targets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return how many steps to a side neighbour every cell is from the nearest target.

    Args:
        costs: (H, W) uint8; cells from INSCRIBED up are obstacles, which no step enters.
        targets: (K, 2) int64 row and column; they count even where they are obstacles, and not outside
            the grid.

    Returns:
        (H, W) float64, inf in obstacles and in cells without a way to a target.
    """
    n_rows, n_cols = costs.shape
    distances = np.full((n_rows, n_cols), np.inf)
    queue = np.empty((n_rows * n_cols, 2), np.int64)
    head, tail = 0, 0
    for row, col in targets:
        if 0 <= row < n_rows and 0 <= col < n_cols and distances[row, col] > 0.0:
            distances[row, col] = 0.0
            queue[tail, 0], queue[tail, 1] = row, col
            tail += 1
    while head < tail:
        row, col = queue[head]
        head += 1
        for down, right in ((0, -1), (0, 1), (-1, 0), (1, 0)):
            r, c = row + down, col + right
            inside = 0 <= r < n_rows and 0 <= c < n_cols
            if inside and distances[r, c] == np.inf and costs[r, c] < INSCRIBED:
                distances[r, c] = distances[row, col] + 1.0
                queue[tail, 0], queue[tail, 1] = r, c
                tail += 1
    return distances


def end_distances(
    distances: NDArray[np.float64], cells: NDArray[np.intp], stop_on_failure: bool = True
) -> NDArray[np.float64]:
    """Return the grid distance, in cells, at the end of each rollout; inf where a rollout is refused.

    Args:
        distances: (H, W) from `grid_distances`.
        cells: (K, T, 2) row and column along each rollout.
        stop_on_failure: refuse a rollout with any cell that no way leads from; otherwise such an end counts as far as
            the grid has cells. Off the grid is refused always.
    """
    inside = ((cells >= 0) & (cells < distances.shape)).all(axis=(1, 2))
    seen = distances[tuple(np.clip(cells, 0, np.array(distances.shape) - 1).transpose(2, 0, 1))]
    if stop_on_failure:
        return np.where(inside & np.isfinite(seen).all(axis=1), seen[:, -1], np.inf)
    return np.where(inside, np.minimum(seen[:, -1], distances.size), np.inf)


def shifted(rollouts: NDArray[np.float64], forward_m: float) -> NDArray[np.float64]:
    """Return the (K, T, 2) points `forward_m` ahead of the poses of (K, T, 3) rollouts."""
    yaw = rollouts[..., 2]
    return rollouts[..., :2] + forward_m * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)


class Oscillation:
    """Refuses to turn back on a change of direction until the car has moved or turned far enough.

    Turning directions count only while the car hardly moves, as in ROS.
    """

    def __init__(self, config: DwaConfig) -> None:
        self._config = config
        self.forget()

    def forget(self) -> None:
        """Allow every direction."""
        self._last = np.zeros(2)
        self._only = np.zeros(2)

    def allows(self, samples: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which of (K, 2) samples v, w do not turn back."""
        return np.asarray((samples * self._only >= 0.0).all(axis=1))

    def note(self, pose: Pose2, v: float, w: float) -> None:
        """Remember the command given at a pose."""
        sign = np.sign([v, w if abs(v) <= self._config.min_vel_trans else 0.0])
        turned_back = (sign != 0.0) & (sign == -self._last)
        self._last = np.where(sign != 0.0, sign, self._last)
        self._only = np.where(turned_back, sign, self._only)
        if turned_back.any():
            self._since = pose
        if self._only.any() and self._moved(pose):
            self.forget()

    def _moved(self, pose: Pose2) -> bool:
        way = math.hypot(pose.x - self._since.x, pose.y - self._since.y)
        turn = abs(wrap_angle(pose.yaw - self._since.yaw))
        return way > self._config.oscillation_reset_dist_m or turn > self._config.oscillation_reset_angle_rad
