"""What the kernels share: the car's numbers, the arrays of the walls, and how they are compiled; all is float32."""

import warp as wp

OPTIONS = {
    "enable_backward": False,
    "fast_math": True,
    "max_unroll": 6,
    "cpu_compiler_flags": f"{wp.config.cpu_compiler_flags} -ffast-math -ffp-contract=fast -Wno-nan-infinity-disabled",
}
"""Of every kernel. `max_unroll` leaves the loops over cars and rays to the compiler, which makes SIMD of them."""


@wp.struct
class CarData:
    """The numbers of the car and its senses, alike for all cars; m, rad, s, kg."""

    dt: float
    n_substeps: int
    wheelbase: float
    half_track: float  # of the rear wheels
    half_hinges: float  # of the steering hinges
    beside: float  # front wheels outside of their hinges
    top: float  # ground speed of the fastest wheel
    axle_x: float
    farthest: float  # corner of the outline from the rear axle's centre
    n_corners: int
    inverse_mass: float
    inverse_inertia: float
    motor_impulse: float  # of one wheel, in a physics step, N s
    grip_impulse: float  # of one front wheel
    hinge_step: float  # most that a knuckle turns in a physics step
    near: float  # a cell's list of near segments holds all that are closer to the outline than this
    lidar_x: float
    lidar_y: float
    lidar_yaw: float
    reach: float
    horizon: float  # farthest wall that the lidar returns
    n_rays: int
    sigma: float
    dropout: float


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
