"""What the page shows: the track, what is known of a way out of it, and the cars that drive in it."""

import json
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.play.check import Problem, Track, drawn, opened
from zebrat_bullet.play.race import PERSON, Race
from zebrat_bullet.play.search import Finding, Search
from zebrat_bullet.play.stroke import fit_stroke
from zebrat_bullet.robot import fitted, load_robot
from zebrat_bullet.teleop.hub import Hub
from zebrat_bullet.teleop.scene import walls_of

PACES = (1.0, 2.0, 4.0)


class Stage:
    """One track and one race at a time, of whoever holds the driver's seat; safe to use from many threads.

    Args:
        task: the task driven.
        hub: who looks on, and what the driver's keys are.
        agents: who may drive.
        seed: of the start poses.
        limit_s: most time of a search for a way out.
    """

    def __init__(self, task: TaskConfig, hub: Hub, agents: Sequence[str], seed: int, limit_s: float) -> None:
        self._task, self._hub, self._agents, self._seed = fitted(task), hub, list(agents), seed
        self._robot = load_robot(task.robot)
        self._folder = tempfile.TemporaryDirectory(prefix="zebrat-play-")
        self._lock = threading.RLock()
        self._track, self._number, self._version = Track(), 0, 0
        self._finding: Finding | None = None
        self._race: Race | None = None
        self._n_races = 0
        self._search = Search(self._task.robot, self._task.physics, limit_s, self._found)
        self._show()

    def fit(self, stroke: object, width_m: object) -> dict[str, Any]:
        """Return the drawing that a stroke means, or the problem that it has.

        Raises:
            TypeError, ValueError: the width is no number.
        """
        try:
            drawing = fit_stroke(stroke, float(str(width_m)), self._robot)
        except ZebratError as error:
            return {"problem": asdict(Problem(text=str(error), at=getattr(error, "at", None)))}
        return {"drawing": drawing.model_dump(mode="json")}

    def draw(self, data: object) -> str:
        """Take a drawing as the track, and return the track as JSON.

        Raises:
            WorldError: it is no drawing at all.
        """
        with self._lock:
            return self._take(drawn(data, self._robot, Path(self._folder.name)))

    def open(self, text: str) -> str:
        """Take the text of a world file, or a shipped one by its name, as the track, and return the track as JSON."""
        with self._lock:
            try:
                return self._take(opened(text, self._robot, Path(self._folder.name)))
            except ZebratError as error:
                return self._take(Track(problem=Problem(text=str(error))))

    def clear(self) -> str:
        """Take the track away."""
        with self._lock:
            return self._take(Track())

    def drive(self, agents: Sequence[str], pace: float) -> None:
        """Let one or two agents drive the track from its start.

        Raises:
            ConfigError: there is no track that can be driven, no such agent or pace, or the last cars are still busy.
        """
        known = [*self._agents, PERSON]
        if not 1 <= len(agents) <= 2 or any(agent not in known for agent in agents) or len(set(agents)) != len(agents):
            raise ConfigError(f"one or two different drivers of {', '.join(known)} are needed")
        if pace not in PACES:
            raise ConfigError(f"the pace is one of {', '.join(f'{pace:g}' for pace in PACES)}")
        with self._lock:
            if self._track.world is None:
                raise ConfigError("there is no track that can be driven: draw one first")
            self._call_off()
            if self._race is not None and not self._race.join():
                raise ConfigError("the last cars are still busy; try again in a moment")
            self._race = Race(
                agents, self._task, self._track.world, self._seed, self._n_races, self._hub, self._show, pace
            )
            self._n_races += 1
        self._show()

    def stop(self) -> None:
        """Call the race off."""
        with self._lock:
            self._call_off()

    def cancel(self) -> None:
        """End the search for a way out."""
        self._search.cancel()

    def track_json(self) -> str:
        """Return the track and what is known of a way out."""
        with self._lock:
            track, origin = self._track, self._track.origin
            return json.dumps(
                {
                    "sitting": self._hub.sitting,
                    "version": self._version,
                    "number": self._number,
                    "drawing": track.drawing,
                    "text": track.text,
                    "origin": [origin.x, origin.y, origin.yaw],
                    "note": track.note,
                    "problem": None if track.problem is None else asdict(track.problem),
                    "world": None if track.world is None else _world(track),
                    "finding": None if self._finding is None else asdict(self._finding),
                }
            )

    def close(self) -> None:
        """End search and race, and remove what was written."""
        self._search.close()
        with self._lock:
            self._call_off()
            if self._race is not None:
                self._race.join()
        self._folder.cleanup()

    def _take(self, track: Track) -> str:
        self._call_off()
        self._track, self._finding = track, None
        self._number += 1
        self._version += 1
        if track.world is not None:
            self._finding = Finding(state="searching", text="Searching for a way out")
            self._search.ask(self._number, track.searched or track.world)
        else:
            self._search.cancel()
        self._show()
        return self.track_json()

    def _found(self, number: int, finding: Finding) -> None:
        with self._lock:
            if number == self._number:
                self._finding = finding
                self._version += 1
        self._show()

    def _call_off(self) -> None:
        if self._race is not None:
            self._race.stop()

    def _show(self) -> None:
        race = self._race
        lanes = [] if race is None or race.world is not self._track.world else [lane.plain() for lane in race.lanes]
        pace = 1.0 if race is None else race.pace
        view = {"version": self._version, "race": self._n_races, "pace": pace, "lanes": lanes}
        self._hub.show(json.dumps(view))


def _world(track: Track) -> dict[str, Any]:
    world = track.world
    assert world is not None
    start = world.start.pose
    return {
        "name": world.name,
        "walls": walls_of(world),
        "floor": [list(point) for point in world.free_space.exterior.coords],
        "open_line": None if world.open_line is None else world.open_line.tolist(),
        "gates": [] if world.open_line is not None else world.gates.tolist(),
        "start": [start.x, start.y, start.yaw],
    }
