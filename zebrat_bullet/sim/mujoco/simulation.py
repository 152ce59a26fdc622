"""The car in MuJoCo."""

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sim.base import CarSimulation, Touch
from zebrat_bullet.sim.mujoco.car import MujocoCar
from zebrat_bullet.sim.mujoco.model import SceneHolder, build_scene
from zebrat_bullet.world.world import World


class MujocoSimulation(CarSimulation):
    """A model of its own with a floor, the car, and the walls of the current world.

    Attributes:
        client: holds the scene, for a ray caster in it.
    """

    client: SceneHolder
    _car: MujocoCar

    def __init__(self, robot: RobotModel, physics: PhysicsConfig) -> None:
        super().__init__(robot, physics)
        self.client = SceneHolder()
        self._build(None)

    def _build(self, world: World | None) -> None:
        self._scene = self.client.scene = build_scene(self._robot, self._physics, world)
        self._car = MujocoCar(self._scene, self._robot, self._physics)
        self._step_physics, self._wall_contacts = self._car.step, self._touching
        self._world = world

    def touches(self) -> list[Touch]:
        """Return what the body touches where it stands now; no time passes."""
        mujoco.mj_kinematics(self._scene.model, self._scene.data)
        mujoco.mj_collision(self._scene.model, self._scene.data)
        return self._touching()

    def _touching(self) -> list[Touch]:
        """Return the world points of the contacts with walls that MuJoCo has found."""
        contact, walls = self._scene.data.contact, self._scene.walls
        geoms = contact.geom
        at_wall = ((geoms >= walls.start) & (geoms < walls.stop)).any(axis=1)
        return [tuple(point) for point in contact.pos[at_wall].tolist()] if at_wall.any() else []

    @contextmanager
    def _undone(self) -> Iterator[None]:
        model, data = self._scene.model, self._scene.data
        saved = copy(data)
        try:
            yield
        finally:
            mujoco.mj_copyData(data, model, saved)

    @staticmethod
    def _touch_points(touches: list[Touch]) -> NDArray[np.float64]:
        return np.array(touches)[:, :2]

    def close(self) -> None:
        """Let go of the model; the simulation is of no use afterwards. May be called twice."""
        self.client.scene = None
