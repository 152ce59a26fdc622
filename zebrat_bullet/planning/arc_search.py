"""The inner loops of the oracle, compiled: how near the car's outline is to a wall, and the search of Hybrid A*.

Where the outline may be is asked of `separation`, a distance that is never too long: along an arc the next check stands
no further on than that distance allows, so that a margin holds between the checks too.
"""

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.planning.compiled import compiled
from zebrat_bullet.planning.footprint_check import Outline, WallIndex


class Field(NamedTuple):
    """How far each cell of the floor is from the goal.

    Attributes:
        to_goal: (H, W) float64, least cost from the cell to the goal for a point that keeps off the walls; inf where it
            cannot come, and where a visit is not worth it.
        x, y: lower corner of the grid; cell_m: edge of a cell.
    """

    to_goal: NDArray[np.float64]
    x: float
    y: float
    cell_m: float


class Moves(NamedTuple):
    """The arcs that may be driven, and what they cost beyond their length.

    Attributes:
        steering_rad, curvatures, sweeps: (A,) float64, of each arc; sweeps as of `sweep_factor`.
        length_m: of every arc that no wall cuts short; shortest_m: of one that a wall does.
        reverse_cost, reversal_cost, steering_cost, nearness_cost, wide_m: as in `HybridAStarConfig`.
    """

    steering_rad: NDArray[np.float64]
    curvatures: NDArray[np.float64]
    sweeps: NDArray[np.float64]
    length_m: float
    shortest_m: float
    reverse_cost: float
    reversal_cost: float
    steering_cost: float
    nearness_cost: float
    wide_m: float


class Cells(NamedTuple):
    """The cells in which poses compete: edges of `size_m` and `n_yaw` to the full turn, half of both near a wall."""

    size_m: float
    n_yaw: int
    tight_m: float


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
        exhausted: nothing was left to look at.
    """

    poses: NDArray[np.float64]
    parents: NDArray[np.int64]
    moves: NDArray[np.int64]
    directions: NDArray[np.int64]
    last: int
    exhausted: bool


@compiled
def distances_to(
    walls: WallIndex, radius_m: float, shape: tuple[int, int], corner: tuple[float, float], cell_m: float,
    goal: tuple[int, int], start: tuple[int, int], detour_m: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Return the (H, W) length in m of the shortest 8-connected way to the cell `goal`, inf where there is none.

    Ways lead over cells whose centres keep `radius_m` from the walls; cells further from the goal than the cell `start`
    by more than `detour_m` are not looked at.
    """
    distances = np.full(shape, np.inf)
    known = np.zeros(shape, dtype=np.int8)
    distances[goal] = 0.0
    heap = [(0.0, goal[0], goal[1])]
    most = np.inf
    while heap:
        here, i, j = heappop(heap)
        if here > distances[i, j]:
            continue
        if here > most:
            break
        if i == start[0] and j == start[1]:
            most = here + detour_m
        for di in range(-1, 2):
            for dj in range(-1, 2):
                k, m = i + di, j + dj
                if not (0 <= k < shape[0] and 0 <= m < shape[1]):
                    continue
                if known[k, m] == 0:
                    x, y = corner[0] + (m + 0.5) * cell_m, corner[1] + (k + 0.5) * cell_m
                    known[k, m] = 1 if _point_is_free(walls, x, y, radius_m) else 2
                if known[k, m] == 2:
                    continue
                there = here + cell_m * np.sqrt(float(di * di + dj * dj))
                if there < distances[k, m]:
                    distances[k, m] = there
                    heappush(heap, (there, k, m))
    for i in range(shape[0]):
        for j in range(shape[1]):
            if distances[i, j] > most:
                distances[i, j] = np.inf
    return distances


