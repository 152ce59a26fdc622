"""What disturbs an episode in an engine: drawn once an episode, or as it goes on, from the episode's own seed alone."""

import math
from dataclasses import replace

import numpy as np

from zebrat_bullet.config import DisturbanceConfig, NoiseConfig, PhysicsConfig, Range, TaskConfig
from zebrat_bullet.sensing.dark_walls import DarkWalls
from zebrat_bullet.sim.ackermann import clip_command
from zebrat_bullet.task.dynamics import draw_one
from zebrat_bullet.types import Command, Dynamics, Pose2, RobotState


class Disturbances:
    """The disturbances of one episode; each draws from a generator of its own, so that none shifts another.

    Args:
        task: what is disturbed, and within which ranges.
        dynamics_rng: draws `TaskConfig.dynamics`.
        rng: draws `TaskConfig.disturbance`.

    Attributes:
        dynamics: how the car differs from its URDF.
        noise: of the lidar, what was drawn on top of the task's.
        dark_walls: which walls give no return; None where all do.
    """

    def __init__(self, task: TaskConfig, dynamics_rng: np.random.Generator, rng: np.random.Generator) -> None:
        config, self._physics = task.disturbance, task.physics
        drawn_rng, dark_rng, self._command_rng, pose_rng = rng.spawn(4)
        drawn = _Drawn(config, drawn_rng)
        self.dynamics: Dynamics = replace(
            draw_one(task.dynamics, dynamics_rng),
            friction=drawn.friction,
            mass=drawn.mass,
            steering_lag_s=drawn.steering_lag_s,
        )
        self.noise = drawn.on_top_of(task.noise)
        self.dark_walls = DarkWalls(drawn.dark_walls, dark_rng) if drawn.dark_walls > 0.0 else None
        self._command_sigma = drawn.command_noise
        self._localisation = _Localisation(config, task.physics, pose_rng)

    def at_motors(self, command: Command) -> Command:
        """Return what a command comes to at the motors, within the limits."""
        if self._command_sigma == 0.0:
            return command
        most = np.array([self._physics.max_speed_mps, self._physics.max_steering_rad])
        asked = np.array([command.speed_mps, command.steering_rad])
        speed, steering = asked + self._command_sigma * most * self._command_rng.standard_normal(2)
        return clip_command(Command(float(speed), float(steering)), self._physics)

    def localised(self, state: RobotState) -> RobotState:
        """Return a state as the car's localisation knows it: called once a reading, for the error drifts."""
        return self._localisation.of(state)


class _Drawn:
    """The numbers of `DisturbanceConfig` for one episode, by its names."""

    def __init__(self, config: DisturbanceConfig, rng: np.random.Generator) -> None:
        def draw(between: Range) -> float:
            return float(rng.uniform(*between))

        # New ones go to the end: in this order they are drawn.
        self.friction = draw(config.friction)
        self.mass = draw(config.mass)
        self.steering_lag_s = draw(config.steering_lag_s)
        self.command_noise = draw(config.command_noise)
        self.range_sigma_m = draw(config.range_sigma_m)
        self.dropout = draw(config.dropout)
        self.dark_walls = draw(config.dark_walls)
        self.mount_offset_m = draw(config.mount_offset_m)
        self.mount_yaw_rad = draw(config.mount_yaw_rad)
        self._direction_rad = draw((-math.pi, math.pi))

    def on_top_of(self, noise: NoiseConfig) -> NoiseConfig:
        """Return the noise of the lidar, the task's own and what was drawn; independent causes add up as such do."""
        x, y, z = noise.mount_xyz_m
        offset, direction = self.mount_offset_m, self._direction_rad
        return NoiseConfig(
            range_sigma_m=math.hypot(noise.range_sigma_m, self.range_sigma_m),
            dropout=noise.dropout + (1.0 - noise.dropout) * self.dropout,
            mount_xyz_m=(x + offset * math.cos(direction), y + offset * math.sin(direction), z),
            mount_yaw_rad=noise.mount_yaw_rad + self.mount_yaw_rad,
        )


class _Localisation:
    """A pose whose errors in x, y and yaw drift: three Ornstein-Uhlenbeck processes, stationary from the start."""

    def __init__(self, config: DisturbanceConfig, physics: PhysicsConfig, rng: np.random.Generator) -> None:
        self._sigma = np.array([config.pose_sigma_m, config.pose_sigma_m, config.pose_sigma_rad])
        self._kept = math.exp(-physics.control_step_s / config.pose_drift_s)
        self._rng = rng
        self._error = rng.standard_normal(3)  # in sigmas

    def of(self, state: RobotState) -> RobotState:
        if not self._sigma.any():
            return state
        x, y, yaw = (self._sigma * self._error).tolist()
        fresh = math.sqrt(1.0 - self._kept**2) * self._rng.standard_normal(3)
        self._error = self._kept * self._error + fresh
        pose = state.pose
        return replace(state, pose=Pose2(pose.x + x, pose.y + y, pose.yaw + yaw))
