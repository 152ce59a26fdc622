"""The car as MuJoCo sees it: joints found by name, motors, and the base frame read back."""

import math

import mujoco
import numpy as np

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import SimulationError
from zebrat_bullet.robot import STEERING_JOINTS, WHEEL_JOINTS, RobotModel
from zebrat_bullet.sim.ackermann import WheelTargets, virtual_steering
from zebrat_bullet.sim.mujoco.model import Scene, n_steps
from zebrat_bullet.types import Pose2, RobotState

_KNUCKLE_SHARE = 0.1
"""Share of its error that a knuckle closes in a physics step, the servo of PyBullet's car."""
_SPRING, _DAMPER = 0.25, 0.5
"""Of a hinge's servo, as shares of what its inertia can bear in one step."""


_AS_MASS = ("body_mass", "body_inertia", "body_subtreemass", "dof_M0")
_AS_INVERSE = ("body_invweight0", "dof_invweight0")
"""What of a model grows with the mass of every part, and with its inverse."""


class MujocoCar:
    """The car of a scene."""

    def __init__(self, scene: Scene, robot: RobotModel, physics: PhysicsConfig) -> None:
        model = scene.model
        self._model, self._data, self._robot = model, scene.data, robot
        hinges, wheels = (
            [model.joint(robot.joints[role]) for role in roles] for roles in (STEERING_JOINTS, WHEEL_JOINTS)
        )
        self._hinge_at = [int(joint.qposadr[0]) for joint in hinges]
        self._hinge_dof = [int(joint.dofadr[0]) for joint in hinges]
        self._wheel_at = [int(joint.qposadr[0]) for joint in wheels]
        step_s = float(model.opt.timestep)
        self._n_steps, self._share_per_s = n_steps(physics), _KNUCKLE_SHARE * physics.rate_hz
        self._hinge_speed = robot.hinge_speed_radps
        self._efforts = model.actuator_forcerange.copy()
        # A gear's rotor is heavier than the knuckle that it turns: full torque brings it to speed in one physics step.
        model.dof_armature[self._hinge_dof] = self._efforts[:2, 1] / (robot.hinge_speed_radps * physics.rate_hz)
        inertia = model.dof_M0[self._hinge_dof] + model.dof_armature[self._hinge_dof]
        spring, damper = _SPRING * inertia / step_s**2, _DAMPER * inertia / step_s
        model.actuator_gainprm[:2, 0] = spring
        model.actuator_biasprm[:2, 1] = -spring
        model.actuator_biasprm[:2, 2] = -damper
        # With its share of the car's mass, a wheel comes to its speed within a physics step while its torque lasts.
        radii = np.array([robot.wheel_radius_m] * 2 + [robot.front_radius_m] * 2)
        stiffness = robot.rolling_mass_kg / 4.0 * radii**2 * physics.rate_hz
        model.actuator_gainprm[2:, 0] = stiffness
        model.actuator_biasprm[2:, 2] = -stiffness
        self._targets, self._turn = (0.0, 0.0), 0.0
        self._grips = np.flatnonzero(model.geom_priority == 1)  # the wheels
        self._grip = model.geom_friction[self._grips, 0].copy()
        self._masses = {name: getattr(model, name).copy() for name in (*_AS_MASS, *_AS_INVERSE)}

    def load(self, mass: float, friction: float) -> None:
        """Have the masses of the URDF times a factor, and the grip of its tyres times another, until the next call."""
        for name, built in self._masses.items():
            getattr(self._model, name)[:] = built * mass if name in _AS_MASS else built / mass
        self._model.geom_friction[self._grips, 0] = friction * self._grip

    def reset(self, pose: Pose2) -> None:
        """Stand the car still at `pose` with straight wheels, with no contact left from before."""
        mujoco.mj_resetData(self._model, self._data)
        half = pose.yaw / 2.0
        self._data.qpos[:7] = (pose.x, pose.y, 0.0, math.cos(half), 0.0, 0.0, math.sin(half))
        mujoco.mj_forward(self._model, self._data)

    def drive(self, targets: WheelTargets, torque: float = 1.0, hinge_speed: float = 1.0) -> None:
        """Set the motors until the next call, with factors on the wheels' torque and on the hinges' speed."""
        self._targets, self._turn = targets.knuckle_rad, self._hinge_speed * hinge_speed
        self._data.ctrl[2:] = targets.wheel_radps
        self._model.actuator_forcerange[2:] = torque * self._efforts[2:]

    def step(self) -> None:
        """Let a physics step of the task pass, in which the hinges' aims move at one speed towards their targets."""
        data, turn = self._data, self._turn
        for side in (0, 1):
            speed = self._share_per_s * (self._targets[side] - data.act[side])
            data.ctrl[side] = min(max(speed, -turn), turn)
        mujoco.mj_step(self._model, data, self._n_steps)

    def read(self, contact: bool, unseen_contact: bool) -> RobotState:
        """Return the measured state of the base frame and the joints.

        Raises:
            SimulationError: a number is not finite.
        """
        position, velocity = self._data.qpos, self._data.qvel
        # MuJoCo itself begins anew where a number is not finite, and only counts it as a warning.
        lost = int(sum(self._data.warning[kind].number for kind in _BAD))
        if lost or not math.isfinite(float(position.sum() + velocity.sum())):
            raise SimulationError(f"the physics lost the car: position {position[:3]}, velocity {velocity[:3]}")
        x, y, z, w, i, j, k = position[:7].tolist()
        forward = (1 - 2 * (j * j + k * k), 2 * (i * j + k * w), 2 * (i * k - j * w))
        left_z, up_z = 2 * (j * k + i * w), 1 - 2 * (i * i + j * j)
        vx, vy, vz, roll_rate, pitch_rate, yaw_rate = velocity[:6].tolist()  # linear in the world, angular in the base
        # The rear axle's centre stands wheel_radius above the base: v_axle = v + omega x r, of which the forward part.
        speed = vx * forward[0] + vy * forward[1] + vz * forward[2] + pitch_rate * self._robot.wheel_radius_m
        knuckles = position[self._hinge_at].copy()
        return RobotState(
            pose=Pose2(x, y, math.atan2(forward[1], forward[0])),
            height_m=z,
            roll=math.atan2(left_z, up_z),
            pitch=-math.asin(max(-1.0, min(1.0, forward[2]))),
            speed_mps=speed,
            yaw_rate_radps=forward[2] * roll_rate + left_z * pitch_rate + up_z * yaw_rate,
            steering_rad=virtual_steering(float(knuckles[0]), float(knuckles[1]), self._robot),
            knuckle_rad=knuckles,
            wheel_rad=position[self._wheel_at].copy(),
            contact=contact,
            unseen_contact=unseen_contact,
        )


_BAD = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)
