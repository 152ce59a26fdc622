"""Levenberg-Marquardt on a band: banded Cholesky inside, obstacle association and resizing outside."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from zebrat_bullet.planning.teb.band import Band, resize
from zebrat_bullet.planning.teb.config import TebConfig
from zebrat_bullet.planning.teb.costs import Costs, Problem, associate, band_cost, normal_equations

_MIN_DT_S = 0.01
_FIRST_DAMPING = 1e-5  # of the largest diagonal element
_TRIALS = 10


@dataclass(frozen=True)
class Surroundings:
    """What a band is optimised against.

    Attributes:
        outline: (K, 2) float64, convex footprint in the rear-axle frame, counter-clockwise, m.
        segments: (S, 4) float64, x and y of both ends of each wall segment, m, world frame.
        via_points: (V, 2) float64, points in m that attract the band.
        velocity: (2,) float64, speed in m/s and yaw rate in rad/s at the first pose.
        rotate: direction of turning to prefer at first, +1 left, -1 right, 0 none.
    """

    outline: NDArray[np.float64]
    segments: NDArray[np.float64]
    via_points: NDArray[np.float64]
    velocity: NDArray[np.float64]
    rotate: float = 0.0


def optimise(band: Band, around: Surroundings, config: TebConfig, costs: Costs) -> Band | None:
    """Return the optimised band, or None where it diverged."""
    scale = 1.0
    for _ in range(config.no_outer_iterations):
        band = resize(band, config)
        unknowns = np.column_stack([band.poses, np.append(band.dt_s, 0.0)]).ravel()
        near = config.min_obstacle_dist_m * config.obstacle_association_force_inclusion_factor
        cutoff = config.min_obstacle_dist_m * config.obstacle_association_cutoff_factor
        reach = float(np.hypot(*around.outline.T).max())
        pairs = associate(unknowns, around.outline, reach, around.segments, near, cutoff)
        vias = _attach(band, around.via_points)
        problem = Problem(costs, around.outline, around.segments, pairs, scale, vias, around.velocity, around.rotate)
        best = _levenberg_marquardt(unknowns, problem, config.no_inner_iterations)
        if best is None:
            return None
        grid = best.reshape(-1, 4)
        band = Band(grid[:, :3].copy(), grid[:-1, 3].copy())
        scale *= config.weight_adapt_factor
    return band


def _attach(band: Band, via_points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (V', 3): the index of the inner pose nearest to each via point, and the point; those behind are left."""
    last = len(band.poses) - 1
    rows = []
    for point in via_points:
        nearest = int(np.argmin(((band.poses[:, :2] - point) ** 2).sum(axis=1)))
        if nearest > 0:
            rows.append((min(nearest, last - 1), *point))
    return np.array(rows, float).reshape(-1, 3)


def _levenberg_marquardt(
    unknowns: NDArray[np.float64], problem: Problem, n_iterations: int
) -> NDArray[np.float64] | None:
    """Return the unknowns after at most `n_iterations` steps; None where the cost is not finite.

    Damping after Nielsen, as g2o does: it shrinks smoothly with the ratio of the gain to the predicted one.
    """
    cost = band_cost(unknowns, problem)
    damping, growth = 0.0, 2.0
    for _ in range(n_iterations):
        matrix, gradient = normal_equations(unknowns, problem)
        if not (np.isfinite(cost) and np.isfinite(matrix).all()):
            return None
        damping = damping or _FIRST_DAMPING * float(matrix[0].max())
        for _ in range(_TRIALS):
            step = _damped_step(matrix, gradient, damping)
            moved = unknowns + step
            moved[3::4] = np.maximum(moved[3::4], _MIN_DT_S)
            moved_cost = band_cost(moved, problem)
            gain = (cost - moved_cost) / (float(step @ (damping * step - gradient)) + 1e-12)
            if gain > 0.0 and np.isfinite(moved_cost):
                unknowns, cost = moved, moved_cost
                damping *= max(1.0 / 3.0, min(1.0 - (2.0 * gain - 1.0) ** 3, 2.0 / 3.0))
                growth = 2.0
                break
            damping, growth = damping * growth, growth * 2.0
        else:
            break
    return unknowns


def _damped_step(matrix: NDArray[np.float64], gradient: NDArray[np.float64], damping: float) -> NDArray[np.float64]:
    damped = matrix.copy()
    damped[0] += damping
    return scipy.linalg.solveh_banded(damped, -gradient, lower=True, check_finite=False, overwrite_ab=True)
