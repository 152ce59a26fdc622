"""What agents are called in figures and tables."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

SIMS = {"bullet": "PyBullet", "mujoco": "MuJoCo", "planar": "planar"}
"""Simulators, by what `--sim` calls them."""


def agent_labels(agents: Iterable[str]) -> dict[str, str]:
    """Return a label of each agent: of a path its last part, or all of it where two agents would be called alike."""
    short = {agent: Path(agent).stem if "/" in agent and ":" not in agent else agent for agent in agents}
    n_called = Counter(short.values())
    return {agent: label if n_called[label] == 1 else agent for agent, label in short.items()}
