"""The car as PyBullet sees it: URDF joints found by name, motors, and the base frame read back."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pybullet
import trimesh

from zebrat_bullet.errors import RobotError, SimulationError
from zebrat_bullet.robot import STEERING_JOINTS, WHEEL_JOINTS, RobotModel
from zebrat_bullet.robot.plain import BODY_FILE
from zebrat_bullet.sim.ackermann import WheelTargets, virtual_steering
from zebrat_bullet.sim.client import PhysicsClient
from zebrat_bullet.types import Pose2, RobotState

# Collision filter groups. Rays and everything by default are in group 1, which the car ignores: a lidar ray never
# stops at its own car. Wheels meet the floor only: steered, they stand out of the footprint that the car watches.
# Two bodies meet when either one's mask has the other's group, so wheels and walls each leave out the other.
GROUP_WALLS, GROUP_BODY, GROUP_FLOOR, GROUP_WHEELS = 2, 4, 8, 16
_NOT_RAYS = ~1


class Car:
    """A car-like URDF in one physics client.

    Attributes:
        body_id: PyBullet's id of the multi-body.
    """

    def __init__(self, client: PhysicsClient, robot: RobotModel) -> None:
        self._client = client
        self._robot = robot
        flags = pybullet.URDF_USE_IMPLICIT_CYLINDER | pybullet.URDF_IGNORE_VISUAL_SHAPES
        with _urdf_file(robot) as file, _pybullet_refuses(robot):
            self.body_id: int = client.loadURDF(str(file), flags=flags)
        infos = {i[1].decode(): i for i in map(self._joint_info, range(client.getNumJoints(self.body_id)))}
        hinges, wheels = ([robot.joints[role] for role in roles] for roles in (STEERING_JOINTS, WHEEL_JOINTS))
        self._hinges = [infos[name][0] for name in hinges]
        self._wheels = [infos[name][0] for name in wheels]
        self._efforts = [infos[name][10] for name in hinges + wheels]
        self._hinge_speed = min(infos[name][11] for name in hinges)
        self._com_base: tuple[float, float, float] = client.getDynamicsInfo(self.body_id, -1)[3]
        self._set_filters_and_damping()
        self._loaded = (1.0, 1.0)
        links = range(-1, client.getNumJoints(self.body_id))
        self._built = {link: client.getDynamicsInfo(self.body_id, link)[:3] for link in links}

    def _joint_info(self, index: int) -> tuple:
        return self._client.getJointInfo(self.body_id, index)

    def _set_filters_and_damping(self) -> None:
        com_rotation = self._client.getDynamicsInfo(self.body_id, -1)[4]
        if not np.allclose(com_rotation, (0, 0, 0, 1), atol=1e-6):
            raise RobotError(f"{self._robot.urdf_path}: give the root link's <inertial> an origin without rpy")
        for link in range(-1, self._client.getNumJoints(self.body_id)):
            filters = (GROUP_WHEELS, GROUP_FLOOR) if link in self._wheels else (GROUP_BODY, _NOT_RAYS)
            self._client.setCollisionFilterGroupMask(self.body_id, link, *filters)
            self._client.changeDynamics(self.body_id, link, linearDamping=0.0, angularDamping=0.0)
            if link not in self._wheels:  # a convex mesh would touch 1 mm outside of itself
                self._client.changeDynamics(self.body_id, link, collisionMargin=0.0)

    def load(self, mass: float, friction: float) -> None:
        """Have the masses of the URDF times a factor, and the grip of its tyres times another, until the next call."""
        if (mass, friction) == self._loaded:
            return
        self._loaded = (mass, friction)
        for link, (own_mass, grip, inertia) in self._built.items():
            # A mass given alone makes Bullet work out the inertia anew, from the shape.
            self._client.changeDynamics(
                self.body_id,
                link,
                mass=mass * own_mass,
                localInertiaDiagonal=[mass * about for about in inertia],
                lateralFriction=friction * grip if link in self._wheels else grip,
            )

    def reset(self, pose: Pose2) -> None:
        """Stand the car still at `pose` with straight wheels, with no contact left from before."""
        for joint in self._hinges + self._wheels:
            self._client.resetJointState(self.body_id, joint, 0.0, 0.0)
        self._place(pose, 1000.0)  # out of reach, so that every cached contact is dropped
        self._client.performCollisionDetection()
        self._place(pose, 0.0)
        self._client.resetBaseVelocity(self.body_id, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def _place(self, pose: Pose2, height_m: float) -> None:
        x, y, z = self._com_base
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        com_world = (pose.x + c * x - s * y, pose.y + s * x + c * y, height_m + z)
        turn = (0.0, 0.0, math.sin(pose.yaw / 2), math.cos(pose.yaw / 2))
        self._client.resetBasePositionAndOrientation(self.body_id, com_world, turn)

    def drive(self, targets: WheelTargets, torque: float = 1.0, hinge_speed: float = 1.0) -> None:
        """Set the motors until the next call, with factors on the wheels' torque and on the hinges' speed."""
        for joint, angle, effort in zip(self._hinges, targets.knuckle_rad, self._efforts, strict=False):
            self._client.setJointMotorControl2(
                self.body_id,
                joint,
                pybullet.POSITION_CONTROL,
                targetPosition=angle,
                force=effort,
                maxVelocity=self._hinge_speed * hinge_speed,
            )
        self._client.setJointMotorControlArray(
            self.body_id,
            self._wheels,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=targets.wheel_radps,
            forces=[torque * effort for effort in self._efforts[2:]],
        )

    def read(self, contact: bool, unseen_contact: bool) -> RobotState:
        """Return the measured state of the base frame and the joints.

        Raises:
            SimulationError: a number is not finite.
        """
        com, (qx, qy, qz, qw) = self._client.getBasePositionAndOrientation(self.body_id)
        linear, angular = self._client.getBaseVelocity(self.body_id)
        joints = [state[0] for state in self._client.getJointStates(self.body_id, self._hinges + self._wheels)]
        if not math.isfinite(sum(com) + qx + qy + qz + qw + sum(linear) + sum(angular) + sum(joints)):
            raise SimulationError(f"the physics lost the car: position {com}, velocity {linear}, joints {joints}")
        # Columns of the rotation matrix: the base's own axes in the world.
        forward = (1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qz * qw), 2 * (qx * qz - qy * qw))
        left = (2 * (qx * qy - qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz + qx * qw))
        up = (2 * (qx * qz + qy * qw), 2 * (qy * qz - qx * qw), 1 - 2 * (qx * qx + qy * qy))
        cx, cy, cz = self._com_base
        x, y, z = (p - f * cx - s * cy - u * cz for p, f, s, u in zip(com, forward, left, up, strict=True))
        # The rear axle's centre stands off the centre of mass: v_axle = v_com + omega x r, of which the forward part.
        speed = _dot(linear, forward) + _dot(angular, left) * (self._robot.wheel_radius_m - cz) + _dot(angular, up) * cy
        return RobotState(
            pose=Pose2(x, y, math.atan2(forward[1], forward[0])),
            height_m=z,
            roll=math.atan2(left[2], up[2]),
            pitch=-math.asin(max(-1.0, min(1.0, forward[2]))),
            speed_mps=speed,
            yaw_rate_radps=angular[2],
            steering_rad=virtual_steering(joints[0], joints[1], self._robot),
            knuckle_rad=np.array(joints[:2]),
            wheel_rad=np.array(joints[2:]),
            contact=contact,
            unseen_contact=unseen_contact,
        )


@contextmanager
def _urdf_file(robot: RobotModel) -> Iterator[Path]:
    """Yield the URDF that PyBullet loads, which reads files only."""
    if robot.plain_urdf is None or robot.plain_body is None:
        yield robot.urdf_path
        return
    with TemporaryDirectory(prefix="zebrat-") as folder:
        file = Path(folder) / "car.urdf"
        file.write_text(robot.plain_urdf, encoding="utf-8")
        (file.parent / BODY_FILE).write_text(
            trimesh.convex.convex_hull(robot.plain_body).export(file_type="obj"), encoding="utf-8"
        )
        yield file


@contextmanager
def _pybullet_refuses(robot: RobotModel) -> Iterator[None]:
    """Turn PyBullet's refusal of a URDF into ours."""
    try:
        yield
    except pybullet.error as error:
        raise RobotError(
            f"{robot.urdf_path}: PyBullet cannot load it ({error}); give meshes as OBJ or STL, or the body a box"
        ) from error


def _dot(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
