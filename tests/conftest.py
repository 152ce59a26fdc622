"""What many tests start from."""

from collections.abc import Callable, Iterator

import pytest

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.sim.simulation import Simulation


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
