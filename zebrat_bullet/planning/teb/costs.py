"""What a timed elastic band costs: its error terms, their sum weighted and squared, and its derivatives; compiled.

A step of the band leads from one pose (x, y, yaw of the rear axle's centre) to the next in the time dt. The unknowns
are x, y, yaw of each pose and the time to the next, in this order, pose by pose. No term reaches beyond three poses in
a row, so the normal matrix has 10 diagonals below its main one.

All compiled functions of the band are in this file; `compiled` says why.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.planning.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Contact = tuple[float, float, float, float, float]

BANDWIDTH = 10
_STEP = 1e-6  # of the central differences
# A wall parallel to a side is equally near to both its corners; within this many m (or m squared) their middle counts,
# so that left and right, which are told apart by rounding alone, are treated alike.
_TIE = 1e-9


class Costs(NamedTuple):
    """Bounds and weights of the terms; `TebConfig` says what each means."""

    max_vel_x_mps: float
    max_vel_x_backwards_mps: float
    max_vel_theta_radps: float
    acc_lim_x_mps2: float
    acc_lim_theta_radps2: float
    min_turning_radius_m: float
    min_obstacle_dist_m: float
    inflation_dist_m: float
    penalty_epsilon: float
    weight_kinematics_nh: float
    weight_kinematics_forward_drive: float
    weight_kinematics_turning_radius: float
    weight_max_vel_x: float
    weight_max_vel_theta: float
    weight_acc_lim_x: float
    weight_acc_lim_theta: float
    weight_optimaltime: float
    weight_obstacle: float
    weight_inflation: float
    weight_viapoint: float
    weight_prefer_rotdir: float


class Problem(NamedTuple):
    """What a band is measured against.

    Attributes:
        costs: bounds and weights.
        outline: (K, 2) float64, convex footprint in the rear-axle frame, counter-clockwise, m.
        segments: (S, 4) float64, x and y of both ends of each wall, m, world frame.
        pairs: (P, 2) int64 of `associate`.
        obstacle_scale: factor of the obstacle weight.
        vias: (V, 3) float64: index of a pose, x and y of the point in m that attracts it.
        start: (2,) float64, speed in m/s and yaw rate in rad/s that the band begins with.
        rotate: direction of turning to prefer in the first three steps, +1 left, -1 right, 0 none.
    """

    costs: Costs
    outline: Floats
    segments: Floats
    pairs: Ints
    obstacle_scale: float
    vias: Floats
    start: Floats
    rotate: float


@compiled
def wrap(angle: float) -> float:
    """Return the same direction in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@compiled
def below(value: float, bound: float, epsilon: float) -> float:
    """Return by how much a value is below a bound, felt `epsilon` early."""
    return max(0.0, bound + epsilon - value)


@compiled
def outside(value: float, low: float, high: float, epsilon: float) -> float:
    """Return by how much a value is outside [low, high], felt `epsilon` early at both ends."""
    return max(0.0, low + epsilon - value, value - high + epsilon)


@compiled
def non_holonomic(dx: float, dy: float, yaw: float, next_yaw: float) -> float:
    """Return how far a step is from an arc: 0 where both headings make the same angle with the chord."""
    return (math.cos(yaw) + math.cos(next_yaw)) * dy - (math.sin(yaw) + math.sin(next_yaw)) * dx


@compiled
def too_tight(distance: float, turn: float, min_radius: float) -> float:
    """Return by how much the turning radius of a step falls short of the smallest one, in m."""
    return 0.0 if turn == 0.0 else below(distance / abs(turn), min_radius, 0.0)


@compiled
def velocity(dx: float, dy: float, yaw: float, dt: float) -> float:
    """Return the speed of a step in m/s, below 0 in reverse; a smooth sign keeps it differentiable at rest."""
    forward = 100.0 * (dx * math.cos(yaw) + dy * math.sin(yaw))
    return math.hypot(dx, dy) / dt * forward / (1.0 + abs(forward))


@compiled
def acceleration(before: float, after: float, dt: float) -> float:
    """Return the mean acceleration between two (angular) speeds that lie `dt` apart."""
    return (after - before) / dt


