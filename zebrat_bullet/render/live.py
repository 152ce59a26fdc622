"""Frames of a drive that goes on now, and the cloud as the lidar would see it from any pose."""

from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import LidarConfig
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.render.frame import Frame
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sensing.beams import beam_directions
from zebrat_bullet.sensing.casters import RayCaster
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Pose2, Reading


def cast_cloud(caster: RayCaster, config: LidarConfig, robot: RobotModel, pose: Pose2) -> NDArray[np.float64]:
    """Return the (N, 3) returns in m, world frame, of one noise-free sweep of a level car at `pose`."""
    rotation = rotation_from_rpy(0.0, 0.0, pose.yaw)
    origin = rotation @ robot.lidar_xyz_base + (pose.x, pose.y, 0.0)
    rotation = rotation @ rotation_from_rpy(*robot.lidar_rpy)
    ranges = caster.cast(origin, rotation)
    returned = ranges < config.range_max_m
    return origin + ranges[returned, None] * (beam_directions(config)[returned] @ rotation.T)


def region_outline(robot: RobotModel, margin_m: float) -> NDArray[np.float64]:
    """Return the (K, 2) outline of the safety region in m, base frame: the footprint with a margin on every side."""
    outline = shapely.Polygon(robot.footprint_base).buffer(margin_m, join_style="mitre")
    return np.asarray(outline.exterior.coords)[:-1]


def live_frame(
    drive: Drive,
    reading: Reading,
    path: Sequence[Pose2] = (),
    terms: Mapping[str, float] | None = None,
    status: str = "",
) -> Frame:
    """Return the frame of a drive as it stands; it casts no noise, so drawing never changes an episode.

    Args:
        drive: the running task.
        reading: its last reading.
        path: poses driven so far.
        terms: weighted reward terms of the last step.
        status: outcome of the episode once it has ended.
    """
    state = drive.state
    return Frame(
        pose=state.pose,
        knuckle_rad=state.knuckle_rad,
        wheel_rad=state.wheel_rad,
        cloud_world=cast_cloud(drive.lidar.caster, drive.config.lidar, drive.robot, state.pose),
        scan=reading.scan,
        clearance=reading.clearance,
        region_base=region_outline(drive.robot, drive.config.region.margin_m),
        path_world=np.array([(pose.x, pose.y) for pose in path]).reshape(-1, 2),
        speed_mps=state.speed_mps,
        steering_rad=state.steering_rad,
        time_s=reading.time_s,
        terms=terms or {},
        title=drive.world.name,
        status=status,
    )
