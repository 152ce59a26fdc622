"""The physics of one car in one world, stepped a command at a time."""

import math
from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
import pybullet
import shapely

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import SimulationError, WorldError
from zebrat_bullet.robot import RobotModel, within_limits
from zebrat_bullet.sim.ackermann import clip_command, wheel_targets
from zebrat_bullet.sim.car import GROUP_FLOOR, GROUP_WALLS, GROUP_WHEELS, Car
from zebrat_bullet.sim.client import PhysicsClient, clear
from zebrat_bullet.types import Command, Dynamics, Pose2, RobotState
from zebrat_bullet.world.world import Mesh, World

_NO_BODY = -1
_ANY_LINK = -2
AS_BUILT = Dynamics()
"""The car as its URDF says."""
Touch = tuple[Any, ...]
"""A contact point as PyBullet's getContactPoints gives it."""

_BRAKED_S = 1.0
"""In this time a car stands, whatever it did before, with a command that comes late too."""
_LOW_TOUCH_M = 0.01  # contacts lie on the wall's face, a little inside or outside of its outline


class Simulation:
    """A physics client of its own with a floor, the car, and the walls of the current world.

    Attributes:
        client_id: PyBullet's physicsClientId, for a ray caster on the same client.
        car_id, floor_id, walls_id: body ids; `walls_id` is -1 while there are no walls.
    """

    def __init__(self, robot: RobotModel, physics: PhysicsConfig) -> None:
        self._robot = robot
        self._physics = within_limits(physics, robot)
        self._client = PhysicsClient()
        self.client_id = self._client.id
        self._mesh_lists = _MeshLists()
        self._world: World | None = None
        self._asked = Command(0.0, 0.0)
        self._build(None)

    def _build(self, world: World | None) -> None:
        """Make everything anew: PyBullet frees the memory of a removed body's mesh only when all is cleared."""
        clear(self._client, self._physics)
        self.floor_id = self._static_body(pybullet.GEOM_PLANE, GROUP_FLOOR, -1)
        self._car = Car(self._client, self._robot)
        self.car_id = self._car.body_id
        self.walls_id = _NO_BODY if world is None or not len(world.mesh.faces) else self._walls_body(world)
        self._wall_contacts = self._contacts_with(self.walls_id)
        self._world = world

    def _contacts_with(self, body_id: int) -> Callable[[], list[Touch]]:
        """Return what asks PyBullet for the car's contacts with a body; there are none with no body."""
        if body_id == _NO_BODY:
            return list
        # All arguments by their place: with keywords a call takes a third longer.
        return partial(pybullet.getContactPoints, self.car_id, body_id, _ANY_LINK, _ANY_LINK, self.client_id)

    def _static_body(self, shape_type: int, group: int, mask: int, **shape: object) -> int:
        shape_id = self._client.createCollisionShape(shape_type, **shape)
        body_id = self._client.createMultiBody(0.0, shape_id)
        self._client.setCollisionFilterGroupMask(body_id, -1, group, mask)
        # Without the margin of 1 mm, contact begins where the footprint meets the outlines of the walls.
        self._client.changeDynamics(body_id, -1, lateralFriction=1.0, collisionMargin=0.0)
        return body_id

    def set_world(self, world: World) -> None:
        """Put the walls of `world` in place of those before; `reset` comes next. The same object again costs nothing.

        Raises:
            WorldError: the mesh is too big for PyBullet.
        """
        if world is not self._world:
            self._build(world)

    def _walls_body(self, world: World) -> int:
        vertices, indices = self._mesh_lists.fill(world.mesh)
        try:
            return self._static_body(
                pybullet.GEOM_MESH,
                GROUP_WALLS,
                ~GROUP_WHEELS,
                vertices=vertices,
                indices=indices,
                flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
            )
        except pybullet.error as error:
            raise WorldError(
                f"{world.name}: PyBullet refuses a mesh of {len(world.mesh.vertices)} vertices and "
                f"{len(world.mesh.faces)} faces; it takes 131072 and 174762, so simplify the mesh"
            ) from error

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

    def touches(self) -> list[Touch]:
        """Return what the body touches where it stands now; no time passes."""
        self._client.performCollisionDetection()
        return list(self._wall_contacts())

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
        step_physics, contacts = self._client.stepSimulation, self._wall_contacts
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
        saved = self._client.saveState()
        stop = Command(0.0, command.steering_rad)
        n_braking = math.ceil(_BRAKED_S / self._physics.control_step_s)
        steps = (self.substeps(each) for each in (command, *[stop] * n_braking))
        try:
            return any(map(bool, chain.from_iterable(steps)))
        finally:
            self._client.restoreState(saved)
            self._client.removeState(saved)
            self._asked, self._steering_rad, self._n_driven, self._late = obeyed
            self._drive()  # a state holds no motors

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
        points_world = np.array([touch[6][:2] for touch in touches])
        return bool((shapely.distance(shapely.points(points_world), self._world.low_obstacles) < _LOW_TOUCH_M).any())

    def close(self) -> None:
        """Free the physics client; the simulation is of no use afterwards. May be called twice."""
        self._client.close()


class _MeshLists:
    """The lists that createCollisionShape takes, filled anew each time: it never gives back its references to them."""

    def __init__(self) -> None:
        self._rows: list[list[float]] = []
        self._vertices: list[list[float]] = []
        self._indices: list[int] = []

    def fill(self, mesh: Mesh) -> tuple[list[list[float]], list[int]]:
        """Return the vertices in m and the triangles' vertex indices; valid until the next call."""
        n = len(mesh.vertices)
        self._rows += [[] for _ in range(n - len(self._rows))]
        for row, vertex in zip(self._rows, mesh.vertices.tolist(), strict=False):
            row[:] = vertex
        self._vertices[:] = self._rows[:n]
        self._indices[:] = mesh.faces.ravel().tolist()
        return self._vertices, self._indices
