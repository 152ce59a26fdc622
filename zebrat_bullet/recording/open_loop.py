"""A policy on what a bag's lidar saw, beside the commands that the bag holds: it looks, and drives nothing."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import groupby, islice
from operator import itemgetter

import numpy as np

from zebrat_bullet.agents import Agent
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.deploy.driver import Limits
from zebrat_bullet.deploy.senses import EARLY
from zebrat_bullet.errors import ConfigError, SensorError, ZebratError
from zebrat_bullet.files import shown
from zebrat_bullet.recording.bag import CLOUD, Bag, Topic
from zebrat_bullet.recording.heard import Heard
from zebrat_bullet.recording.senses import Eyes, Mount
from zebrat_bullet.recording.topics import Topics
from zebrat_bullet.robot import fitted, load_robot
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.types import Command, FlatScan, Reading

_MOST_WAIT_S = 1.0
"""A command that comes later answers no scan."""
_MOST_SCANS = 1_000_000
_MOST_TOGETHER = 1000
_NS = 1e-9


@dataclass(frozen=True, kw_only=True)
class Reader:
    """How a bag is read.

    Attributes:
        mount: of the recorded lidar; None: as on the policy's car.
        delay_s: a scan is answered by the first command that comes at least so long after it.
        twist_steers: `angular.z` of a Twist is the steering angle, not the yaw rate.
        limits: what of the lidar is refused.
    """

    mount: Mount | None = None
    delay_s: float = 0.0
    twist_steers: bool = False
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        if not 0.0 <= self.delay_s <= _MOST_WAIT_S:
            raise ConfigError(f"a command comes 0 to {_MOST_WAIT_S:g} s after its scan, got {self.delay_s}")


@dataclass(slots=True)
class Answer:
    """What the policy makes of one scan, and what the bag's driver made of it.

    Attributes:
        time_s: when the scan arrived, since the first.
        command: the policy's; a stop where it would have refused the scan.
        recorded: the bag's; None where none answers the scan. Its steering is nan where a Twist does not say it.
        refusal: why the scan cannot be relied on; empty where it can.
    """

    time_s: float
    command: Command
    refusal: str = ""
    recorded: Command | None = None

    @property
    def speed_error_mps(self) -> float:
        """Policy's speed minus the recorded one; nan where there is none."""
        return math.nan if self.recorded is None else self.command.speed_mps - self.recorded.speed_mps

    @property
    def steering_error_rad(self) -> float:
        """Policy's steering minus the recorded one; nan where there is none or a Twist does not say it."""
        return math.nan if self.recorded is None else self.command.steering_rad - self.recorded.steering_rad


@dataclass(frozen=True, kw_only=True)
class OpenLoop:
    """What came of a bag.

    Attributes:
        answers: one for each scan, in the order of arrival.
        n_unusable: commands and odometries whose bytes are none or whose numbers are not finite; they were passed over.
        n_early: scans sooner than a control step after the one before, passed over by a policy with a memory.
        frame: of the lidar's messages.
    """

    answers: list[Answer]
    n_unusable: int
    n_early: int
    frame: str


