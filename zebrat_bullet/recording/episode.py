"""An episode with all that a recording holds of it: the record alone keeps no clouds."""

from dataclasses import dataclass

from zebrat_bullet.agents import Agent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.evaluation.rollout import replay_episode, run_episode
from zebrat_bullet.sensing.lidar import Sweep
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command, Reading, RobotState
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
    """A drive of one episode that keeps what each of its readings was made from."""

    def __init__(self, config: TaskConfig, world: World) -> None:
        super().__init__(config, world)
        self.seen: list[Seen] = []

    def _read(self, command: Command) -> Reading:
        reading = super()._read(command)
        self.seen.append(Seen(self.state, self.sweep))
        return reading


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
