"""The search for a way out of a track, in a process of its own: it can take long, and then it is ended."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Literal

import numpy as np

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import PlanError, WorldError
from zebrat_bullet.planning.arc_path import ArcPath
from zebrat_bullet.planning.certify import certify
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.world import World, load_world

_POLL_S = 0.05
# A search in vain is left to end by itself for so long when another track is asked for: to begin anew takes longer.
_GRACE_S = 1.0
_SPACING_M = 0.1


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What is known of a way out.

    Attributes:
        state: "no_way" is proven; "gave_up": none was found within what the search looks at or the time it has, and
            there may be one; "unasked": the track has no exit that one could search for.
        text: in plain words.
        n_reversals, length_m, clearance_m, least_time_s: of a way that was found, as its certificate says.
        path: (x, y) of the rear axle along it, world frame, m.
    """

    state: Literal["searching", "drivable", "no_way", "gave_up", "cancelled", "unasked"]
    text: str = ""
    n_reversals: int = 0
    length_m: float = 0.0
    clearance_m: float = 0.0
    least_time_s: float = 0.0
    path: tuple[tuple[float, float], ...] = ()


def find(world: World, robot: RobotModel, physics: PhysicsConfig) -> Finding:
    """Search for a way out of a world, or for a proof that there is none."""
    try:
        found = certify(world, robot, physics)
    except WorldError as error:
        return Finding(state="unasked", text=str(error))
    except PlanError as error:
        if error.proven:
            return Finding(state="no_way", text="Proven: no drive leads out, however often the car reverses")
        return Finding(state="gave_up", text="Gave up: no way found, but none is proven not to exist")
    path = ArcPath(np.array(found.path), np.array(found.directions, dtype=np.int64))
    poses, _ = path.sample(_SPACING_M)
    times = {0: "without reversing", 1: "with 1 reversal"}.get(found.n_reversals, f"with {found.n_reversals} reversals")
    return Finding(
        state="drivable",
        text=f"Can be driven, {times}",
        n_reversals=found.n_reversals,
        length_m=found.length_m,
        clearance_m=found.clearance_m,
        least_time_s=found.least_time_s,
        path=tuple((round(x, 3), round(y, 3)) for x, y in poses[:, :2].tolist()),
    )


class Search:
    """Looks for a way out of one track at a time: the newest asked for.

    Args:
        robot: name of the car.
        physics: limits of its commands.
        limit_s: after so long a search is ended.
        report: told the number of the track and what is known; from a thread of the search.
    """

    def __init__(
        self, robot: str, physics: PhysicsConfig, limit_s: float, report: Callable[[int, Finding], None]
    ) -> None:
        self._robot, self._physics, self._limit_s, self._report = robot, physics, limit_s, report
        self._changed = threading.Condition()
        self._wanted: tuple[int, World] | None = None
        self._busy_with: int | None = None
        self._cancelled, self._closed = False, False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def ask(self, number: int, world: World) -> None:
        """Search this track next."""
        with self._changed:
            self._wanted = number, world
            self._changed.notify_all()

    def cancel(self) -> None:
        """End the search that runs and forget the one that waits."""
        with self._changed:
            self._wanted, self._cancelled = None, True
            self._changed.notify_all()

    def close(self) -> None:
        """End the process."""
        with self._changed:
            self._closed, self._cancelled = True, True
            self._changed.notify_all()
        self._thread.join(10.0)

    def _work(self) -> None:
        worker = _Worker(self._robot, self._physics)
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._wanted is not None or self._closed)
                    if self._closed or self._wanted is None:
                        return
                    (number, world), self._wanted, self._cancelled = self._wanted, None, False
                self._report(number, Finding(state="searching", text="Searching for a way out"))
                finding = self._find(worker, world)
                if finding.state in ("cancelled", "gave_up") and not worker.idle:
                    worker.kill()
                    worker = _Worker(self._robot, self._physics)
                self._report(number, finding)
        finally:
            worker.kill()

    def _find(self, worker: "_Worker", world: World) -> Finding:
        worker.send(world)
        began = time.monotonic()
        while True:
            answer = worker.poll(_POLL_S)
            if answer is not None:
                return answer
            if not worker.ready:  # it is still getting ready, which is not the track's fault
                began = time.monotonic()
            spent = time.monotonic() - began
            if self._cancelled or (self._wanted is not None and spent > _GRACE_S):
                return Finding(state="cancelled", text="The search was cancelled")
            if spent > self._limit_s:
                text = f"Gave up after {self._limit_s:g} s: no way found, but none is proven not to exist"
                return Finding(state="gave_up", text=text)


class _Worker:
    """A process that answers worlds with findings, one at a time."""

    def __init__(self, robot: str, physics: PhysicsConfig) -> None:
        context = get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process: BaseProcess = context.Process(target=_serve, args=(theirs, robot, physics), daemon=True)
        self._process.start()
        theirs.close()
        self.ready, self.idle = False, True

    def send(self, world: World) -> None:
        self.idle = False
        with contextlib.suppress(OSError):  # a dead process is found out by `poll`
            self._ours.send(world)

    def poll(self, timeout_s: float) -> Finding | None:
        try:
            if not self._ours.poll(timeout_s):
                return None
            answer = self._ours.recv()
        except (EOFError, OSError):
            return Finding(state="gave_up", text="The search broke off (out of memory?); nothing is proven")
        if not isinstance(answer, Finding):
            self.ready = True
            return None
        self.idle = True
        return answer

    def kill(self) -> None:
        self._process.kill()
        self._process.join(10.0)
        self._ours.close()


def _serve(connection: Connection, robot_name: str, physics: PhysicsConfig) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the command, and that ends this
    os.nice(5)
    robot = load_robot(robot_name)
    find(
        load_world("track_1"), load_robot("zebrat"), PhysicsConfig()
    )  # compiles the search, where that is not done yet
    connection.send("ready")
    with contextlib.suppress(EOFError, OSError):
        while True:
            connection.send(find(connection.recv(), robot, physics))
