"""What drives the car: anything with `reset` and `act`. Planners, people and learned policies look alike here."""

from typing import Protocol

import numpy as np

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.types import Command, Reading

MOST_NOISE = 100.0
PRIVILEGES = frozenset({"pose", "map", "goal", "waypoint"})
"""What an agent may be given beyond the lidar: `Reading.state`, `walls`, `goal_world` and `waypoint`."""


class Agent(Protocol):
    """A driver.

    Attributes:
        name: what tables call it.
        privileged: those of `PRIVILEGES` that it needs; printed in every table. Empty for an unguided agent.
    """

    name: str
    privileged: frozenset[str]

    def reset(self, seed: int) -> None:
        """Forget the last episode; `seed` fixes whatever chance the agent uses in the next."""

    def act(self, reading: Reading) -> Command:
        """Return the command for this reading."""


class RandomAgent:
    """Uniformly random commands: the floor of every comparison."""

    name = "random"
    privileged: frozenset[str] = frozenset()

    def __init__(self, max_speed_mps: float, max_steering_rad: float) -> None:
        self._limits = np.array([max_speed_mps, max_steering_rad])

    def reset(self, seed: int) -> None:
        """Seed the commands of the next episode."""
        self._rng = np.random.default_rng(seed)

    def act(self, reading: Reading) -> Command:
        """Return a random command."""
        speed, steering = self._rng.uniform(-self._limits, self._limits)
        return Command(float(speed), float(steering))


class SmoothRandomAgent:
    """Random commands that drift, an Ornstein-Uhlenbeck process of unit variance, so that the car gets somewhere."""

    name = "random-smooth"
    privileged: frozenset[str] = frozenset()
    _KEPT = 0.9  # from one command to the next: they forget in about ten

    def __init__(self, max_speed_mps: float, max_steering_rad: float) -> None:
        self._limits = np.array([max_speed_mps, max_steering_rad])

    def reset(self, seed: int) -> None:
        """Seed the commands of the next episode."""
        self._rng = np.random.default_rng(seed)
        self._drift = self._rng.standard_normal(2)

    def act(self, reading: Reading) -> Command:
        """Return a command near the last one; about a third of them are at the limits."""
        fresh = np.sqrt(1.0 - self._KEPT**2) * self._rng.standard_normal(2)
        self._drift = self._KEPT * self._drift + fresh
        speed, steering = np.clip(self._drift, -1.0, 1.0) * self._limits
        return Command(float(speed), float(steering))


class NoisyAgent:
    """Another agent with Gaussian noise on its commands, as during training (sigma as a fraction of the limits).

    Raises:
        ConfigError: sigma is not 0 to 100.
    """

    def __init__(self, agent: Agent, sigma: float, max_speed_mps: float, max_steering_rad: float) -> None:
        if not 0.0 <= sigma <= MOST_NOISE:
            raise ConfigError(f"action_noise must be 0 to {MOST_NOISE:g}, got {sigma}")
        self.name = f"{agent.name}+noise{sigma:.12g}"
        self.privileged, self.digest = agent.privileged, getattr(agent, "digest", "")
        self._agent, self._sigma = agent, sigma
        self._limits = np.array([max_speed_mps, max_steering_rad])

    def reset(self, seed: int) -> None:
        """Reset the agent and seed the noise."""
        self._agent.reset(seed)
        self._rng = np.random.default_rng(seed)

    def act(self, reading: Reading) -> Command:
        """Return the agent's command, disturbed and clipped to the limits."""
        command = self._agent.act(reading)
        disturbed = self._rng.normal((command.speed_mps, command.steering_rad), self._sigma * self._limits)
        speed, steering = np.clip(disturbed, -self._limits, self._limits)
        return Command(float(speed), float(steering))
