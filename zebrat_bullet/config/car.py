"""Settings of the car: physics, and how it differs from its URDF and is disturbed."""

import math
from dataclasses import dataclass

from zebrat_bullet.config.checks import Range, of_their_kinds, require, within
from zebrat_bullet.files import shown

ENGINES = ("bullet", "mujoco")
FOOTPRINTS = ("auto", "collision", "hull")
"""What may count as the outline of a car's body, see `robot.setup`."""


@dataclass(frozen=True, kw_only=True)
class PhysicsConfig:
    """How the physics is stepped.

    Attributes:
        engine: "bullet" (PyBullet), or "mujoco", the second judge, which cuts each physics step into steps of at most
            `sim.mujoco.model.TIMESTEP_S` and takes neither solver iterations nor contact breaking.
        control_step_s: time between two commands (paper: 0.2 s).
        rate_hz: physics steps a second; a control step must hold a whole number of them.
        solver_iterations: constraint solver iterations; 20 leave a speed error of 0.3 %.
        contact_breaking_m: distance at which a contact is dropped; Bullet's 0.02 keeps stale wheel contacts, whose cost
            is 100 us a physics step against 40.
        max_speed_mps, max_steering_rad: limits of a command; commands beyond them are clipped.
    """

    engine: str = "bullet"
    control_step_s: float = 0.2
    rate_hz: float = 120.0
    solver_iterations: int = 20
    contact_breaking_m: float = 1e-5
    max_speed_mps: float = 0.6
    max_steering_rad: float = 0.6

    def __post_init__(self) -> None:
        of_their_kinds(self)
        require(self.engine in ENGINES, f"engine must be one of {', '.join(ENGINES)}, got {shown(self.engine)!r}")
        require(self.control_step_s > 0 and self.rate_hz > 0, "control_step_s and rate_hz must be above 0")
        within(self, control_step_s=(0.001, 10.0), rate_hz=(0.1, 10_000.0), solver_iterations=(-math.inf, 1000))
        n = self.control_step_s * self.rate_hz
        require(
            abs(n - round(n)) < 1e-6 and round(n) >= 1,
            f"control_step_s {self.control_step_s} holds {n:g} physics steps at {self.rate_hz} Hz; "
            "choose a rate that gives a whole number",
        )
        require(self.solver_iterations >= 1, f"solver_iterations must be at least 1, got {self.solver_iterations}")
        require(self.max_speed_mps > 0, f"max_speed_mps must be above 0, got {self.max_speed_mps}")
        require(
            0 < self.max_steering_rad < math.pi / 2,
            f"max_steering_rad must be in (0, pi/2), got {self.max_steering_rad}",
        )
        within(self, contact_breaking_m=(0.0, 1.0), max_speed_mps=(0.0, 100.0))

    @property
    def n_substeps(self) -> int:
        """Physics steps in a control step."""
        return self.steps_in(self.control_step_s)

    def steps_in(self, time_s: float) -> int:
        """Return the nearest number of physics steps in a time."""
        return round(time_s * self.rate_hz)


@dataclass(frozen=True, kw_only=True)
class DynamicsConfig:
    """How the car differs from what its URDF says, drawn anew for each episode; nothing by default.

    Attributes:
        acceleration: factor on the torque of the wheel motors.
        steering_rate: factor on the speed of the steering hinges.
        steering_offset_rad: added to the steering of every command.
        speed: factor on the speed of every command.
        delay_s: time until a command reaches the motors, two control steps at most (planar cars: one); until then those
            before it hold.
    """

    acceleration: Range = (1.0, 1.0)
    steering_rate: Range = (1.0, 1.0)
    steering_offset_rad: Range = (0.0, 0.0)
    speed: Range = (1.0, 1.0)
    delay_s: Range = (0.0, 0.0)

    def __post_init__(self) -> None:
        of_their_kinds(self)
        for name, (least, most) in vars(self).items():
            require(least <= most, f"dynamics.{name} must be [least, greatest], got [{least}, {most}]")
            if name != "steering_offset_rad":
                require(least >= 0, f"dynamics.{name} must be at least 0, got {least}")
        for name in ("acceleration", "steering_rate"):
            require(getattr(self, name)[0] > 0, f"dynamics.{name} must be above 0, got {getattr(self, name)[0]}")
        within(self, **dict.fromkeys(vars(self), (-1000.0, 1000.0)))

    @property
    def fixed(self) -> bool:
        """Whether every car is as its URDF says."""
        return self == DynamicsConfig()


