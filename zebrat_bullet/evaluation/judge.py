"""One judge for every agent: the same worlds, start poses, seeds and rules; episodes spread over the cores."""

import re
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

from zebrat_bullet.agents import Agent, PolicyNote, load_agent
from zebrat_bullet.config import TaskConfig, within
from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.evaluation.metrics import Score, score
from zebrat_bullet.evaluation.records import EpisodeRecord, save_record
from zebrat_bullet.evaluation.rollout import drive_episodes
from zebrat_bullet.evaluation.workers import worker_pool
from zebrat_bullet.files import is_file, shown
from zebrat_bullet.robot import load_robot
from zebrat_bullet.values import of_kind, whole_number
from zebrat_bullet.world import World, WorldNote, load_world, require_winnable, world_labels, world_names

CHUNK = 5
_RECORD = re.compile(r"episode_\d{4,}\.npz")


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What to judge.

    Attributes:
        agent: an agent's name (with settings: "dwa:allow_reverse=true"), policy file or run folder.
        worlds: world names or files; `write_spec` saves a generated track as one.
        episodes: episodes in each world.
        seed: first part of every episode's seed; episode k of a world starts the same for every agent.
        action_noise: Gaussian noise on the commands, as a fraction of the limits.
        supervised_m: margin of the supervisor that the commands go through; None: there is none.
        records: folder for the episode records; None keeps none.
        workers: processes; None takes one a core. They import the main module again, so a script that judges needs its
            `if __name__ == "__main__":`.
        task: the task driven.
    """

    agent: str
    worlds: tuple[str, ...]
    episodes: int
    seed: int = 0
    action_noise: float = 0.0
    supervised_m: float | None = None
    records: Path | None = None
    workers: int | None = None
    task: TaskConfig

    def __post_init__(self) -> None:
        whole_number(self.episodes, "episodes", 1, 10**6)
        whole_number(self.seed, "seed", 0, 2**63 - 1)
        within(self, action_noise=(0.0, 100.0), supervised_m=(0.0, 100.0))
        of_kind(self.agent, str, "agent", "name one, a policy file or a run folder, as a text")
        of_kind(self.task, TaskConfig, "task", "give TaskConfig(...)")
        world_names(self.worlds)
        if not self.worlds:
            raise ConfigError("name at least one world")
        require_each_once(self.worlds)


def judge(what: Judgement, on_episode: Callable[[str], None] = lambda world: None) -> dict[str, Score]:
    """Judge an agent in every world and return a score for each.

    Every record is written as soon as its episode is over, so what was driven survives a crash. Those of an earlier
    judgement in the same worlds are removed before: what lies there is what was scored.

    Args:
        what: agent, worlds, episodes, task.
        on_episode: called with the world's name after each episode that has ended.

    Raises:
        ZebratError: the agent or a world cannot be loaded, or not be won; nothing was driven then.
    """
    require_drivable(what)
    _remove_records(what)
    jobs = [
        (what, world, range(first, min(first + CHUNK, what.episodes)))
        for world in what.worlds
        for first in range(0, what.episodes, CHUNK)
    ]
    records: dict[str, list[EpisodeRecord]] = {world: [] for world in what.worlds}
    with worker_pool(what.workers, len(jobs)) as pool:
        for future in as_completed([pool.submit(_drive_chunk, *job) for job in jobs]):
            world, chunk = future.result()
            records[world] += chunk
            for _ in chunk:
                on_episode(world)
    return {world: score(sorted(records[world], key=lambda r: r.episode)) for world in what.worlds}


def _remove_records(what: Judgement) -> None:
    if what.records is not None:
        for world in what.worlds:
            for path in record_path(what.records, world, 0, what.worlds).parent.glob("episode_*.npz"):
                if _RECORD.fullmatch(path.name) and is_file(path):
                    path.unlink()


def require_drivable(what: Judgement) -> None:
    """Refuse what cannot be judged, before anything is driven.

    Raises:
        ZebratError: the agent or a world cannot be loaded, or not be won.
    """
    agent, robot = load_agent(what.agent, what.task, what.action_noise), load_robot(what.task.robot)
    for world in what.worlds:
        require_winnable_by(agent, load_world(world, robot=robot))


def require_each_once(worlds: Sequence[str]) -> None:
    """Refuse a world that is named twice.

    Raises:
        ConfigError: one is.
    """
    if twice := [world for i, world in enumerate(worlds) if world in worlds[:i]]:
        raise ConfigError(f"{shown(twice[0])} is named twice, and would be driven twice alike; name each world once")


def require_winnable_by(agent: Agent, world: World) -> None:
    """Refuse a world in which no episode of an agent can succeed.

    Raises:
        WorldError: nobody can win it, or it is won by a lap and the agent drives to a goal.
    """
    require_winnable(world)
    if "goal" in agent.privileged and world.open_line is None and len(world.gates) > 1:
        raise WorldError(
            f"{world.source or world.name}: it is won by a lap, and {agent.name} drives to a goal, so every episode "
            "would fail; give the world a goal (`goal: [x, y]`, --goal X Y), or let a policy drive"
        )


def record_path(folder: Path, world: str, episode: int, worlds: Sequence[str] = ()) -> Path:
    """Return where the record of an episode in a world, one of several perhaps of the same file name, lies."""
    return folder / world_labels([*worlds, world])[world] / f"episode_{episode:04d}.npz"


def _drive_chunk(what: Judgement, world: str, episodes: Sequence[int]) -> tuple[str, list[EpisodeRecord]]:
    records = []
    for said_before in (WorldNote, PolicyNote):  # once, before the work was spread
        warnings.simplefilter("ignore", said_before)
    place = load_world(world, robot=load_robot(what.task.robot))
    how = (what.action_noise, what.supervised_m)
    for record in drive_episodes(what.agent, what.task, place, what.seed, episodes, *how):
        if what.records is not None:
            save_record(record, record_path(what.records, world, record.episode, what.worlds))
        records.append(record)
    return world, records