def run_open_loop(bag: Bag, topics: Topics, agent: Agent, task: TaskConfig, reader: Reader | None = None) -> OpenLoop:
    """Ask an agent at each scan of a bag, as if it were driving; one with a memory, as a car does, once a control step.

    It is told as its last command the last one that the bag's driver gave before that scan, and as its speed the last
    that was measured, or, without odometry, that command's.

    Args:
        bag, topics: what to read.
        agent: any that needs the lidar alone.
        task: the agent's: car, lidar, height band and safety region of its training.
        reader: how the bag is read.

    Raises:
        ConfigError: the agent needs more than the lidar.
        ZebratError: the bag is damaged, or none of its scans can be relied on.
    """
    if agent.privileged:
        raise ConfigError(
            f"{agent.name} is to be told {', '.join(sorted(agent.privileged))}, which no bag holds; name a policy that "
            "needs the lidar alone"
        )
    reader = reader or Reader()
    task = fitted(task)
    robot = load_robot(task.robot)
    region = make_region(robot, task.region, task.lidar.n_bearings)
    needed = np.unique(region.indices) if isinstance(agent, PolicyAgent) else np.arange(task.lidar.n_bearings)
    roll, pitch, yaw = map(float, robot.lidar_rpy)
    mount = reader.mount or Mount(height_m=float(robot.lidar_xyz_base[2]), rpy_rad=(roll, pitch, yaw))
    eyes = Eyes(task, mount, needed, reader.limits)
    agent.reset(0)
    heard = Heard(robot.wheelbase_m, reader.twist_steers)
    answers: list[Answer] = []
    remembers = isinstance(agent, PolicyAgent) and agent.observation.trail_steps
    step_ns, n_early = task.physics.control_step_s / _NS if remembers else 0.0, 0
    times_ns: list[int] = []
    for topic, time_ns, data in _in_order(bag, topics):
        if topic is not topics.lidar:
            heard.take(bag, topic, time_ns, data)
            continue
        if step_ns and times_ns and time_ns - times_ns[-1] < EARLY * step_ns:
            n_early += 1
            continue
        times_ns.append(time_ns)
        if len(times_ns) > _MOST_SCANS:
            raise ZebratError(f"{shown(bag.path)}: holds more than {_MOST_SCANS:,} scans; cut it")
        time_s = (time_ns - times_ns[0]) * _NS
        try:
            scan = _see(eyes, bag, topic, data)
        except SensorError as error:
            answers.append(Answer(time_s, Command(0.0, heard.last.steering_rad), str(error)))
            continue
        reading = Reading(scan, region.measure(scan), heard.last, heard.speed_mps, time_s)
        answers.append(Answer(time_s, agent.act(reading)))
    if answers and all(answer.refusal for answer in answers):
        raise ZebratError(
            f"{shown(bag.path)}: none of the {len(answers)} messages of {topics.lidar} can be used: "
            f"{answers[0].refusal}"
        )
    _pair(answers, times_ns, heard, reader.delay_s)
    return OpenLoop(answers=answers, n_unusable=heard.n_unusable, n_early=n_early, frame=eyes.frame)


def _in_order(bag: Bag, topics: Topics) -> Iterator[tuple[Topic, int, bytes]]:
    """Yield the messages in the order of arrival; of those at one time, what was measured before what was commanded."""
    order = [each for each in (topics.odometry, topics.lidar, topics.command) if each is not None]
    for time_ns, group in groupby(bag.messages(order), key=itemgetter(1)):
        together = list(islice(group, _MOST_TOGETHER + 1))
        if len(together) > _MOST_TOGETHER:
            raise ZebratError(
                f"{shown(bag.path)}: more than {_MOST_TOGETHER} of its messages arrived at one time, {time_ns} ns"
            )
        yield from sorted(together, key=lambda each: order.index(each[0]))


def _see(eyes: Eyes, bag: Bag, topic: Topic, data: bytes) -> FlatScan:
    message = bag.decode(topic, data)
    return eyes.cloud(message) if topic.kind == CLOUD else eyes.scan(message)


def _pair(answers: Iterable[Answer], times_ns: list[int], heard: Heard, delay_s: float) -> None:
    """Give each answer the first command that comes after its scan and before the next one's."""
    delay_ns, wait_ns = round(delay_s / _NS), round(_MOST_WAIT_S / _NS)
    scans, commands = np.array(times_ns, np.int64), np.array(heard.times_ns, np.int64)
    first = np.searchsorted(commands, scans + delay_ns, side="left")
    until = np.append(scans[1:] + delay_ns, scans[-1:] + delay_ns + wait_ns)
    until = np.minimum(until, scans + delay_ns + wait_ns)
    for answer, index, end in zip(answers, first.tolist(), until.tolist(), strict=True):
        if index < len(commands) and commands[index] < end:
            answer.recorded = heard.commands[index]
