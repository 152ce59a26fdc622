"""The walls as kernels know them: the cells of an `Atlas`, and how far an outline is from them."""

import warp as wp

from zebrat_bullet.planar.kernels.data import CarData


@wp.struct
class Walls:
    """The arrays of an `Atlas`."""

    segments: wp.array(dtype=wp.vec4)
    grid: wp.array(dtype=wp.vec4)
    first_cell: wp.array(dtype=int)
    cells: wp.array(dtype=wp.vec2i)
    near_far: wp.array(dtype=int)
    all_first: wp.array(dtype=int)
    all_last: wp.array(dtype=int)
    cells_per_m: float


@wp.func
def cell_of(x: float, y: float, grid: wp.vec4, first: int, per_m: float):
    """Index of the cell that holds a point, -1 outside of the grid."""
    column = int(wp.floor((x - grid[0]) * per_m))
    row = int(wp.floor((y - grid[1]) * per_m))
    if column < 0 or row < 0 or column >= int(grid[2]) or row >= int(grid[3]):
        return -1
    return first + row * int(grid[2]) + column


@wp.func
def _separation(
    a: wp.vec2, b: wp.vec2, corners: wp.array(dtype=wp.vec2), sides: wp.array(dtype=wp.vec3), n: int, bound: float
):
    """Greatest gap in m along the normals of outline and segment: at most their distance, below 0 where they touch."""
    gap = float(-1.0e9)
    for k in range(n):
        side = sides[k]
        gap = wp.max(gap, wp.min(side[0] * a[0] + side[1] * a[1], side[0] * b[0] + side[1] * b[1]) - side[2])
    if gap >= bound:
        return gap
    normal = wp.normalize(wp.vec2(a[1] - b[1], b[0] - a[0]))
    at = wp.dot(normal, a)
    low = float(1.0e9)
    high = float(-1.0e9)
    for k in range(n):
        reach = wp.dot(normal, corners[k])
        low = wp.min(low, reach)
        high = wp.max(high, reach)
    return wp.max(gap, wp.max(low - at, at - high))


@wp.func
def clearance(
    walls: Walls,
    world: int,
    middle: wp.vec2,
    c: float,
    s: float,
    car: CarData,
    corners: wp.array(dtype=wp.vec2),
    sides: wp.array(dtype=wp.vec3),
):
    """How far in m the outline may move before it can touch a wall; below 0 where it does."""
    cell = cell_of(middle[0], middle[1], walls.grid[world], walls.first_cell[world], walls.cells_per_m)
    first = walls.all_first[world]
    last = walls.all_last[world]
    if cell >= 0:
        first = walls.cells[cell][0]
        last = first + walls.cells[cell][1]
    gap = car.near
    for i in range(first, last):
        k = i
        if cell >= 0:
            k = walls.near_far[i]
        ends = walls.segments[k]
        ax = ends[0] - middle[0]
        ay = ends[1] - middle[1]
        bx = ends[2] - middle[0]
        by = ends[3] - middle[1]
        a = wp.vec2(c * ax + s * ay, c * ay - s * ax)
        b = wp.vec2(c * bx + s * by, c * by - s * bx)
        gap = wp.min(gap, _separation(a, b, corners, sides, car.n_corners, gap))
    return gap
