"""The numbers of a car-like robot: all that the rest of the package knows of one."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

STEERING_JOINTS = ("left_steering_hinge_joint", "right_steering_hinge_joint")
WHEEL_JOINTS = (
    "left_rear_wheel_joint",
    "right_rear_wheel_joint",
    "left_front_wheel_joint",
    "right_front_wheel_joint",
)
LIDAR_JOINT = "lidar_mount"
ROLES = (*STEERING_JOINTS, *WHEEL_JOINTS, LIDAR_JOINT)
GRAVITY_MPS2 = 9.81
TYRE_GRIP = 1.0
"""Coefficient of friction between tyres and floor, in every simulator; see `DisturbanceConfig.friction`."""


@dataclass(frozen=True)
class RobotModel:
    """The facts of a car-like robot, in m and rad, base frame (on the floor, x forward, the car symmetric about it).

    Attributes:
        source: what `load_robot` takes to read it again, from any folder: a shipped name, or an absolute path with the
            settings that were given.
        urdf_path: where they were read from.
        wheelbase_m: rear to front axle.
        track_m: left to right rear wheel centre.
        hinge_track_m: left to right steering hinge.
        hinge_offset_m: how far each front wheel's centre stands outside of its hinge, along its axle.
        wheel_radius_m, front_radius_m: of the rear and the front wheels.
        rear_axle_x_m: x of the rear axle in the base frame.
        footprint_base: (K, 2) float64, convex outline of the body, counter-clockwise; a hollow in the body belongs to
            it. Physics takes a mesh as its convex hull too.
        lidar_xyz_base: (3,) float64, position of the lidar.
        lidar_rpy: (3,) float64, its fixed-axis orientation.
        body_top_m, body_bottom_m: heights of the highest and the lowest point of the body.
        knuckle_limit_rad: smallest limit of the two steering hinges.
        rolling_mass_kg: mass of all links, and of the wheels' spin as seen by who pushes the car.
        yaw_inertia_kgm2: moment of inertia of all links about the vertical through the rear axle's centre.
        weight_n: of all links.
        wheel_effort_nm, wheel_speed_radps: smallest torque and speed limit of the four wheel motors.
        hinge_speed_radps: smallest speed limit of the two steering hinges.
        joints: name of each role's joint in the URDF that physics loads.
        plain_urdf: the URDF that physics loads, with `plain_body`, (P, 3) points in m whose hull is the file
            `BODY_FILE` that it names; None: the file itself, which is as physics needs it.
        drawn_urdf: the URDF as it is painted, all meshes by absolute paths.
        drawn_signs: role to joint and sign in `drawn_urdf`: whether the joint turns as its role does (1) or against.
        base_from_root: (4, 4) float64, pose of the URDF's root link in the base frame.
        notes: what was taken otherwise than it is written, a sentence each.
    """

    source: str
    urdf_path: Path
    wheelbase_m: float
    track_m: float
    hinge_track_m: float
    hinge_offset_m: float
    wheel_radius_m: float
    front_radius_m: float
    rear_axle_x_m: float
    footprint_base: NDArray[np.float64]
    lidar_xyz_base: NDArray[np.float64]
    lidar_rpy: NDArray[np.float64]
    body_top_m: float
    body_bottom_m: float
    knuckle_limit_rad: float
    rolling_mass_kg: float
    yaw_inertia_kgm2: float
    weight_n: float
    wheel_effort_nm: float
    wheel_speed_radps: float
    hinge_speed_radps: float
    joints: Mapping[str, str] = field(default_factory=lambda: {role: role for role in ROLES})
    plain_urdf: str | None = None
    plain_body: NDArray[np.float64] | None = None
    drawn_urdf: str = ""
    drawn_signs: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    base_from_root: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    notes: tuple[str, ...] = ()

    @property
    def front_track_m(self) -> float:
        """Left to right front wheel centre, wheels straight."""
        return self.hinge_track_m + 2.0 * self.hinge_offset_m