@compiled
def search(
    start: NDArray[np.float64],
    goal: Goal,
    field: Field,
    cells: Cells,
    moves: Moves,
    walls: WallIndex,
    outline: Outline,
    margin_m: float,
    leaving_margin_m: float,
    leaving_m: float,
    max_nodes: int,
) -> Found:
    """Return the tree of the search, up to the goal or to its end.

    Args:
        start: (3,) pose of the rear axle.
        goal, field, cells, moves, walls, outline: see their types.
        margin_m: what the outline keeps from the walls, but `leaving_margin_m` on the first `leaving_m`.
        max_nodes: give up after so many poses.
    """
    size = 1024
    while size < 2 * max_nodes:
        size *= 2
    keys, best = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.float32)
    poses, gaps = np.empty((max_nodes, 3)), np.empty(max_nodes)
    costs, driven = np.empty(max_nodes), np.empty(max_nodes)
    parents, taken = np.empty(max_nodes, dtype=np.int64), np.empty(max_nodes, dtype=np.int64)
    directions = np.empty(max_nodes, dtype=np.int64)
    poses[0], gaps[0] = start, separation(walls, outline, start[0], start[1], start[2], 0.0)
    costs[0], driven[0], parents[0], taken[0], directions[0] = 0.0, 0.0, -1, len(moves.curvatures) // 2, 0
    n, last = 1, -1
    heap = [(0.0, 0)]
    while heap and n < max_nodes:
        _, i = heappop(heap)
        x0, y0, yaw0 = poses[i]
        slot = _slot(keys, _key(cells, x0, y0, yaw0, directions[i], gaps[i]))
        if i > 0 and costs[i] > best[slot] + 1e-4:
            continue
        if _lidar_to_goal(goal, x0, y0, yaw0) < goal.radius_m:
            last = i
            break
        margin = leaving_margin_m if driven[i] < leaving_m else margin_m
        for a in range(len(moves.curvatures)):
            for direction in (1, -1):
                cost = costs[i] + _price(moves, taken[i], a, directions[i], direction)
                x, y, yaw = _along(x0, y0, yaw0, moves.curvatures[a], direction * moves.length_m)
                gap = separation(walls, outline, x, y, yaw, 1.25 * margin)
                if gap >= 1.25 * margin:  # most arcs lead where a cheaper one has led: no need to follow them
                    key = _key(cells, x, y, yaw, direction, gap)
                    slot = _slot(keys, key)
                    if keys[slot] == key and cost + moves.length_m >= best[slot] - 1e-4:
                        continue
                length, gap, near = _drive(walls, outline, x0, y0, yaw0, gaps[i], moves, a, direction, margin)
                if length < moves.shortest_m:
                    continue
                x, y, yaw = _along(x0, y0, yaw0, moves.curvatures[a], direction * length)
                rest = _rest(field, goal, x, y)
                if rest == np.inf:
                    continue
                cost += length + moves.nearness_cost * near
                if direction < 0:
                    cost += moves.reverse_cost * length
                key = _key(cells, x, y, yaw, direction, gap)
                slot = _slot(keys, key)
                if keys[slot] == key and cost >= best[slot] - 1e-4:
                    continue
                if n == max_nodes:
                    break
                keys[slot], best[slot] = key, cost
                poses[n, 0], poses[n, 1], poses[n, 2] = x, y, yaw
                gaps[n], costs[n], driven[n] = gap, cost, driven[i] + length
                parents[n], taken[n], directions[n] = i, a, direction
                heappush(heap, (cost + rest, n))
                n += 1
    exhausted = last < 0 and len(heap) == 0
    return Found(poses[:n].copy(), parents[:n].copy(), taken[:n].copy(), directions[:n].copy(), last, exhausted)


