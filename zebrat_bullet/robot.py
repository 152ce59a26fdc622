"""What a car-like URDF says of itself, read with yourdfpy; the only source of the robot's numbers."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RobotModel:
    """The facts of a car-like robot, in m and rad, base frame (body centre on the floor, x forward).

    Attributes:
        urdf_path: where they were read from.
        wheelbase_m: rear to front axle.
        track_m: left to right wheel centre.
        wheel_radius_m: of all four wheels.
        rear_axle_x_m: x of the rear axle in the base frame (negative).
        footprint_base: (K, 2) float64, convex outline of the body's collision shape, counter-clockwise.
        lidar_xyz_base: (3,) float64, position of the lidar.
        lidar_rpy: (3,) float64, its fixed-axis orientation.
        body_top_m: height of the highest collision shape.
        knuckle_limit_rad: smallest limit of the two steering hinges.
    """

    urdf_path: Path
    wheelbase_m: float
    track_m: float
    wheel_radius_m: float
    rear_axle_x_m: float
    footprint_base: NDArray[np.float64]
    lidar_xyz_base: NDArray[np.float64]
    lidar_rpy: NDArray[np.float64]
    body_top_m: float
    knuckle_limit_rad: float
