"""What many tests start from."""

import signal
from collections.abc import Callable, Iterator

import pytest

from zebrat_bullet.config import LidarConfig, PhysicsConfig
from zebrat_bullet.detection.check import CollisionChecker
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.sim.simulation import Simulation

# What a script starts in the background ignores SIGINT, and so would all that tests start and end by it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # the same of what nohup starts
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    return load_robot("zebrat")


@pytest.fixture
def simulate(robot: RobotModel) -> Iterator[Callable[..., Simulation]]:
    """Makes simulations, `simulate(robot=..., **physics settings)`, and closes them after the test."""
    made: list[Simulation] = []

    def make(robot: RobotModel = robot, **physics: float) -> Simulation:
        made.append(Simulation(robot, PhysicsConfig(**physics)))
        return made[-1]

    yield make
    for simulation in made:
        simulation.close()


@pytest.fixture(scope="session")
def checkers() -> Iterator[dict[str, CollisionChecker]]:
    """Static checkers of ZebraT by their ray caster."""
    made = {caster: CollisionChecker(lidar=LidarConfig(caster=caster)) for caster in ("embree", "bullet")}
    yield made
    for checker in made.values():
        checker.close()
