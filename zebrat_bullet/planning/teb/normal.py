"""Cost, gradient and banded normal matrix of a band, compiled.

The unknowns are x, y, yaw of each pose and the time to the next, in this order, pose by pose. No term reaches beyond
three poses in a row, so the normal matrix has 10 diagonals below its main one.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from zebrat_bullet.planning.teb.clearance import Floats, clearance, distance_to_point
from zebrat_bullet.planning.teb.terms import (
    Costs,
    acceleration,
    below,
    non_holonomic,
    outside,
    too_tight,
    velocity,
    wrap,
)

Ints = NDArray[np.int64]

BANDWIDTH = 10
_STEP = 1e-6  # of the central differences


@njit(cache=True, error_model="numpy")
def step_errors(
    q: Floats,
    costs: Costs,
    first: bool,
    last: bool,
    v_start: float,
    omega_start: float,
    rotate: float,
    errors: Floats,
) -> None:
    """Write the eleven errors of a step between two poses.

    Args:
        q: (7,) float64: x, y, yaw, dt, next x, next y, next yaw.
        costs: `Costs`.
        first, last: is it the first or last step of the band, which begins at a known velocity and ends at rest?
        v_start, omega_start: that velocity in m/s and rad/s.
        rotate: the direction of turning to prefer in this step, +1 left, -1 right, 0 none.
        errors: (11,) float64, written.
    """
    dx, dy, dt = q[4] - q[0], q[5] - q[1], q[3]
    turn = wrap(q[6] - q[2])
    v, omega = velocity(dx, dy, q[2], dt), turn / dt
    epsilon = costs.penalty_epsilon
    errors[:] = 0.0
    errors[0] = non_holonomic(dx, dy, q[2], q[6])
    errors[1] = below(dx * math.cos(q[2]) + dy * math.sin(q[2]), 0.0, 0.0)
    errors[2] = too_tight(math.hypot(dx, dy), turn, costs.min_turning_radius_m)
    errors[3] = outside(v, -costs.max_vel_x_backwards_mps, costs.max_vel_x_mps, epsilon)
    errors[4] = outside(omega, -costs.max_vel_theta_radps, costs.max_vel_theta_radps, epsilon)
    errors[5] = dt
    errors[6] = below(rotate * turn, 0.0, 0.0)
    a, alpha = costs.acc_lim_x_mps2, costs.acc_lim_theta_radps2
    if first:
        errors[7] = outside(acceleration(v_start, v, dt), -a, a, epsilon)
        errors[8] = outside(acceleration(omega_start, omega, dt), -alpha, alpha, epsilon)
    if last:
        errors[9] = outside(acceleration(v, 0.0, dt), -a, a, epsilon)
        errors[10] = outside(acceleration(omega, 0.0, dt), -alpha, alpha, epsilon)


@njit(cache=True, error_model="numpy")
def step_weights(costs: Costs) -> Floats:
    """Return the weights of `step_errors`, in its order."""
    return np.array(
        [
            costs.weight_kinematics_nh,
            costs.weight_kinematics_forward_drive,
            costs.weight_kinematics_turning_radius,
            costs.weight_max_vel_x,
            costs.weight_max_vel_theta,
            costs.weight_optimaltime,
            costs.weight_prefer_rotdir,
            costs.weight_acc_lim_x,
            costs.weight_acc_lim_theta,
            costs.weight_acc_lim_x,
            costs.weight_acc_lim_theta,
        ]
    )


@njit(cache=True, error_model="numpy")
def pair_errors(q: Floats, costs: Costs, errors: Floats) -> None:
    """Write the two errors of the acceleration between two steps.

    Args:
        q: (11,) float64: x, y, yaw, dt, x, y, yaw, dt, x, y, yaw of three poses in a row.
        costs: `Costs`.
        errors: (2,) float64, written.
    """
    dt1, dt2 = q[3], q[7]
    v1 = velocity(q[4] - q[0], q[5] - q[1], q[2], dt1)
    v2 = velocity(q[8] - q[4], q[9] - q[5], q[6], dt2)
    omega1, omega2 = wrap(q[6] - q[2]) / dt1, wrap(q[10] - q[6]) / dt2
    a, alpha, dt = costs.acc_lim_x_mps2, costs.acc_lim_theta_radps2, 0.5 * (dt1 + dt2)
    errors[0] = outside(acceleration(v1, v2, dt), -a, a, costs.penalty_epsilon)
    errors[1] = outside(acceleration(omega1, omega2, dt), -alpha, alpha, costs.penalty_epsilon)


@njit(cache=True, error_model="numpy")
def obstacle_errors(distance: float, costs: Costs) -> tuple[float, float]:
    """Return the errors of being nearer to a wall than the distance to keep, and than the inflation distance."""
    too_near = below(distance, costs.min_obstacle_dist_m, costs.penalty_epsilon)
    inflated = 0.0
    if costs.inflation_dist_m > costs.min_obstacle_dist_m:
        inflated = below(distance, costs.inflation_dist_m, 0.0)
    return too_near, inflated


@njit(cache=True, error_model="numpy")
def _felt(costs: Costs) -> float:
    """Return the distance in m beyond which a wall costs nothing."""
    return max(costs.min_obstacle_dist_m + costs.penalty_epsilon, costs.inflation_dist_m)


@njit(cache=True, error_model="numpy")
def associate(unknowns: Floats, outline: Floats, reach: float, segments: Floats, near: float, cutoff: float) -> Ints:
    """Return (P, 2) int64, which pose feels which wall: all nearer than `near`, and the nearest on each side.

    Args:
        unknowns: (4 N,) float64, the band.
        outline: (K, 2) float64, footprint in the rear-axle frame, m.
        reach: distance of its farthest corner from the rear axle in m.
        segments: (S, 4) float64, walls, m.
        near, cutoff: in m; beyond the cutoff no wall is felt.
    """
    n, n_segments = len(unknowns) // 4, len(segments)
    pairs = np.empty((n * n_segments, 2), np.int64)
    count = 0
    for i in range(1, n - 1):
        pose = unknowns[4 * i : 4 * i + 3]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        nearest = np.array([cutoff, cutoff])
        which = np.array([-1, -1])
        for j in range(n_segments):
            segment = segments[j]
            if distance_to_point(segment, pose[0], pose[1]) - reach > cutoff:
                continue
            distance = clearance(outline, pose, segment, cutoff)[0]
            if distance < near:
                pairs[count] = i, j
                count += 1
                continue
            mx, my = 0.5 * (segment[0] + segment[2]) - pose[0], 0.5 * (segment[1] + segment[3]) - pose[1]
            side = 0 if c * my - s * mx > 0.0 else 1
            if distance < nearest[side]:
                nearest[side], which[side] = distance, j
        for side in range(2):
            if which[side] >= 0:
                pairs[count] = i, which[side]
                count += 1
    return pairs[:count]


@njit(cache=True, error_model="numpy")
def band_cost(
    unknowns: Floats,
    costs: Costs,
    outline: Floats,
    segments: Floats,
    pairs: Ints,
    obstacle_scale: float,
    vias: Floats,
    start: Floats,
    rotate: float,
) -> float:
    """Return the cost of a band: the sum of weight times error squared over all its terms.

    Args:
        unknowns: (4 N,) float64; the last number is no time step and unused.
        costs: `Costs`.
        outline: (K, 2) float64, footprint in the rear-axle frame, m.
        segments: (S, 4) float64, walls, m.
        pairs: (P, 2) int64 of `associate`.
        obstacle_scale: factor of the obstacle weight.
        vias: (V, 3) float64: index of a pose, x and y of the point in m that attracts it.
        start: (2,) float64, speed in m/s and yaw rate in rad/s that the band begins with.
        rotate: direction of turning to prefer in the first three steps; 0 for none.
    """
    n = len(unknowns) // 4
    weights, errors, pair = step_weights(costs), np.empty(11), np.empty(2)
    cost = 0.0
    for i in range(n - 1):
        q = unknowns[4 * i : 4 * i + 7]
        step_errors(q, costs, i == 0, i == n - 2, start[0], start[1], rotate if i < 3 else 0.0, errors)
        cost += np.sum(weights * errors * errors)
        if i < n - 2:
            pair_errors(unknowns[4 * i : 4 * i + 11], costs, pair)
            cost += costs.weight_acc_lim_x * pair[0] ** 2 + costs.weight_acc_lim_theta * pair[1] ** 2
    felt = _felt(costs)
    for k in range(len(pairs)):
        i = pairs[k, 0]
        distance = clearance(outline, unknowns[4 * i : 4 * i + 3], segments[pairs[k, 1]], felt)[0]
        too_near, inflated = obstacle_errors(distance, costs)
        cost += obstacle_scale * costs.weight_obstacle * too_near**2 + costs.weight_inflation * inflated**2
    for k in range(len(vias)):
        i = 4 * int(vias[k, 0])
        cost += costs.weight_viapoint * ((unknowns[i] - vias[k, 1]) ** 2 + (unknowns[i + 1] - vias[k, 2]) ** 2)
    return cost


@njit(cache=True, error_model="numpy")
def _add(matrix: Floats, gradient: Floats, base: int, jacobian: Floats, errors: Floats, weights: Floats) -> None:
    """Add the terms of one block of consecutive unknowns, from `base` on."""
    n_errors, size = jacobian.shape
    for k in range(n_errors):
        w = weights[k]
        if w == 0.0:
            continue
        for c in range(size):
            weighted = w * jacobian[k, c]
            if weighted == 0.0:
                continue
            gradient[base + c] += weighted * errors[k]
            for r in range(c, size):
                matrix[r - c, base + c] += weighted * jacobian[k, r]


@njit(cache=True, error_model="numpy")
def normal_equations(
    unknowns: Floats,
    costs: Costs,
    outline: Floats,
    segments: Floats,
    pairs: Ints,
    obstacle_scale: float,
    vias: Floats,
    start: Floats,
    rotate: float,
) -> tuple[Floats, Floats]:
    """Return J'WJ, (11, 4 N) float64 in LAPACK's lower banded form, and J'We, (4 N,) float64; arguments as `band_cost`.

    Rows and columns of the first and last pose are 0: they do not move.
    """
    n = len(unknowns) // 4
    matrix, gradient = np.zeros((BANDWIDTH + 1, 4 * n)), np.zeros(4 * n)
    weights, errors, above, under = step_weights(costs), np.empty(11), np.empty(11), np.empty(11)
    pair_weights = np.array([costs.weight_acc_lim_x, costs.weight_acc_lim_theta])
    pair, pair_above, pair_under = np.empty(2), np.empty(2), np.empty(2)
    jacobian, pair_jacobian = np.empty((11, 7)), np.empty((2, 11))
    for i in range(n - 1):
        base = 4 * i
        q = unknowns[base : base + 7].copy()
        first, last, turn = i == 0, i == n - 2, rotate if i < 3 else 0.0
        step_errors(q, costs, first, last, start[0], start[1], turn, errors)
        for c in range(7):
            q[c] = unknowns[base + c] + _STEP
            step_errors(q, costs, first, last, start[0], start[1], turn, above)
            q[c] = unknowns[base + c] - _STEP
            step_errors(q, costs, first, last, start[0], start[1], turn, under)
            q[c] = unknowns[base + c]
            jacobian[:, c] = (above - under) * (0.0 if _fixed(base + c, n) else 0.5 / _STEP)
        _add(matrix, gradient, base, jacobian, errors, weights)
        if i == n - 2:
            break
        q = unknowns[base : base + 11].copy()
        pair_errors(q, costs, pair)
        if pair[0] == 0.0 and pair[1] == 0.0:
            continue
        for c in range(11):
            q[c] = unknowns[base + c] + _STEP
            pair_errors(q, costs, pair_above)
            q[c] = unknowns[base + c] - _STEP
            pair_errors(q, costs, pair_under)
            q[c] = unknowns[base + c]
            pair_jacobian[:, c] = (pair_above - pair_under) * (0.0 if _fixed(base + c, n) else 0.5 / _STEP)
        _add(matrix, gradient, base, pair_jacobian, pair, pair_weights)
    _add_obstacles(matrix, gradient, unknowns, costs, outline, segments, pairs, obstacle_scale)
    for k in range(len(vias)):
        for c in range(2):
            i = 4 * int(vias[k, 0]) + c
            matrix[0, i] += costs.weight_viapoint
            gradient[i] += costs.weight_viapoint * (unknowns[i] - vias[k, 1 + c])
    return matrix, gradient


@njit(cache=True, error_model="numpy")
def _fixed(index: int, n: int) -> bool:
    return index < 3 or index >= 4 * (n - 1)


@njit(cache=True, error_model="numpy")
def _add_obstacles(
    matrix: Floats,
    gradient: Floats,
    unknowns: Floats,
    costs: Costs,
    outline: Floats,
    segments: Floats,
    pairs: Ints,
    obstacle_scale: float,
) -> None:
    weights, errors, jacobian = np.empty(2), np.empty(2), np.empty((2, 3))
    weights[0], weights[1] = obstacle_scale * costs.weight_obstacle, costs.weight_inflation
    felt = _felt(costs)
    for k in range(len(pairs)):
        base = 4 * pairs[k, 0]
        distance, by_x, by_y, by_yaw = clearance(outline, unknowns[base : base + 3], segments[pairs[k, 1]], felt)
        errors[0], errors[1] = obstacle_errors(distance, costs)
        for r in range(2):
            slope = -1.0 if errors[r] > 0.0 else 0.0
            jacobian[r, 0], jacobian[r, 1], jacobian[r, 2] = slope * by_x, slope * by_y, slope * by_yaw
        _add(matrix, gradient, base, jacobian, errors, weights)
