"""What one car's lidar sees: the inner loop, one source for processor and GPU.

Positions are relative to the origin of the car's world in the atlas.
"""

import warp as wp

from zebrat_bullet.planar.kernels.data import OPTIONS, CarData
from zebrat_bullet.planar.kernels.walls import Walls, cell_of

N_RAYS_ABREAST = wp.constant(32)
"""Rays that one thread of `look` casts together."""
WIDER_M = wp.constant(1.0e-6)
"""By so much a segment is seen past its ends, so that no ray slips between two that meet."""


@wp.func
def _blur(true_range: float, car: CarData, channels: wp.array(dtype=float), state: wp.uint32):
    """What is left of a range by noise: the least of as many noisy returns as channels meet the wall at that range."""
    slot = int(true_range / car.reach * float(channels.shape[0]))
    n = channels[wp.min(slot, channels.shape[0] - 1)]
    kept = n
    if car.dropout > 0.0:
        kept = n * (1.0 - car.dropout)
        if wp.randf(state) < wp.pow(car.dropout, n):
            return car.reach
    if car.sigma <= 0.0:
        return true_range
    # The least of n normal draws: the n-th root of a uniform draw is the chance that all n lie above it.
    above = wp.pow(wp.max(wp.randf(state), 1.0e-7), 1.0 / wp.max(kept, 1.0))
    noise = -1.41421356 * car.sigma * wp.erfinv(wp.clamp(2.0 * above - 1.0, -0.9999999, 0.9999999))
    return wp.clamp(true_range + noise, 0.0, car.reach)


@wp.kernel(module="unique", module_options=OPTIONS)
def look(
    car: CarData,
    walls: Walls,
    world: wp.array(dtype=int),
    pose: wp.array(dtype=wp.vec3),
    rays: wp.array(dtype=wp.vec2),  # directions, zeros behind the last
    channels: wp.array(dtype=float),
    draws: wp.array(dtype=int),
    cars: wp.array(dtype=int),
    ranges: wp.array2d(dtype=float),
):
    """Cast some rays of one of these cars: each front that faces the lidar shortens those between its ends."""
    place, block = wp.tid()
    i = cars[place]
    w = world[i]
    at = pose[i]
    c = wp.cos(at[2])
    s = wp.sin(at[2])
    x = at[0] + c * car.lidar_x - s * car.lidar_y
    y = at[1] + s * car.lidar_x + c * car.lidar_y
    c = wp.cos(at[2] + car.lidar_yaw)
    s = wp.sin(at[2] + car.lidar_yaw)
    u = wp.zeros(shape=(N_RAYS_ABREAST,), dtype=float)
    v = wp.zeros(shape=(N_RAYS_ABREAST,), dtype=float)
    closest = wp.zeros(shape=(N_RAYS_ABREAST,), dtype=float)  # one over the range
    for r in range(N_RAYS_ABREAST):
        ray = rays[block * N_RAYS_ABREAST + r]
        u[r] = c * ray[0] - s * ray[1]
        v[r] = s * ray[0] + c * ray[1]
        closest[r] = 1.0 / car.reach
    cell = cell_of(x, y, walls.grid[w], walls.first_cell[w], walls.cells_per_m)
    first = walls.all_first[w]
    last = walls.all_last[w]
    if cell >= 0:
        first = walls.cells[cell][0]
        last = walls.cells[cell + 1][0]
    for j in range(first, last):
        k = j
        if cell >= 0:
            k = walls.near_far[j]
        ends = walls.segments[k]
        ax = ends[0] - x
        ay = ends[1] - y
        bx = ends[2] - x
        by = ends[3] - y
        facing = ax * by - ay * bx
        if facing > 0.0:
            close = 1.0 / facing
            for r in range(N_RAYS_ABREAST):
                past_a = v[r] * ax - u[r] * ay
                before_b = u[r] * by - v[r] * bx
                met = wp.where(wp.min(past_a, before_b) > -WIDER_M, (past_a + before_b) * close, 0.0)
                closest[r] = wp.max(closest[r], met)
    for r in range(N_RAYS_ABREAST):
        ray_i = block * N_RAYS_ABREAST + r
        if ray_i < car.n_rays:
            distance = 1.0 / closest[r]
            if distance >= car.horizon:
                distance = car.reach
            elif car.sigma > 0.0 or car.dropout > 0.0:
                distance = _blur(distance, car, channels, wp.rand_init(draws[i], ray_i))
            ranges[i, ray_i] = distance
