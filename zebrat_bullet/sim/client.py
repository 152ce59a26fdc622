"""One private PyBullet physics server in this process, without a window."""

import pybullet
from pybullet_utils.bullet_client import BulletClient

from zebrat_bullet.config import PhysicsConfig

GRAVITY_MPS2 = -9.81


def open_client(physics: PhysicsConfig) -> BulletClient:
    """Return a new DIRECT client whose every parameter that matters is set.

    The contact breaking threshold is global to the process and survives a reset, so it is never left to chance.
    """
    client = BulletClient(connection_mode=pybullet.DIRECT)
    client.setGravity(0.0, 0.0, GRAVITY_MPS2)
    client.setPhysicsEngineParameter(
        fixedTimeStep=1.0 / physics.rate_hz,
        numSolverIterations=physics.solver_iterations,
        contactBreakingThreshold=physics.contact_breaking_m,
        numSubSteps=0,
        deterministicOverlappingPairs=1,
    )
    return client
