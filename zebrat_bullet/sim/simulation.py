"""The car in PyBullet."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import pybullet
from numpy.typing import NDArray

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import WorldError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sim.base import CarSimulation, Touch
from zebrat_bullet.sim.car import GROUP_FLOOR, GROUP_WALLS, GROUP_WHEELS, Car
from zebrat_bullet.sim.client import PhysicsClient, clear
from zebrat_bullet.world.world import Mesh, World

_NO_BODY = -1
_ANY_LINK = -2


class Simulation(CarSimulation):
    """A physics client of its own with a floor, the car, and the walls of the current world.

    Attributes:
        client, client_id: PyBullet's physicsClientId, for a ray caster on the same client.
        car_id, floor_id, walls_id: body ids; `walls_id` is -1 while there are no walls.
    """

    def __init__(self, robot: RobotModel, physics: PhysicsConfig) -> None:
        super().__init__(robot, physics)
        self._client = PhysicsClient()
        self.client = self.client_id = self._client.id
        self._mesh_lists = _MeshLists()
        self._build(None)

    def _build(self, world: World | None) -> None:
        """Make everything anew: PyBullet frees the memory of a removed body's mesh only when all is cleared."""
        clear(self._client, self._physics)
        self.floor_id = self._static_body(pybullet.GEOM_PLANE, GROUP_FLOOR, -1)
        self._car = Car(self._client, self._robot)
        self.car_id = self._car.body_id
        self.walls_id = _NO_BODY if world is None or not len(world.mesh.faces) else self._walls_body(world)
        self._step_physics = self._client.stepSimulation
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

    def touches(self) -> list[Touch]:
        """Return what the body touches where it stands now; no time passes."""
        self._client.performCollisionDetection()
        return list(self._wall_contacts())

    @contextmanager
    def _undone(self) -> Iterator[None]:
        saved = self._client.saveState()
        try:
            yield
        finally:
            self._client.restoreState(saved)
            self._client.removeState(saved)

    @staticmethod
    def _touch_points(touches: list[Touch]) -> NDArray[np.float64]:
        return np.array([touch[6][:2] for touch in touches])

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