@compiled
def _nearest_on_segment(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> tuple[float, float]:
    """Return the point of the segment a-b that is nearest to p."""
    dx, dy = bx - ax, by - ay
    along = ((px - ax) * dx + (py - ay) * dy) / max(dx * dx + dy * dy, 1e-18)
    along = min(1.0, max(0.0, along))
    return ax + along * dx, ay + along * dy


@compiled
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
        gap, count, sum_x, sum_y = np.inf, 0, 0.0, 0.0
        for k in range(n):
            vx, vy = outline[k, 0], outline[k, 1]
            here = side * (mx * (vx - ax) + my * (vy - ay))
            if here < gap - _TIE:
                gap, count, sum_x, sum_y = here, 0, 0.0, 0.0
            if here < gap + _TIE:
                count, sum_x, sum_y = count + 1, sum_x + vx, sum_y + vy
        if gap > best - _TIE:
            best, nx, ny = gap, -side * mx, -side * my
            qx, qy = sum_x / count + gap * nx, sum_y / count + gap * ny
    return best, nx, ny, qx, qy


@compiled
def _apart(outline: Floats, ax: float, ay: float, bx: float, by: float) -> Contact:
    """Return the distance of a segment from an outline that it does not touch, the unit normal to it, and its point."""
    best, nx, ny, count, sum_x, sum_y = np.inf, 0.0, 0.0, 0, 0.0, 0.0
    n = len(outline)
    for k in range(n):
        vx, vy = outline[k, 0], outline[k, 1]
        wx, wy = outline[(k + 1) % n, 0], outline[(k + 1) % n, 1]
        for end in range(3):
            if end == 0:
                px, py = vx, vy
                qx, qy = _nearest_on_segment(px, py, ax, ay, bx, by)
            else:
                qx, qy = (ax, ay) if end == 1 else (bx, by)
                px, py = _nearest_on_segment(qx, qy, vx, vy, wx, wy)
            squared = (qx - px) ** 2 + (qy - py) ** 2
            if squared < best - _TIE:
                best, nx, ny, count, sum_x, sum_y = squared, qx - px, qy - py, 0, 0.0, 0.0
            if squared < best + _TIE:
                count, sum_x, sum_y = count + 1, sum_x + qx, sum_y + qy
    distance = math.sqrt(best)
    return distance, nx / distance, ny / distance, sum_x / count, sum_y / count


@compiled
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


@compiled
def distance_to_point(segment: Floats, x: float, y: float) -> float:
    """Return the distance in m of a point from a segment."""
    px, py = _nearest_on_segment(x, y, segment[0], segment[1], segment[2], segment[3])
    return math.hypot(px - x, py - y)


@compiled
def step_errors(q: Floats, i: int, n: int, problem: Problem, errors: Floats) -> None:
    """Write the eleven errors of a step.

    Args:
        q: (7,) float64: x, y, yaw, dt, next x, next y, next yaw.
        i, n: it is the i-th step of a band of n poses. The first begins at a known velocity, the last ends at rest.
        problem: bounds, that velocity, and the direction of turning to prefer.
        errors: (11,) float64, written.
    """
    costs = problem.costs
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
    errors[6] = below(problem.rotate * turn, 0.0, 0.0) if i < 3 else 0.0
    a, alpha = costs.acc_lim_x_mps2, costs.acc_lim_theta_radps2
    if i == 0:
        errors[7] = outside(acceleration(problem.start[0], v, dt), -a, a, epsilon)
        errors[8] = outside(acceleration(problem.start[1], omega, dt), -alpha, alpha, epsilon)
    if i == n - 2:
        errors[9] = outside(acceleration(v, 0.0, dt), -a, a, epsilon)
        errors[10] = outside(acceleration(omega, 0.0, dt), -alpha, alpha, epsilon)


@compiled
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


@compiled
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


@compiled
def obstacle_errors(distance: float, costs: Costs) -> tuple[float, float]:
    """Return the errors of being nearer to a wall than the distance to keep, and than the inflation distance."""
    too_near = below(distance, costs.min_obstacle_dist_m, costs.penalty_epsilon)
    inflated = 0.0
    if costs.inflation_dist_m > costs.min_obstacle_dist_m:
        inflated = below(distance, costs.inflation_dist_m, 0.0)
    return too_near, inflated


@compiled
def _felt(costs: Costs) -> float:
    """Return the distance in m beyond which a wall costs nothing."""
    return max(costs.min_obstacle_dist_m + costs.penalty_epsilon, costs.inflation_dist_m)


@compiled
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


@compiled
def band_cost(unknowns: Floats, problem: Problem) -> float:
    """Return the cost of a band: the sum of weight times error squared over all its terms.

    Args:
        unknowns: (4 N,) float64; the last number is no time step and unused.
        problem: what the band is measured against.
    """
    costs = problem.costs
    n, cost, felt = len(unknowns) // 4, 0.0, _felt(costs)
    weights, errors, pair = step_weights(costs), np.empty(11), np.empty(2)
    for i in range(n - 1):
        step_errors(unknowns[4 * i : 4 * i + 7], i, n, problem, errors)
        cost += np.sum(weights * errors * errors)
        if i < n - 2:
            pair_errors(unknowns[4 * i : 4 * i + 11], costs, pair)
            cost += costs.weight_acc_lim_x * pair[0] ** 2 + costs.weight_acc_lim_theta * pair[1] ** 2
    for i, j in problem.pairs:
        distance = clearance(problem.outline, unknowns[4 * i : 4 * i + 3], problem.segments[j], felt)[0]
        too_near, inflated = obstacle_errors(distance, costs)
        cost += problem.obstacle_scale * costs.weight_obstacle * too_near**2 + costs.weight_inflation * inflated**2
    for pose, x, y in problem.vias:
        i = 4 * int(pose)
        cost += costs.weight_viapoint * ((unknowns[i] - x) ** 2 + (unknowns[i + 1] - y) ** 2)
    return cost


@compiled
def normal_equations(unknowns: Floats, problem: Problem) -> tuple[Floats, Floats]:
    """Return J'WJ, (11, 4 N) float64 in LAPACK's lower banded form, and J'We, (4 N,) float64; arguments as `band_cost`.

    Rows and columns of the first and last pose are 0: they do not move.
    """
    n = len(unknowns) // 4
    matrix, gradient = np.zeros((BANDWIDTH + 1, 4 * n)), np.zeros(4 * n)
    for i in range(n - 1):
        _add_step(matrix, gradient, unknowns, i, problem)
    for i in range(n - 2):
        _add_pair(matrix, gradient, unknowns, i, problem.costs)
    _add_obstacles(matrix, gradient, unknowns, problem)
    weight = problem.costs.weight_viapoint
    for pose, x, y in problem.vias:
        i = 4 * int(pose)
        matrix[0, i : i + 2] += weight
        gradient[i] += weight * (unknowns[i] - x)
        gradient[i + 1] += weight * (unknowns[i + 1] - y)
    for fixed in (0, 1, 2, 4 * n - 4, 4 * n - 3, 4 * n - 2):
        gradient[fixed] = 0.0
        matrix[:, fixed] = 0.0
        for below_diagonal in range(min(fixed, BANDWIDTH) + 1):
            matrix[below_diagonal, fixed - below_diagonal] = 0.0
    return matrix, gradient


@compiled
def _add_step(matrix: Floats, gradient: Floats, unknowns: Floats, i: int, problem: Problem) -> None:
    n, base = len(unknowns) // 4, 4 * i
    q, jacobian = unknowns[base : base + 7].copy(), np.empty((11, 7))
    errors, above, under = np.empty(11), np.empty(11), np.empty(11)
    step_errors(q, i, n, problem, errors)
    for c in range(7):
        q[c] = unknowns[base + c] + _STEP
        step_errors(q, i, n, problem, above)
        q[c] = unknowns[base + c] - _STEP
        step_errors(q, i, n, problem, under)
        q[c] = unknowns[base + c]
        jacobian[:, c] = (above - under) * (0.5 / _STEP)
    _add(matrix, gradient, base, jacobian, errors, step_weights(problem.costs))


@compiled
def _add_pair(matrix: Floats, gradient: Floats, unknowns: Floats, i: int, costs: Costs) -> None:
    base = 4 * i
    q, jacobian = unknowns[base : base + 11].copy(), np.empty((2, 11))
    errors, above, under = np.empty(2), np.empty(2), np.empty(2)
    pair_errors(q, costs, errors)
    if errors[0] == 0.0 and errors[1] == 0.0:
        return
    for c in range(11):
        q[c] = unknowns[base + c] + _STEP
        pair_errors(q, costs, above)
        q[c] = unknowns[base + c] - _STEP
        pair_errors(q, costs, under)
        q[c] = unknowns[base + c]
        jacobian[:, c] = (above - under) * (0.5 / _STEP)
    _add(matrix, gradient, base, jacobian, errors, np.array([costs.weight_acc_lim_x, costs.weight_acc_lim_theta]))


@compiled
def _add_obstacles(matrix: Floats, gradient: Floats, unknowns: Floats, problem: Problem) -> None:
    costs, felt, jacobian, errors = problem.costs, _felt(problem.costs), np.empty((2, 3)), np.empty(2)
    weights = np.array([problem.obstacle_scale * costs.weight_obstacle, costs.weight_inflation])
    for i, j in problem.pairs:
        base = 4 * i
        distance, by_x, by_y, by_yaw = clearance(problem.outline, unknowns[base : base + 3], problem.segments[j], felt)
        errors[0], errors[1] = obstacle_errors(distance, costs)
        for r in range(2):
            slope = -1.0 if errors[r] > 0.0 else 0.0
            jacobian[r, 0], jacobian[r, 1], jacobian[r, 2] = slope * by_x, slope * by_y, slope * by_yaw
        _add(matrix, gradient, base, jacobian, errors, weights)


@compiled
def _add(matrix: Floats, gradient: Floats, base: int, jacobian: Floats, errors: Floats, weights: Floats) -> None:
    """Add a block of errors in consecutive unknowns, from `base` on."""
    n_errors, size = jacobian.shape
    for k in range(n_errors):
        for c in range(size):
            weighted = weights[k] * jacobian[k, c]
            if weighted == 0.0:
                continue
            gradient[base + c] += weighted * errors[k]
            for r in range(c, size):
                matrix[r - c, base + c] += weighted * jacobian[k, r]
