"""An episode with all that a recording holds of it: the record alone keeps no clouds."""

from dataclasses import dataclass

import numpy as np

from zebrat_bullet.agents import Agent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.evaluation.rollout import replay_episode, run_episode
from zebrat_bullet.sensing.lidar import Sweep
from zebrat_bullet.task.drive import Drive, DriveStep
from zebrat_bullet.types import Command, Pose2, Reading, RobotState
from zebrat_bullet.world import World


@dataclass(frozen=True, slots=True)
class Seen:
    """What one reading was made from: where the car was, and the revolution of its lidar."""

    state: RobotState
    sweep: Sweep


@dataclass(frozen=True, kw_only=True)
class WatchedEpisode:
    """An episode of T control steps.

    Attributes:
        record: what `zebrat evaluate` keeps of it.
        seen: (T+1) what each of its readings was made from.
        drive: what it was driven with; its region, robot and lidar make sense of the above.
    """

    record: EpisodeRecord
    seen: list[Seen]
    drive: Drive


class WatchedDrive(Drive):
    """A drive that keeps what each reading of the episode was made from."""

    seen: list[Seen]

    def reset(
        self,
        rng: np.random.Generator,
        world: World | None = None,
        pose: Pose2 | None = None,
        *,
        guided: bool = False,
        whole_scans: bool = False,
    ) -> Reading:
        """Begin an episode, as `Drive.reset`."""
        reading = super().reset(rng, world, pose, guided=guided, whole_scans=whole_scans)
        self.seen = [Seen(self.state, self.sweep)]
        return reading

    def step(self, command: Command) -> DriveStep:
        """Drive one control step, as `Drive.step`."""
        step = super().step(command)
        self.seen.append(Seen(self.state, self.sweep))
        return step


def watch_episode(task: TaskConfig, world: World, agent: Agent, seed: int, episode: int) -> WatchedEpisode:
    """Drive one episode, the same as `zebrat evaluate`'s of that seed and number."""
    drive = WatchedDrive(task, world)
    try:
        record = run_episode(drive, agent, seed, episode)
    finally:
        drive.close()
    return WatchedEpisode(record=record, seen=drive.seen, drive=drive)


def watch_again(task: TaskConfig, world: World, record: EpisodeRecord) -> WatchedEpisode:
    """Drive a recorded episode's commands again.

    Raises:
        ZebratError: a pose differs from the record.
    """
    drive = WatchedDrive(task, world)
    try:
        replay_episode(drive, record, world)
    finally:
        drive.close()
    return WatchedEpisode(record=record, seen=drive.seen, drive=drive)
