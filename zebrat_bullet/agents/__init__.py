"""Drivers behind one protocol, and the way to get one by name or file."""

from pathlib import Path

from zebrat_bullet.agents.agent import PRIVILEGES, Agent, NoisyAgent, RandomAgent
from zebrat_bullet.agents.policy import load_policy
from zebrat_bullet.assets import list_assets
from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import AssetError

__all__ = ["PRIVILEGES", "Agent", "load_agent"]


def load_agent(name_or_path: str, limits: PhysicsConfig, noise_sigma: float = 0.0) -> Agent:
    """Return an agent by name ("random", "shipped", ...), by policy file, or by training run folder (its best policy).

    Args:
        name_or_path: which agent.
        limits: the command limits of the task it will drive in.
        noise_sigma: Gaussian noise on its commands, as a fraction of the limits.

    Raises:
        AssetError: there is no such agent; the message lists those there are.
        PolicyError: the file is not a policy of this package.
    """
    agent = _load(name_or_path, limits)
    if noise_sigma == 0.0:
        return agent
    return NoisyAgent(agent, noise_sigma, limits.max_speed_mps, limits.max_steering_rad)


def _load(name_or_path: str, limits: PhysicsConfig) -> Agent:
    if name_or_path == "random":
        return RandomAgent(limits.max_speed_mps, limits.max_steering_rad)
    if (Path(name_or_path) / "best.safetensors").is_file():
        return load_policy(str(Path(name_or_path) / "best.safetensors"))
    try:
        return load_policy(name_or_path)
    except AssetError as error:
        known = ", ".join(["random", *list_assets("policies", ".safetensors")])
        raise AssetError(
            f"no agent {name_or_path!r}: name one of {known}, a .safetensors policy, or a training run folder"
        ) from error