@compiled
def flood(
    start: tuple[float, float, float],
    corner: tuple[float, float],
    shape: tuple[int, int, int],
    cell_m: float,
    walls: WallIndex,
    outline: Outline,
    out: NDArray[np.bool_],
    lidar: tuple[float, float],
    max_cells: int,
) -> int:
    """Return whether cells of (x, y, yaw) whose middle pose is free join the start with the outside.

    Args:
        start: pose of the outline's frame.
        corner: lowest x and y of the grid; shape: its cells in y, x and yaw; cell_m: edge of a cell.
        walls, outline: a cell is free where the outline, at the cell's middle pose, meets no wall.
        out: (H, W) bool, the places of the same grid at which the lidar is outside; so it is off the grid.
        lidar: x and y in the outline's frame, m.
        max_cells: give up after so many.

    Returns:
        1 where they do, 0 where they do not, -1 where it gave up.
    """
    seen = np.zeros(shape, dtype=np.bool_)
    turn = 2.0 * np.pi / shape[2]
    begin = (
        int(np.floor((start[1] - corner[1]) / cell_m)),
        int(np.floor((start[0] - corner[0]) / cell_m)),
        int(np.floor(start[2] / turn)) % shape[2],
    )
    seen[begin] = True
    stack = [begin]
    n = 0
    while stack:
        i, j, k = stack.pop()
        n += 1
        if n > max_cells:
            return -1
        x, y, yaw = corner[0] + (j + 0.5) * cell_m, corner[1] + (i + 0.5) * cell_m, (k + 0.5) * turn
        c, s = np.cos(yaw), np.sin(yaw)
        row = int(np.floor((y + s * lidar[0] + c * lidar[1] - corner[1]) / cell_m))
        column = int(np.floor((x + c * lidar[0] - s * lidar[1] - corner[0]) / cell_m))
        if not (0 <= row < shape[0] and 0 <= column < shape[1]) or out[row, column]:
            return 1
        for axis in range(3):
            for step in (-1, 1):
                ni, nj, nk = i, j, k
                if axis == 0:
                    ni += step
                elif axis == 1:
                    nj += step
                else:
                    nk = (k + step) % shape[2]
                if not (0 <= ni < shape[0] and 0 <= nj < shape[1]):
                    return 1
                if seen[ni, nj, nk]:
                    continue
                seen[ni, nj, nk] = True
                there = corner[0] + (nj + 0.5) * cell_m, corner[1] + (ni + 0.5) * cell_m
                if separation(walls, outline, there[0], there[1], (nk + 0.5) * turn, 0.0) > 0.0:
                    stack.append((ni, nj, nk))
    return 0


@compiled
def separation(walls: WallIndex, outline: Outline, x: float, y: float, yaw: float, least_m: float) -> float:
    """Return a distance in m that the outline of a car with its rear axle at this pose keeps from every wall segment.

    The largest gap between the shadows of outline and segment on the normals of both: 0 or less exactly where they
    meet, the distance but where a corner is nearest to a segment's end, and there up to the square root of 2 too short.
    It never exceeds `walls.reach_m`; below `least_m` the first gap that is found is returned.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    column = int(np.floor((x + c * outline.centre_x - s * outline.centre_y - walls.x) / walls.bucket_m))
    row = int(np.floor((y + s * outline.centre_x + c * outline.centre_y - walls.y) / walls.bucket_m))
    nearest = walls.reach_m
    if not (0 <= column < walls.nx and 0 <= row < walls.ny):
        return nearest
    bucket = row * walls.nx + column
    n_sides = len(outline.offsets)
    for i in range(walls.first[bucket], walls.first[bucket + 1]):
        segment = walls.segments[walls.entries[i]]
        px, py, qx, qy = segment[0] - x, segment[1] - y, segment[2] - x, segment[3] - y
        ax, ay, bx, by = c * px + s * py, c * py - s * px, c * qx + s * qy, c * qy - s * qx
        gap = -np.inf
        for k in range(n_sides):
            nx, ny = outline.normals[k, 0], outline.normals[k, 1]
            gap = max(gap, min(nx * ax + ny * ay, nx * bx + ny * by) - outline.offsets[k])
            if gap >= nearest:
                break
        if gap >= nearest:
            continue
        tx, ty = bx - ax, by - ay
        length = np.sqrt(tx * tx + ty * ty)
        if length > 0.0:
            low, high = np.inf, -np.inf
            for k in range(n_sides):
                across = (tx * (outline.corners[k, 1] - ay) - ty * (outline.corners[k, 0] - ax)) / length
                low, high = min(low, across), max(high, across)
            gap = max(gap, low, -high)
        if gap < nearest:
            nearest = gap
            if nearest < least_m:
                return nearest
    return nearest


@compiled
def _point_is_free(walls: WallIndex, x: float, y: float, radius_m: float) -> bool:
    column, row = int(np.floor((x - walls.x) / walls.bucket_m)), int(np.floor((y - walls.y) / walls.bucket_m))
    if not (0 <= column < walls.nx and 0 <= row < walls.ny):
        return True
    bucket = row * walls.nx + column
    for i in range(walls.first[bucket], walls.first[bucket + 1]):
        segment = walls.segments[walls.entries[i]]
        tx, ty, px, py = segment[2] - segment[0], segment[3] - segment[1], x - segment[0], y - segment[1]
        along = min(1.0, max(0.0, (tx * px + ty * py) / max(tx * tx + ty * ty, 1e-18)))
        if (px - along * tx) ** 2 + (py - along * ty) ** 2 < radius_m * radius_m:
            return False
    return True


@compiled
def _along(x: float, y: float, yaw: float, curvature: float, length: float) -> tuple[float, float, float]:
    turn = curvature * length
    chord = length if turn == 0.0 else length * np.sin(turn / 2.0) / (turn / 2.0)
    return x + chord * np.cos(yaw + turn / 2.0), y + chord * np.sin(yaw + turn / 2.0), yaw + turn


@compiled
def _drive(
    walls: WallIndex, outline: Outline, x: float, y: float, yaw: float, gap_m: float, moves: Moves, a: int,
    direction: int, margin_m: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Follow an arc up to its end or to a wall; return how far, what gap is left there, and the nearness on the way.

    A pose must keep a quarter more than the margin, so that half the margin may be swept without a check. Nearness is
    the length weighted with how much of `wide_m` the gap lacks.
    """
    sweep, least = moves.sweeps[a], 1.25 * margin_m
    at, gap, near = 0.0, gap_m, 0.0
    while at < moves.length_m:
        step = min(max(0.5 * margin_m, gap - margin_m) / sweep, moves.length_m - at)
        px, py, pyaw = _along(x, y, yaw, moves.curvatures[a], direction * (at + step))
        after = separation(walls, outline, px, py, pyaw, least)
        if after < least:
            break
        at, gap = at + step, after
        near += step * max(0.0, 1.0 - gap / moves.wide_m)
        if moves.length_m - at < 1e-9:
            return moves.length_m, gap, near
    return at, gap, near


