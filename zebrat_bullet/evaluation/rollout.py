"""Drives one episode with any agent and records it; the same for the judge, the replay and the video."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zebrat_bullet.agents import PRIVILEGES, Agent, load_agent
from zebrat_bullet.agents.supervised import SupervisedAgent, supervised
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import to_json
from zebrat_bullet.errors import ConfigError, WorldError, ZebratError
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.files import shown
from zebrat_bullet.task.drive import Drive, DriveStep
from zebrat_bullet.task.rewards import TERMS
from zebrat_bullet.types import Command, Reading, RobotState
from zebrat_bullet.world import World


def run_episode(
    drive: Drive,
    agent: Agent,
    seed: int,
    episode: int,
    world: World | None = None,
) -> EpisodeRecord:
    """Drive one episode to its end.

    The start pose and the lidar noise come from (seed, episode) alone, so every agent meets the same ones.

    Args:
        drive: the task.
        agent: the driver; its own chance comes from (seed, episode) too.
        seed, episode: which episode.
        world: where; None keeps the drive's world.

    Raises:
        ConfigError: it is no agent, returns no command, or asks for a privilege that there is not or for waypoints
            that the world has not.
        WorldError: it asks for the goal of a world without waypoints.
    """
    _check_agent(agent)
    agent.reset(int(np.random.SeedSequence([seed, episode, 1]).generate_state(1)[0]))
    rng = np.random.default_rng([seed, episode])
    reading = drive.reset(rng, world, guided="waypoint" in agent.privileged, whole_scans=True)
    readings, states = [reading], [drive.state]
    commands: list[Command] = []
    steps: list[DriveStep] = []
    touching: list[bool] = []
    while not steps or steps[-1].outcome is None:
        command = agent.act(_with_privileges(reading, drive, agent))
        if not (hasattr(command, "speed_mps") and hasattr(command, "steering_rad")):
            raise ConfigError(
                f"agent {agent.name}: act must return a Command, got {shown(repr(command))}; return "
                "Command(speed_mps, steering_rad) of zebrat_bullet.types"
            )
        if isinstance(agent, SupervisedAgent) and len(agent.refused) > len(touching):
            wanted = agent.refused[-1].command
            touching.append(_is_finite(wanted) and drive.sim.would_touch(wanted))
        step = drive.step(command)
        reading = step.reading
        commands.append(reading.last_command)
        steps.append(step)
        readings.append(reading)
        states.append(drive.state)
    record = _record(drive, agent, seed, episode, readings, states, commands, steps)
    return _with_refused(record, agent, touching) if isinstance(agent, SupervisedAgent) else record


def drive_episodes(
    agent: str,
    task: TaskConfig,
    world: World,
    seed: int,
    episodes: Sequence[int],
    action_noise: float = 0.0,
    supervised_m: float | None = None,
) -> Iterator[EpisodeRecord]:
    """Drive some episodes of an agent in one world, one after the other.

    Args:
        agent: its name, policy file or run folder.
        task, world: what it drives in.
        seed, episodes: which episodes.
        action_noise: Gaussian noise on the commands, as a fraction of the limits.
        supervised_m: margin of the supervisor that its commands go through; None: there is none.

    Raises:
        ZebratError: the agent cannot be loaded, or as `run_episode`.
    """
    driver = load_agent(agent, task, action_noise)
    if supervised_m is not None:
        driver = supervised(driver, task, supervised_m)
    drive = Drive(task, world)
    try:
        for episode in episodes:
            yield run_episode(drive, driver, seed, episode)
    finally:
        drive.close()


class _Commands:
    """An agent that gives recorded commands, one after the other."""

    def __init__(self, record: EpisodeRecord) -> None:
        self.name, self._commands = record.agent, record.command
        self.privileged = frozenset(record.privileged)

    def reset(self, seed: int) -> None:
        self._next = iter(self._commands)

    def act(self, reading: Reading) -> Command:
        speed, steering = next(self._next)
        return Command(float(speed), float(steering))


def replay_episode(drive: Drive, record: EpisodeRecord, world: World) -> EpisodeRecord:
    """Drive a recorded episode's commands again, from the start that its seed gives.

    Raises:
        ZebratError: the outcome or a pose differs from the record: other versions, another robot or another world.
    """
    try:
        again = run_episode(drive, _Commands(record), record.seed, record.episode, world)
    except StopIteration:
        again = None
    if again is None or again.outcome != record.outcome or not np.array_equal(again.pose, record.pose):
        raise ZebratError(
            f"the replay of episode {record.episode} in {record.world} left the recorded path: the robot, the world or "
            "a library version differs from when it was recorded"
        )
    return again


def _check_agent(agent: Agent) -> None:
    missing = [name for name in ("name", "privileged", "reset", "act") if not hasattr(agent, name)]
    if missing:
        raise ConfigError(
            f"an agent has name, privileged, reset(seed) and act(reading), and {shown(repr(agent))} lacks "
            f"{', '.join(missing)}; load_agent(NAME, task) gives one by name"
        )
    unknown = agent.privileged - PRIVILEGES
    if unknown:
        raise ConfigError(f"agent {agent.name}: no privilege {sorted(unknown)}; there are {sorted(PRIVILEGES)}")


def _with_privileges(reading: Reading, drive: Drive, agent: Agent) -> Reading:
    given: dict[str, Any] = {}
    if "pose" in agent.privileged:
        given["state"] = drive.believed
    if "map" in agent.privileged:
        given["walls"] = drive.world.walls
    if "goal" in agent.privileged:
        if not len(drive.world.waypoints):
            raise WorldError(f"{agent.name} drives to a goal and {drive.world.name} has none; give it waypoints")
        given["goal_world"] = drive.world.waypoints[-1]
    if "waypoint" not in agent.privileged and reading.waypoint is not None:
        given["waypoint"] = None  # the task's reward looks at it, the agent must not
    return replace(reading, **given) if given else reading


def _is_finite(command: Command) -> bool:
    return math.isfinite(command.speed_mps + command.steering_rad)


def _with_refused(record: EpisodeRecord, agent: SupervisedAgent, touching: list[bool]) -> EpisodeRecord:
    rows = [
        (at.step, at.command.speed_mps, at.command.steering_rad, touches)
        if _is_finite(at.command)
        else (at.step, 0, 0, 0)
        for at, touches in zip(agent.refused, touching, strict=True)
    ]
    return replace(
        record,
        supervised_m=agent.supervisor.margin_m,
        refused=np.array(rows, dtype=np.float64).reshape(-1, 4),
        reasons=tuple(at.reason for at in agent.refused),
    )


def _record(
    drive: Drive,
    agent: Agent,
    seed: int,
    episode: int,
    readings: list[Reading],
    states: list[RobotState],
    commands: list[Command],
    steps: list[DriveStep],
) -> EpisodeRecord:
    outcome = steps[-1].outcome
    assert outcome is not None
    return EpisodeRecord(
        world=drive.world.source or drive.world.name,
        agent=agent.name,
        seed=seed,
        episode=episode,
        caster=drive.config.lidar.caster,
        outcome=str(outcome),
        unseen_contact=states[-1].unseen_contact,
        task=to_json(drive.config),
        term_names=tuple(TERMS),
        time_s=np.array([reading.time_s for reading in readings]),
        pose=np.array([(s.pose.x, s.pose.y, s.pose.yaw) for s in states]),
        speed_mps=np.array([s.speed_mps for s in states]),
        steering_rad=np.array([s.steering_rad for s in states]),
        knuckle_rad=np.array([s.knuckle_rad for s in states]),
        wheel_rad=np.array([s.wheel_rad for s in states]),
        command=np.array([(c.speed_mps, c.steering_rad) for c in commands]),
        terms=np.array([list(step.terms.values()) for step in steps]),
        reward=np.array([step.reward for step in steps]),
        obs_m=np.array([reading.clearance.obs_m for reading in readings]),
        range_m=drive.region.range_m,
        scan_m=np.array([reading.scan.ranges_m for reading in readings]),
        privileged=tuple(sorted(agent.privileged)),
    )
