"""Which engine simulates: one setting chooses, and each is loaded only when it is asked for."""

from importlib.util import find_spec

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sim.base import CarSimulation


def require_engine(name: str) -> None:
    """Make sure that an engine is installed.

    Raises:
        ConfigError: it is not.
    """
    if name == "mujoco" and find_spec("mujoco") is None:
        raise ConfigError(
            "the engine MuJoCo is not installed; pip install 'zebrat-bullet[mujoco]', or drive in PyBullet"
        )


def make_simulation(robot: RobotModel, physics: PhysicsConfig) -> CarSimulation:
    """Return a simulation of a car in the engine that its physics names.

    Raises:
        ConfigError: the engine is not installed.
        RobotError: the engine does not take the car.
    """
    require_engine(physics.engine)
    if physics.engine == "mujoco":
        from zebrat_bullet.sim.mujoco.simulation import MujocoSimulation

        return MujocoSimulation(robot, physics)
    from zebrat_bullet.sim.simulation import Simulation

    return Simulation(robot, physics)
