"""The frozen records that flow through the package, one direction only.

Units are SI (m, s, rad). Frames: `_world` is the map; `_base` is the car's body centre projected on the floor,
x forward, y left, z up; `_lidar` is the sensor's own. Yaw, bearings and steering are positive to the left
(counter-clockwise).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.arrays import Array

if TYPE_CHECKING:
    import shapely


class Pose2(NamedTuple):
    """A planar pose in the world frame: x, y in m, yaw in rad."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True, slots=True)
class Command:
    """What a driver asks of the car: rear-axle speed in m/s and virtual centre-wheel angle in rad."""

    speed_mps: float
    steering_rad: float


@dataclass(frozen=True, slots=True)
class Commands:
    """A `Command` for each of N cars: (N,) speeds in m/s and (N,) angles in rad."""

    speed_mps: Array
    steering_rad: Array


@dataclass(frozen=True, slots=True)
class Dynamics:
    """How a car differs from what its URDF says.

    Attributes:
        acceleration: factor on the torque of the wheel motors.
        steering_rate: factor on the speed of the steering hinges.
        steering_offset_rad: added to the steering of every command.
        speed: factor on the speed of every command.
        delay_s: time until a command reaches the motors.
        friction: factor on the grip of the tyres.
        mass: factor on mass and inertia of every part.
        steering_lag_s: time constant with which the steering follows its command.
    """

    acceleration: float = 1.0
    steering_rate: float = 1.0
    steering_offset_rad: float = 0.0
    speed: float = 1.0
    delay_s: float = 0.0
    friction: float = 1.0
    mass: float = 1.0
    steering_lag_s: float = 0.0


@dataclass(frozen=True, slots=True)
class RobotState:
    """The measured state of the car after a control step.

    Attributes:
        pose: base frame in the world (body centre on the floor).
        height_m: height of the base frame above the floor; about 0.
        roll, pitch: tilt of the body in rad (pitch positive nose down, as in ROS).
        speed_mps: signed forward speed of the rear-axle centre.
        yaw_rate_radps: turning speed about the vertical.
        steering_rad: virtual centre-wheel angle the two knuckles stand at.
        knuckle_rad: (2,) float64, left and right steering hinge angles.
        wheel_rad: (4,) float64, rolling angles of rear-left, rear-right, front-left, front-right wheel.
        contact: the body has touched a wall or obstacle since the control step began.
        unseen_contact: that contact was with a low obstacle in the lidar's blind zone.
    """

    pose: Pose2
    height_m: float
    roll: float
    pitch: float
    speed_mps: float
    yaw_rate_radps: float
    steering_rad: float
    knuckle_rad: NDArray[np.float64]
    wheel_rad: NDArray[np.float64]
    contact: bool
    unseen_contact: bool


@dataclass(frozen=True, slots=True)
class PointCloud:
    """One revolution of the lidar.

    Attributes:
        points_lidar: (N, 3) float32, m, lidar frame; channel-major (all bearings of the lowest channel first). A ray
            without a return has its point at the maximum range.
        valid: (N,) bool, False where the ray had no return.
        rotation_level: (3, 3) float64, turns lidar-frame vectors into the gravity-levelled frame at the lidar (x along
            the car's heading).
        height_m: height of the sensor above the floor.
    """

    points_lidar: NDArray[np.float32]
    valid: NDArray[np.bool_]
    rotation_level: NDArray[np.float64]
    height_m: float


@dataclass(frozen=True, slots=True)
class FlatScan:
    """A 2D scan, as ROS LaserScan: `ranges_m[i]` at bearing `-pi + i * 2 pi / n`; so back, right, ahead, left.

    Attributes:
        ranges_m: (n,) float32, nearest horizontal range in each bearing; `range_max_m` where nothing was seen, nan in
            a bearing that was not cast (`LidarConfig.bearings`).
        range_max_m: the lidar's reach.
    """

    ranges_m: NDArray[np.float32]
    range_max_m: float


@dataclass(frozen=True, slots=True)
class Clearance:
    """What a scan representation makes of a scan.

    Attributes:
        obs_m: (R,) float32, V_obs: range seen along each of the R bearings (paper: R = 32).
        range_m: (R,) float32, V_range: range at which that bearing leaves the car's outline.
        collision: any obs_m <= range_m (paper, Algorithm 1).
    """

    obs_m: NDArray[np.float32]
    range_m: NDArray[np.float32]
    collision: bool


@dataclass(frozen=True, slots=True)
class Clearances:
    """The `Clearance` of N cars with one outline: `obs_m` (N, R), `range_m` (R,), `collision` (N,)."""

    obs_m: Array
    range_m: Array
    collision: Array


@dataclass(frozen=True, slots=True)
class Waypoint:
    """The next waypoint as seen from the car.

    Attributes:
        distance_m: from the origin of the base frame.
        bearing_rad: its direction in the base frame, in [-pi, pi]: the yaw difference of the paper.
    """

    distance_m: float
    bearing_rad: float


@dataclass(frozen=True, slots=True)
class Reading:
    """All an agent may know at a control step; the last four only if it declares the privilege, None otherwise.

    Its arrays cannot be written to, from then on: region, world and record are made of the same. Compute on a copy.

    Attributes:
        scan: the flattened lidar scan.
        clearance: the safety region's view of it.
        last_command: the command given before this reading; zero at the start.
        speed_mps: measured forward speed.
        time_s: simulated time since the episode began.
        state: the true state, but for the error of the task's localisation (privilege "pose").
        walls: the outlines of everything the body can hit, world frame (privilege "map").
        goal_world: (2,) float64, the last waypoint of the world, 1 m past the open-space line (privilege "goal").
        waypoint: the next waypoint of the world (privilege "waypoint").
    """

    scan: FlatScan
    clearance: Clearance
    last_command: Command
    speed_mps: float
    time_s: float
    state: RobotState | None = None
    walls: "shapely.MultiPolygon | None" = None
    goal_world: NDArray[np.float64] | None = None
    waypoint: Waypoint | None = None

    def __post_init__(self) -> None:
        arrays: list[Array] = [self.scan.ranges_m, self.clearance.obs_m, self.clearance.range_m]
        if self.state is not None:
            arrays += [self.state.knuckle_rad, self.state.wheel_rad]
        if self.goal_world is not None:
            arrays.append(self.goal_world)
        for array in arrays:
            array.setflags(write=False)
