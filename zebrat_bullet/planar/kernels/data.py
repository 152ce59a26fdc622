"""What the kernels share: the car's numbers, and how they are compiled; all is float32."""

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
