"""The inner loop of Hybrid A*, compiled: the search, and whether the car's outline touches a wall, exactly."""

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.planning.compiled import compiled
from zebrat_bullet.planning.footprint_check import Outline, WallIndex


class Field(NamedTuple):
    """What is known of each cell of the floor.

    Attributes:
        to_goal_m: (H, W) float64, m from the cell to the goal for a point that keeps off the walls; inf where it cannot
            come.
        ids: (H, W) int64, numbers the cells the rear axle may be in; -1 elsewhere.
        x, y: lower corner of the grid; cell_m: edge of a cell.
    """

    to_goal_m: NDArray[np.float64]
    ids: NDArray[np.int64]
    x: float
    y: float
    cell_m: float


class Moves(NamedTuple):
    """The arcs that may be driven, and what they cost beyond their length.

    Attributes:
        steering_rad, curvatures: (A,) float64, of each arc.
        length_m: of every arc; n_checks: poses checked along it.
        reverse_cost, reversal_cost, steering_cost: as in `HybridAStarConfig`.
    """

    steering_rad: NDArray[np.float64]
    curvatures: NDArray[np.float64]
    length_m: float
    n_checks: int
    reverse_cost: float
    reversal_cost: float
    steering_cost: float


class Goal(NamedTuple):
    """Where the lidar must come: m, world frame; and the lidar in the frame of the rear axle."""

    x: float
    y: float
    radius_m: float
    lidar_x: float
    lidar_y: float


class Found(NamedTuple):
    """The tree of poses that were reached.

    Attributes:
        poses: (N, 3) float64, rear axle.
        parents: (N,) int64; moves: (N,) int64, which arc; directions: (N,) int64, 1 or -1. The root is the first.
        last: the pose at the goal; -1 if none was reached.
    """

    poses: NDArray[np.float64]
    parents: NDArray[np.int64]
    moves: NDArray[np.int64]
    directions: NDArray[np.int64]
    last: int


@compiled
def distances_to(free: NDArray[np.bool_], row: int, column: int, cell_m: float) -> NDArray[np.float64]:
    """Return the (H, W) length in m of the shortest 8-connected way over free cells to the cell at (row, column)."""
    distances = np.full(free.shape, np.inf)
    distances[row, column] = 0.0
    heap = [(0.0, row, column)]
    while heap:
        here, i, j = heappop(heap)
        if here > distances[i, j]:
            continue
        for di in range(-1, 2):
            for dj in range(-1, 2):
                k, m = i + di, j + dj
                if not (0 <= k < free.shape[0] and 0 <= m < free.shape[1]) or not free[k, m]:
                    continue
                there = here + cell_m * np.sqrt(float(di * di + dj * dj))
                if there < distances[k, m]:
                    distances[k, m] = there
                    heappush(heap, (there, k, m))
    return distances