@compiled
def _key(cells: Cells, x: float, y: float, yaw: float, direction: int, gap_m: float) -> int:
    """Return the number of the cell of (x, y, yaw, direction), above 0."""
    fine = 2 if gap_m < cells.tight_m else 1
    column, row = int(np.floor(x / cells.size_m * fine)), int(np.floor(y / cells.size_m * fine))
    n_yaw = cells.n_yaw * fine
    yaw_cell = int(np.floor(yaw / (2.0 * np.pi) * n_yaw)) % n_yaw
    half = 1 << 21
    return ((((row + half) << 22) + column + half) * n_yaw + yaw_cell) * 4 + 2 * fine - (1 if direction > 0 else 2) + 1


@compiled
def _slot(keys: NDArray[np.int64], key: int) -> int:
    """Return the place of a key in the table, or the empty one that waits for it; the table is at most half full."""
    mask = len(keys) - 1
    mixed = (key ^ (key >> 17)) * 40503
    slot = (mixed ^ (mixed >> 13)) & mask
    while keys[slot] != 0 and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@compiled
def _price(moves: Moves, before: int, move: int, direction_before: int, direction: int) -> float:
    price = moves.steering_cost * abs(moves.steering_rad[move] - moves.steering_rad[before])
    return price + moves.reversal_cost if direction * direction_before < 0 else price


@compiled
def _lidar_to_goal(goal: Goal, x: float, y: float, yaw: float) -> float:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.hypot(x + c * goal.lidar_x - s * goal.lidar_y - goal.x, y + s * goal.lidar_x + c * goal.lidar_y - goal.y)


@compiled
def _rest(field: Field, goal: Goal, x: float, y: float) -> float:
    """Estimate what is left: the axle need not come nearer than the lidar stands ahead of it; inf: not worth it."""
    row, column = int(np.floor((y - field.y) / field.cell_m)), int(np.floor((x - field.x) / field.cell_m))
    if not (0 <= row < field.to_goal.shape[0] and 0 <= column < field.to_goal.shape[1]):
        return np.inf
    return max(0.0, field.to_goal[row, column] - goal.radius_m - np.hypot(goal.lidar_x, goal.lidar_y))
