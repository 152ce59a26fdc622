"""Cars in the same track at the same time, each in a simulation and a thread of its own, in real time."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from zebrat_bullet.agents import Agent, load_agent
from zebrat_bullet.config import PhysicsConfig, TaskConfig
from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.judge import require_winnable_by
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.teleop.hub import Hub
from zebrat_bullet.teleop.person import key_command
from zebrat_bullet.teleop.scene import car_of, view_of
from zebrat_bullet.types import Command, Reading
from zebrat_bullet.world import World

PERSON = "you"
MOST_CARS = 2
ALONE_S = 3.0
"""When nobody has looked on for so long, the cars are taken off."""
_JOIN_S = 20.0
# PyBullet and Open3D are loaded, and cars built, one after the other.
_BUILDING = threading.Lock()


class _StoppedError(Exception):
    """The race was called off."""


@dataclass
class Lane:
    """A car of a race, as the page sees it: who drives, how it goes, and the JSON of where it is."""

    agent: str
    phase: str = "building"  # then ready, driving, over, or failed, stopped
    text: str = ""
    outcome: str = ""
    time_s: float = 0.0
    car: dict[str, object] = field(default_factory=dict)
    view: dict[str, object] | None = None

    def plain(self) -> dict[str, object]:
        """Return it for JSON."""
        return dict(vars(self))


class Race:
    """One or two cars from the same start; they do not see each other.

    Args:
        agents: who drives; `PERSON` is whoever holds the driver's seat of the hub.
        task, world, seed, episode: what is driven; the same for all, but that each policy has its own senses.
        hub: whose keys the person presses.
        pace: so many times as fast as real time; a person drives in real time.
        changed: told whenever there is something new to see.
    """

    def __init__(
        self,
        agents: Sequence[str],
        task: TaskConfig,
        world: World,
        seed: int,
        episode: int,
        hub: Hub,
        changed: Callable[[], None],
        pace: float = 1.0,
    ) -> None:
        self.lanes = [Lane(agent) for agent in agents[:MOST_CARS]]
        self._task, self.world, self._seed, self._episode, self._hub = task, world, seed, episode, hub
        self._changed, self.pace = changed, 1.0 if PERSON in agents else pace
        self._stopped = False
        self._threads = [threading.Thread(target=self._drive, args=(lane,), daemon=True) for lane in self.lanes]
        for thread in self._threads:
            thread.start()

    @property
    def running(self) -> bool:
        """Whether some car is still being simulated."""
        return any(thread.is_alive() for thread in self._threads)

    def stop(self) -> None:
        """Call the race off; each car is taken off at its next step."""
        self._stopped = True

    def join(self) -> bool:
        """Wait until all simulations are closed, and return whether they are."""
        for thread in self._threads:
            thread.join(_JOIN_S)
        return not self.running

    def _drive(self, lane: Lane) -> None:
        drive: Drive | None = None
        try:
            own, _ = (self._task, None) if lane.agent == PERSON else as_trained(self._task, lane.agent, own_robot=False)
            with _BUILDING:
                agent = _Person(self._hub, own.physics) if lane.agent == PERSON else load_agent(lane.agent, own)
                require_winnable_by(agent, self.world)
                drive = Drive(own, self.world)
            lane.car = car_of(drive)
            record = run_episode(drive, _Paced(agent, drive, lane, self), self._seed, self._episode)
            x, y, yaw = record.pose[-1].tolist()
            lane.view = view_of((x, y, yaw), record.scan_m[-1], record.duration_s, 0.0, float(record.steering_rad[-1]))
            lane.phase, lane.outcome, lane.time_s = "over", record.outcome, record.duration_s
        except _StoppedError:
            lane.phase = "stopped"
        except ZebratError as error:
            lane.phase, lane.text = "failed", str(error)
        except Exception as error:
            lane.phase, lane.text = "failed", f"this is a bug of ours: {type(error).__name__}: {error}"
            raise
        finally:
            if drive is not None:
                drive.close()
            self._changed()

    def _begin(self, lane: Lane) -> None:
        """Wait until every car stands at the start, and for the first key where a person drives."""
        lane.phase = "ready"
        self._changed()
        manned = any(other.agent == PERSON for other in self.lanes)
        while any(other.phase == "building" for other in self.lanes):
            self._sleep(time.monotonic() + 0.05)
        while manned and not self._hub.keys() - {"stop"} and not any(other.phase == "driving" for other in self.lanes):
            self._sleep(time.monotonic() + 0.05)
        lane.phase = "driving"

    def _sleep(self, until: float) -> None:
        alone_since: float | None = None
        while True:
            now = time.monotonic()
            if self._hub.occupied():
                alone_since = None
            elif alone_since is None:
                alone_since = now
            if self._stopped or (alone_since is not None and now - alone_since > ALONE_S):
                raise _StoppedError
            if now >= until and alone_since is None:
                return
            time.sleep(min(0.05, max(0.0, until - now)) or 0.01)

    def tick(self, lane: Lane, until: float) -> None:
        """Show a lane, and sleep until its next step is due.

        Raises:
            _StoppedError: the race is called off, or nobody looks on.
        """
        self._changed()
        if lane.phase == "ready" or lane.phase == "building":
            self._begin(lane)
        self._sleep(until)


class _Paced:
    """An agent in real time: each of its readings is shown, and each of its commands waits until it is due."""

    def __init__(self, agent: Agent, drive: Drive, lane: Lane, race: Race) -> None:
        self.name, self.privileged = agent.name, agent.privileged
        self._agent, self._drive, self._lane, self._race = agent, drive, lane, race
        self._step_s = drive.config.physics.control_step_s / race.pace
        self._due = 0.0

    def reset(self, seed: int) -> None:
        self._agent.reset(seed)

    def act(self, reading: Reading) -> Command:
        pose, steering = self._drive.state.pose, self._drive.state.steering_rad
        here = pose.x, pose.y, pose.yaw
        self._lane.view = view_of(here, reading.scan.ranges_m, reading.time_s, reading.speed_mps, steering)
        self._lane.time_s = reading.time_s
        if isinstance(self._agent, _Person):
            self._race.tick(self._lane, self._due)
            command = self._agent.act(reading)
        else:
            command = self._agent.act(reading)
            self._race.tick(self._lane, self._due)
        # A late step is not caught up: the car would jump.
        self._due = max(self._due + self._step_s, time.monotonic())
        return command


class _Person:
    """Whoever holds the driver's seat."""

    name = PERSON
    privileged = frozenset({"pose", "map"})  # the page shows both

    def __init__(self, hub: Hub, limits: PhysicsConfig) -> None:
        self._hub, self._limits = hub, limits

    def reset(self, seed: int) -> None:
        """A person needs no seed."""

    def act(self, reading: Reading) -> Command:
        return key_command(reading.last_command, self._hub.keys(), self._limits)
