"""One private PyBullet physics server in this process, without a window."""

import weakref
from collections.abc import Callable
from functools import partial
from typing import Any

import pybullet

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import SimulationError
from zebrat_bullet.robot import GRAVITY_MPS2


class PhysicsClient:
    """PyBullet's functions, each bound to this client: `client.stepSimulation()` steps this physics and no other.

    PyBullet's own BulletClient does the same, but makes it write to stdout, which belongs to the commands' results.

    Attributes:
        id: PyBullet's physicsClientId.
        close: frees the server; calling it again does nothing.
    """

    def __init__(self) -> None:
        self.id: int = pybullet.connect(pybullet.DIRECT)
        if self.id < 0:
            raise SimulationError("PyBullet gives no more clients (it has 1024 in a process); close() those not in use")
        self.close = weakref.finalize(self, pybullet.disconnect, physicsClientId=self.id)
        self.close.atexit = False

    def __getattr__(self, name: str) -> Callable[..., Any]:
        bound = partial(getattr(pybullet, name), physicsClientId=self.id)
        self.__dict__[name] = bound  # found there from now on, without coming here
        return bound


def clear(client: PhysicsClient, physics: PhysicsConfig) -> None:
    """Remove every body of a client, and set every parameter that matters, none left to a default."""
    client.resetSimulation()
    client.setGravity(0.0, 0.0, -GRAVITY_MPS2)
    client.setPhysicsEngineParameter(
        fixedTimeStep=1.0 / physics.rate_hz,
        numSolverIterations=physics.solver_iterations,
        contactBreakingThreshold=physics.contact_breaking_m,
        numSubSteps=0,
        deterministicOverlappingPairs=1,
    )
