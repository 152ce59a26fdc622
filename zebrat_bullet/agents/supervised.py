"""Any driver under the supervisor of the real car, which stops it before it touches something."""

from dataclasses import dataclass

from zebrat_bullet.agents.agent import Agent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.deploy.car import car_of
from zebrat_bullet.deploy.supervisor import Supervisor
from zebrat_bullet.robot import fitted, load_robot
from zebrat_bullet.types import Command, Reading


@dataclass(frozen=True, slots=True)
class Refused:
    """A command that was not let through.

    Attributes:
        step: the control step of the episode, from 0.
        command: what the driver wanted.
        reason: why the car stopped instead.
    """

    step: int
    command: Command
    reason: str


class SupervisedAgent:
    """Another agent whose commands go through a supervisor.

    The supervisor is given the scan and the measured speed of the reading; where the steering stands it works out from
    the commands. The agent sees in `Reading.last_command` what the car was told.

    Args:
        agent: what decides.
        supervisor: what lets its commands through or not.

    Attributes:
        refused: the commands of this episode that were not let through.
    """

    def __init__(self, agent: Agent, supervisor: Supervisor) -> None:
        self.name = f"{agent.name}+supervised"
        self.privileged, self.digest = agent.privileged, getattr(agent, "digest", "")
        self.supervisor = supervisor
        self.refused: list[Refused] = []
        self._agent = agent

    def reset(self, seed: int) -> None:
        """Reset the agent and the supervisor, and forget what was refused."""
        self._agent.reset(seed)
        self.supervisor.reset()
        self.refused = []
        self._n_steps = 0

    def act(self, reading: Reading) -> Command:
        """Return the agent's command, or a stop."""
        command = self._agent.act(reading)
        decision = self.supervisor.check(command, reading.scan, reading.speed_mps, None)
        if decision.refusal:
            self.refused.append(Refused(self._n_steps, command, decision.refusal))
        self._n_steps += 1
        return decision.command


def supervised(agent: Agent, task: TaskConfig, margin_m: float) -> SupervisedAgent:
    """Return an agent under a supervisor that knows the car of a task.

    Raises:
        AssetError, RobotError: there is no such car.
        ConfigError: the margin is not finite or below 0.
    """
    task = fitted(task)
    car = car_of(load_robot(task.robot), task.physics)
    return SupervisedAgent(agent, Supervisor(car, task.physics.control_step_s, margin_m))