@compiled
def search(
    start: NDArray[np.float64],
    goal: Goal,
    field: Field,
    n_yaw: int,
    moves: Moves,
    walls: WallIndex,
    outline: Outline,
    leaving_outline: Outline,
    leaving_m: float,
    max_nodes: int,
) -> Found:
    """Return the tree of the search, up to the goal or to its end.

    Args:
        start: (3,) pose of the rear axle.
        goal, field, moves, walls: see their types.
        n_yaw: cells of the full turn.
        outline: what must not meet the walls; `leaving_outline` takes its place on the first `leaving_m`.
        max_nodes: give up after so many poses.
    """
    best = np.full((field.ids.max() + 1) * n_yaw * 2, np.inf, dtype=np.float32)
    xs, ys, yaws = [start[0]], [start[1]], [start[2]]
    costs, parents, taken, directions = [0.0], [-1], [len(moves.curvatures) // 2], [0]
    heap = [(0.0, 0)]
    last = -1
    while heap and len(xs) < max_nodes:
        _, i = heappop(heap)
        key = _key(field, n_yaw, xs[i], ys[i], yaws[i], directions[i])
        if i > 0 and costs[i] > best[key] + 1e-4:
            continue
        if _lidar_to_goal(goal, xs[i], ys[i], yaws[i]) < goal.radius_m:
            last = i
            break
        check = leaving_outline if costs[i] < leaving_m else outline
        for a in range(len(moves.curvatures)):
            for direction in (1, -1):
                cost = costs[i] + _price(moves, taken[i], a, directions[i], direction)
                x, y, yaw = _along(xs[i], ys[i], yaws[i], moves.curvatures[a], direction * moves.length_m)
                key = _key(field, n_yaw, x, y, yaw, direction)
                if key < 0 or cost >= best[key] - 1e-4:
                    continue
                if _blocked(walls, check, xs[i], ys[i], yaws[i], moves, a, direction):
                    continue
                best[key] = cost
                xs.append(x)
                ys.append(y)
                yaws.append(yaw)
                costs.append(cost)
                parents.append(i)
                taken.append(a)
                directions.append(direction)
                heappush(heap, (cost + _rest(field, goal, x, y), len(xs) - 1))
    poses = np.stack((np.array(xs), np.array(ys), np.array(yaws)), axis=1)
    return Found(poses, np.array(parents), np.array(taken), np.array(directions), last)


@compiled
def touches(walls: WallIndex, outline: Outline, x: float, y: float, yaw: float) -> bool:
    """Return whether the outline of a car with its rear axle at this pose meets a wall segment."""
    c, s = np.cos(yaw), np.sin(yaw)
    column = int(np.floor((x + c * outline.centre_x - s * outline.centre_y - walls.x) / walls.bucket_m))
    row = int(np.floor((y + s * outline.centre_x + c * outline.centre_y - walls.y) / walls.bucket_m))
    if not (0 <= column < walls.nx and 0 <= row < walls.ny):
        return False
    bucket = row * walls.nx + column
    for i in range(walls.first[bucket], walls.first[bucket + 1]):
        if _cuts(walls.segments[walls.entries[i]], outline, x, y, c, s):
            return True
    return False


@compiled
def _cuts(segment: NDArray[np.float64], outline: Outline, x: float, y: float, c: float, s: float) -> bool:
    """Clip a segment by the outline's half-planes (Cyrus and Beck): it cuts the outline where something is left."""
    ax, ay = segment[0] - x, segment[1] - y
    dx, dy = segment[2] - segment[0], segment[3] - segment[1]
    begin, end = 0.0, 1.0
    for k in range(len(outline.offsets)):
        nx = c * outline.normals[k, 0] - s * outline.normals[k, 1]
        ny = s * outline.normals[k, 0] + c * outline.normals[k, 1]
        outside = nx * ax + ny * ay - outline.offsets[k]
        slope = nx * dx + ny * dy
        if slope == 0.0:
            if outside > 0.0:
                return False
        elif slope < 0.0:
            begin = max(begin, -outside / slope)
        else:
            end = min(end, -outside / slope)
        if begin > end:
            return False
    return True


@compiled
def _along(x: float, y: float, yaw: float, curvature: float, length: float) -> tuple[float, float, float]:
    turn = curvature * length
    chord = length if turn == 0.0 else length * np.sin(turn / 2.0) / (turn / 2.0)
    return x + chord * np.cos(yaw + turn / 2.0), y + chord * np.sin(yaw + turn / 2.0), yaw + turn


@compiled
def _blocked(
    walls: WallIndex, outline: Outline, x: float, y: float, yaw: float, moves: Moves, a: int, direction: int
) -> bool:
    step = direction * moves.length_m / moves.n_checks
    for k in range(moves.n_checks, 0, -1):  # the far end first: it hits most often
        px, py, pyaw = _along(x, y, yaw, moves.curvatures[a], k * step)
        if touches(walls, outline, px, py, pyaw):
            return True
    return False


@compiled
def _key(field: Field, n_yaw: int, x: float, y: float, yaw: float, direction: int) -> int:
    """Return the number of the cell of (x, y, yaw, direction); -1 where it is not worth a visit."""
    row, column = int(np.floor((y - field.y) / field.cell_m)), int(np.floor((x - field.x) / field.cell_m))
    if not (0 <= row < field.ids.shape[0] and 0 <= column < field.ids.shape[1]) or field.ids[row, column] < 0:
        return -1
    yaw_cell = int(np.floor(yaw / (2.0 * np.pi) * n_yaw)) % n_yaw
    return (field.ids[row, column] * n_yaw + yaw_cell) * 2 + (1 if direction > 0 else 0)


@compiled
def _price(moves: Moves, before: int, move: int, direction_before: int, direction: int) -> float:
    change = abs(moves.steering_rad[move] - moves.steering_rad[before])
    price = moves.length_m + moves.steering_cost * change
    if direction < 0:
        price += moves.reverse_cost * moves.length_m
    if direction * direction_before < 0:
        price += moves.reversal_cost
    return price


@compiled
def _lidar_to_goal(goal: Goal, x: float, y: float, yaw: float) -> float:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.hypot(x + c * goal.lidar_x - s * goal.lidar_y - goal.x, y + s * goal.lidar_x + c * goal.lidar_y - goal.y)


@compiled
def _rest(field: Field, goal: Goal, x: float, y: float) -> float:
    """Estimate what is left: the axle need not come nearer than the lidar stands ahead of it."""
    row, column = int((y - field.y) / field.cell_m), int((x - field.x) / field.cell_m)
    return max(0.0, field.to_goal_m[row, column] - goal.radius_m - np.hypot(goal.lidar_x, goal.lidar_y))
