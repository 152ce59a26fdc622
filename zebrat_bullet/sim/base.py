"""What the simulations of both engines have in common: from a command to the motors, and to the measured state."""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from itertools import chain
from typing import Any, Protocol

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import SimulationError
from zebrat_bullet.robot import RobotModel, within_limits
from zebrat_bullet.sim.ackermann import WheelTargets, clip_command, wheel_targets
from zebrat_bullet.types import Command, Dynamics, Pose2, RobotState
from zebrat_bullet.world.world import World

AS_BUILT = Dynamics()
"""The car as its URDF says."""
Touch = tuple[Any, ...]
"""A contact point as the engine gives it."""

_BRAKED_S = 1.0
"""In this time a car stands, whatever it did before, with a command that comes late too."""
_STANDS_MPS = 0.005
_LOW_TOUCH_M = 0.01  # contacts lie on the wall's face, a little inside or outside of its outline


class EngineCar(Protocol):
    """The car in one engine."""

    def load(self, mass: float, friction: float) -> None:
        """Have the masses of the URDF times a factor, and the grip of its tyres times another, until the next call."""

    def reset(self, pose: Pose2) -> None:
        """Stand it still at `pose` with straight wheels, with no contact left from before."""

    def drive(self, targets: WheelTargets, torque: float = 1.0, hinge_speed: float = 1.0) -> None:
        """Set the motors until the next call, with factors on the wheels' torque and on the hinges' speed."""

    def read(self, contact: bool, unseen_contact: bool) -> RobotState:
        """Return the measured state; raises SimulationError where a number is not finite."""


class CarSimulation(ABC):
    """The physics of one car in one world, stepped a command at a time.

    Attributes:
        client: what the engine's own ray caster casts in.
    """

    client: Any
    _car: EngineCar
    _step_physics: Callable[[], object]
    """Lets one physics step pass."""
    _wall_contacts: Callable[[], list[Touch]]
    """Returns where the car's body touched walls in the last physics step."""

    def __init__(self, robot: RobotModel, physics: PhysicsConfig) -> None:
        self._robot = robot
        self._physics = within_limits(physics, robot)
        self._world: World | None = None
        self._asked, self._steering_rad = Command(0.0, 0.0), 0.0

    @abstractmethod
    def _build(self, world: World | None) -> None:
        """Make floor, car and the walls of a world anew, and remember the world."""

    @abstractmethod
    def touches(self) -> list[Touch]:
        """Return what the body touches where it stands now; no time passes."""

    @abstractmethod
    def close(self) -> None:
        """Free what the engine holds; the simulation is of no use afterwards. May be called twice."""

    @staticmethod
    @abstractmethod
    def _touch_points(touches: list[Touch]) -> NDArray[np.float64]:
        """Return the (N, 2) world points of contacts."""

    def set_world(self, world: World) -> None:
        """Put the walls of `world` in place of those before; `reset` comes next. The same object again costs nothing.

        Raises:
            WorldError: the engine does not take its mesh.
        """
        if world is not self._world:
            self._build(world)

    def reset(self, pose: Pose2, dynamics: Dynamics = AS_BUILT) -> RobotState:
        """Stand the car at `pose`, at rest, wheels straight; what happened before leaves no trace.

        Args:
            pose: where.
            dynamics: how the car differs from its URDF until the next reset.

        Raises:
            SimulationError: the pose is not finite.
        """
        if not math.isfinite(pose.x + pose.y + pose.yaw):
            raise SimulationError(f"a start pose must be finite, got {pose}")
        self._dynamics = dynamics
        self._n_late = self._physics.steps_in(dynamics.delay_s)
        self._late, self._n_driven = deque[tuple[int, Command]](), 0
        self._car.load(dynamics.mass, dynamics.friction)
        self._car.reset(pose)
        self._steering_rad = 0.0
        self._obey(Command(0.0, 0.0))
        return self._car.read(contact=False, unseen_contact=False)

    def step(self, command: Command) -> RobotState:
        """Drive one control step; the command is clipped to the limits.

        Raises:
            ActionError: the command is not finite; nothing was simulated.
            SimulationError: the physics produced a number that is not finite.
        """
        return self.read(list(chain.from_iterable(self.substeps(command))))

    def substeps(self, command: Command) -> Iterator[list[Touch]]:
        """Drive one control step, a physics step at a time; yields what the body touches after each.

        A car that obeys late obeys the commands of earlier steps first.

        Raises:
            ActionError: the command is not finite; nothing was simulated.
        """
        self._late.append((self._n_driven + self._n_late, clip_command(command, self._physics)))
        step_physics, contacts = self._step_physics, self._wall_contacts
        for i in range(self._physics.n_substeps + 1):
            if self._late and self._late[0][0] <= self._n_driven:
                self._obey(self._late.popleft()[1])
            if i == self._physics.n_substeps:
                return
            if self._dynamics.steering_lag_s > 0.0:
                self._follow()
            step_physics()
            self._n_driven += 1
            yield contacts()

    def would_touch(self, command: Command) -> bool:
        """Return whether the body would touch a wall during a control step of a command and the braking after it.

        All is as before afterwards, to the last bit.

        Raises:
            ActionError: the command is not finite.
        """
        obeyed = self._asked, self._steering_rad, self._n_driven, self._late.copy()
        with self._undone():
            touched = any(map(bool, self._drive_and_brake(command)))
        self._asked, self._steering_rad, self._n_driven, self._late = obeyed
        self._drive()  # motors are no part of the physics
        return touched

    def _drive_and_brake(self, command: Command) -> Iterator[list[Touch]]:
        """Drive a control step and brake until the car stands; yields what the body touches after each physics step."""
        yield from self.substeps(command)
        for _ in range(math.ceil(_BRAKED_S / self._physics.control_step_s)):
            yield from self.substeps(Command(0.0, command.steering_rad))
            if not self._late and abs(self.read([]).speed_mps) < _STANDS_MPS:
                return

    @abstractmethod
    def _undone(self) -> AbstractContextManager[None]:
        """Have the physics as it is now again afterwards, to the last bit."""

    def _obey(self, command: Command) -> None:
        """Set the motors to what the car makes of a command; a steering that lags sets out for it."""
        dynamics, most = self._dynamics, self._physics.max_steering_rad
        steering = max(-most, min(most, command.steering_rad + dynamics.steering_offset_rad))
        self._asked = Command(command.speed_mps * dynamics.speed, steering)
        if dynamics.steering_lag_s == 0.0:
            self._steering_rad = steering
        self._drive()

    def _follow(self) -> None:
        """Bring a lagging steering nearer to what is asked of it, by what a physics step does."""
        kept = math.exp(-1.0 / (self._physics.rate_hz * self._dynamics.steering_lag_s))
        self._steering_rad = self._asked.steering_rad + kept * (self._steering_rad - self._asked.steering_rad)
        self._drive()

    def _drive(self) -> None:
        targets = wheel_targets(Command(self._asked.speed_mps, self._steering_rad), self._robot)
        self._car.drive(targets, self._dynamics.acceleration, self._dynamics.steering_rate)

    def read(self, touches: list[Touch]) -> RobotState:
        """Return the state now; `touches` are those since the control step began.

        Raises:
            SimulationError: the physics produced a number that is not finite.
        """
        return self._car.read(bool(touches), self._touches_low_obstacle(touches))

    def _touches_low_obstacle(self, touches: list[Touch]) -> bool:
        if not touches or self._world is None or self._world.low_obstacles.is_empty:
            return False
        points = shapely.points(self._touch_points(touches))
        return bool((shapely.distance(points, self._world.low_obstacles) < _LOW_TOUCH_M).any())