RANDOM_DYNAMICS = DynamicsConfig(
    acceleration=(0.7, 1.3),
    steering_rate=(0.7, 1.3),
    steering_offset_rad=(-0.02, 0.02),
    speed=(0.9, 1.05),
    delay_s=(0.0, 0.05),
)
"""Cars as they come: what a policy for a real one should bear."""


@dataclass(frozen=True, kw_only=True)
class DisturbanceConfig:
    """What else disturbs an episode in PyBullet and MuJoCo, drawn anew for each from its seed; nothing by default.

    What concerns the lidar comes on top of `NoiseConfig`. Planar cars know none of this, and refuse it.

    Attributes:
        friction: factor on the grip of the tyres (ZebraT's on its floor: 1.0).
        mass: factor on mass and inertia of every part.
        steering_lag_s: time constant with which the steering follows its command, as a first-order lag.
        command_noise: sigma on what a command comes to at the motors, drawn for each, as a fraction of the limits; the
            driver does not learn of it.
        range_sigma_m: Gaussian range noise along each ray.
        dropout: probability that a return is lost.
        dark_walls: share of the walls' length that gives no return at any time of an episode, as dark or glassy
            walls do.
        mount_offset_m: error of the mount, level, in a direction drawn too.
        mount_yaw_rad: error of the mount's yaw.
        pose_sigma_m, pose_sigma_rad: of the errors of a localisation in x, in y and in yaw, for those that are given
            the pose; each drifts, as an Ornstein-Uhlenbeck process.
        pose_drift_s: time in which it does.
    """

    friction: Range = (1.0, 1.0)
    mass: Range = (1.0, 1.0)
    steering_lag_s: Range = (0.0, 0.0)
    command_noise: Range = (0.0, 0.0)
    range_sigma_m: Range = (0.0, 0.0)
    dropout: Range = (0.0, 0.0)
    dark_walls: Range = (0.0, 0.0)
    mount_offset_m: Range = (0.0, 0.0)
    mount_yaw_rad: Range = (0.0, 0.0)
    pose_sigma_m: float = 0.0
    pose_sigma_rad: float = 0.0
    pose_drift_s: float = 10.0

    def __post_init__(self) -> None:
        of_their_kinds(self, range_or_number=True)
        for name, (least, most) in _DISTURBANCES.items():
            drawn = getattr(self, name)
            low, high = drawn if isinstance(drawn, tuple) else (drawn, drawn)
            require(low <= high, f"disturbance.{name} must be [least, greatest], got [{low}, {high}]")
            got = f"[{low}, {high}]" if isinstance(drawn, tuple) else drawn
            ok = least <= low and high <= most
            require(ok, f"disturbance.{name} must be within {least:g} to {most:g}, got {got}")


_DISTURBANCES = {
    "friction": (0.01, 10.0),
    "mass": (0.1, 10.0),
    "steering_lag_s": (0.0, 10.0),
    "command_noise": (0.0, 10.0),
    "range_sigma_m": (0.0, 100.0),
    "dropout": (0.0, 1.0),
    "dark_walls": (0.0, 1.0),
    "mount_offset_m": (0.0, 1.0),
    "mount_yaw_rad": (-math.pi, math.pi),
    "pose_sigma_m": (0.0, 100.0),
    "pose_sigma_rad": (0.0, math.pi),
    "pose_drift_s": (0.001, 1e6),
}
"""Least and greatest value of each."""
