"""Worlds of axis-parallel boxes, and cars that stand in them, for tests that work their numbers out by hand."""

import numpy as np
import shapely
import trimesh

from zebrat_bullet.types import Pose2, RobotState
from zebrat_bullet.world.world import Mesh, Start, World

Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""((x from, x to), (y from, y to), (z from, z to)) in m, world frame."""


def box_world(*boxes: Box) -> World:
    """Return a world whose only walls are these boxes."""
    meshes = [trimesh.creation.box(bounds=np.array(box).T) for box in boxes]
    mesh = trimesh.util.concatenate(meshes) if meshes else trimesh.Trimesh()
    return World(
        name="boxes",
        description="made by a test",
        mesh=Mesh(np.array(mesh.vertices, float).reshape(-1, 3), np.array(mesh.faces, np.int32).reshape(-1, 3)),
        walls=shapely.MultiPolygon([shapely.box(x[0], y[0], x[1], y[1]) for x, y, _ in boxes]),
        low_obstacles=shapely.MultiPolygon(),
        free_space=shapely.box(-10.0, -10.0, 10.0, 10.0),
        centre_line=np.zeros((0, 2)),
        widths_m=np.zeros(0),
        start=Start(Pose2(0.0, 0.0, 0.0)),
        waypoints=np.zeros((0, 2)),
        open_line=None,
    )


def standing(x: float = 0.0, y: float = 0.0, yaw: float = 0.0, *, roll: float = 0.0, pitch: float = 0.0) -> RobotState:
    """Return the state of a car at rest."""
    still = {"speed_mps": 0.0, "yaw_rate_radps": 0.0, "steering_rad": 0.0}
    joints = {"knuckle_rad": np.zeros(2), "wheel_rad": np.zeros(4)}
    tilt = {"height_m": 0.0, "roll": roll, "pitch": pitch}
    return RobotState(pose=Pose2(x, y, yaw), contact=False, unseen_contact=False, **tilt, **still, **joints)
