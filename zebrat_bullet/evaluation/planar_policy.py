"""Planar cars that observe what a trained policy observes."""

from collections.abc import Sequence
from dataclasses import asdict, replace

from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import ObservationConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.world import World


def cars_for(policy: PolicyAgent, task: TaskConfig, worlds: Sequence[World], n_cars: int, seed: int = 0) -> PlanarDrive:
    """Return planar cars under a task, whose observation gives way to the policy's.

    Raises:
        ConfigError: the policy observes what this car does not; the message names what differs.
    """
    seen = policy.observation
    observation = ObservationConfig(
        log_gaps=bool(seen.gap_ranges_m),
        last_command=seen.last_command,
        waypoint=seen.waypoint,
        trail_steps=seen.trail_steps,
    )
    drive = PlanarDrive(replace(task, observation=observation), worlds, n_cars, raw=seen.raw, seed=seed)
    its, ours = asdict(seen), asdict(drive.spec)
    if differing := [f"{name} {its[name]} for {ours[name]}" for name in ours if its[name] != ours[name]]:
        raise ConfigError(
            f"policy {policy.name!r} observes something else than this car: {', '.join(differing)}; use the robot and "
            "the senses that it was trained with"
        )
    return drive
