"""Another agent driven with a person's hands: late, unsteady at the wheel, gentle on the pedal."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from zebrat_bullet.agents.agent import Agent
from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.types import Command, Reading


@dataclass(frozen=True, kw_only=True)
class HumanNoise:
    """How a person's commands differ from those of a program.

    Attributes:
        delay_steps: control steps from seeing to acting; one step of 0.2 s is a quick reaction.
        steering_sigma_rad: standard deviation of the steering error.
        steering_time_s: correlation time of that error, an Ornstein-Uhlenbeck process: hands drift, they do not shake.
        speed_change_mps: the most the commanded speed changes in a control step.
    """

    delay_steps: int = 1
    steering_sigma_rad: float = 0.05
    steering_time_s: float = 1.0
    speed_change_mps: float = 0.3

    def __post_init__(self) -> None:
        if self.delay_steps < 0:
            raise ConfigError(f"delay_steps must be at least 0, got {self.delay_steps}")
        if self.steering_sigma_rad < 0:
            raise ConfigError(f"steering_sigma_rad must be at least 0, got {self.steering_sigma_rad}")
        if self.steering_time_s <= 0 or self.speed_change_mps <= 0:
            raise ConfigError("steering_time_s and speed_change_mps must be above 0")


class HumanLikeAgent:
    """Drives as `agent` would, through a person's delay and unsteadiness; seeded.

    Args:
        agent: what decides; it still sees every reading as it comes.
        limits: the command limits and the control step of the task.
        noise: how human.
    """

    def __init__(self, agent: Agent, limits: PhysicsConfig, noise: HumanNoise | None = None) -> None:
        self.name = f"{agent.name}+human"
        self.privileged, self.digest = agent.privileged, getattr(agent, "digest", "")
        self._agent, self._limits, self._noise = agent, limits, noise or HumanNoise()
        self._decay = math.exp(-limits.control_step_s / self._noise.steering_time_s)

    def reset(self, seed: int) -> None:
        """Reset the agent; `seed` fixes the steering error, which begins at a typical size."""
        self._agent.reset(seed)
        self._rng = np.random.default_rng(seed)
        self._error = self._rng.normal(0.0, self._noise.steering_sigma_rad)
        self._decided = deque([Command(0.0, 0.0)] * self._noise.delay_steps)

    def act(self, reading: Reading) -> Command:
        """Return what the agent decided `delay_steps` ago, as a person's hands and foot carry it out."""
        self._decided.append(self._agent.act(reading))
        wanted = self._decided.popleft()
        # Exact step of the Ornstein-Uhlenbeck process: its variance stays steering_sigma_rad squared.
        spread = self._noise.steering_sigma_rad * math.sqrt(1.0 - self._decay**2)
        self._error = self._decay * self._error + self._rng.normal(0.0, spread)
        change = wanted.speed_mps - reading.last_command.speed_mps
        limited = max(-self._noise.speed_change_mps, min(self._noise.speed_change_mps, change))
        limit = self._limits.max_steering_rad
        steering = max(-limit, min(limit, wanted.steering_rad + self._error))
        return Command(reading.last_command.speed_mps + limited, steering)
