"""Success over each disturbance of car and senses, for every agent: a table that survives a kill."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from zebrat_bullet.agents import Agent, code_or_weights, load_agent
from zebrat_bullet.config import TaskConfig, within
from zebrat_bullet.config_text import with_overrides
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.axes import NOMINAL, disturbed, levels_of, nominal_of
from zebrat_bullet.evaluation.claim import claim_folder
from zebrat_bullet.evaluation.csv_log import CsvLog, read_as
from zebrat_bullet.evaluation.judge import require_each_once, require_winnable_by
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.evaluation.rollout import drive_episodes
from zebrat_bullet.evaluation.workers import worker_pool
from zebrat_bullet.notes import Note
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.world import World, load_world

CHUNK = 5
"""Episodes to a row: what a kill may lose."""


@dataclass(frozen=True, kw_only=True)
class RobustnessStudy:
    """What to drive.

    Attributes:
        agents: names, policy files or run folders.
        axes: the levels of each axis; that at which nothing is disturbed is driven once for all axes.
        worlds: names or files.
        episodes: of each agent in each world at each level; they begin alike for all.
        supervised_m: margin of the supervisor that the commands go through; None: there is none.
        seed: of the episodes.
        workers: processes; None takes one a core.
        task: the task driven; limits, lidar and safety region of a policy are those that it was trained with.
        settings: further settings of the task, "key=value", which go before those of the policy.
    """

    agents: tuple[str, ...]
    axes: Mapping[str, tuple[float, ...]]
    worlds: tuple[str, ...]
    episodes: int
    supervised_m: float | None = None
    seed: int = 0
    workers: int | None = None
    task: TaskConfig
    settings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for axis, levels in self.axes.items():
            levels_of(axis)
            for level in levels:
                disturbed(self.task, axis, level)
        if not self.agents or not self.worlds or not self.axes or self.episodes < 1:
            raise ConfigError("name at least 1 agent, 1 axis, 1 world and 1 episode")
        within(self, episodes=(1, 10**6), seed=(0, 2**63 - 1), supervised_m=(0.0, 100.0))
        require_each_once(self.worlds)

    def own_task(self, agent: str) -> TaskConfig:
        """Return the undisturbed task of an agent."""
        task = as_trained(self.task, agent, own_robot=False)[0]
        return with_overrides(task, self.settings)


@dataclass(frozen=True, kw_only=True)
class RobustnessRow:
    """How some episodes of an agent in a world ended at a level of an axis; a row of the table.

    Attributes:
        agent: who drove.
        weights: `code_or_weights` of the agent.
        supervised: margin of the supervisor in m; empty where there was none.
        world: where.
        axis, level: what was disturbed how far, in the unit of the axis; "nominal" and 0: nothing.
        first: number of the first episode; they follow one another.
        episodes: how many; success, collision, false_exit, timeout and stall add up to it.
    """

    agent: str
    weights: str
    supervised: str
    world: str
    axis: str
    level: float
    first: int
    episodes: int
    success: int
    collision: int
    false_exit: int
    timeout: int
    stall: int


COLUMNS = tuple(field.name for field in fields(RobustnessRow))


def run_study(
    study: RobustnessStudy, folder: Path, on_row: Callable[[str, int, int], None] = lambda doing, done, total: None
) -> list[RobustnessRow]:
    """Drive what a folder's table does not yet hold, and return all that it holds then.

    Args:
        study: what to drive.
        folder: holds `robustness.csv`, and in `study.json` what all its rows have in common.
        on_row: called with what was driven, how many episodes there are, and how many there will be.

    Raises:
        ConfigError: the folder's rows were driven under another task or seed.
        ZebratError: an agent or a world cannot be loaded, or a world not be won by an agent; nothing was driven then.
    """
    _world.cache_clear()  # a file may have been edited since this process read it last
    own = {name: study.own_task(name) for name in study.agents}
    agents = {name: load_agent(name, own[name]) for name in study.agents}
    for agent in agents.values():
        for world in study.worlds:
            require_winnable_by(agent, _world(world, study.task.robot))
    places = {world: _world(world, study.task.robot) for world in study.worlds}
    claim_folder(folder, "episodes", with_overrides(study.task, study.settings), places, seed=study.seed)
    log = CsvLog(folder / "robustness.csv", COLUMNS)
    there = _episodes_there(read_table(folder))
    rows = list(_rows(study, agents))
    jobs = [job for row in rows for job in _missing(row, there.get(_key(row), set()), study.episodes)]
    total = len(rows) * study.episodes
    done = total - sum(job.episodes for job in jobs)
    on_row("driving", done, total)
    with worker_pool(study.workers, len(jobs)) as pool:
        driven = [pool.submit(_drive, job, disturbed(own[job.agent], job.axis, job.level), study.seed) for job in jobs]
        for future in as_completed(driven):
            row = future.result()
            log.append(asdict(row))
            done += row.episodes
            on_row(f"{row.agent}, {row.axis} {row.level:g}, {row.world}", done, total)
    return read_table(folder)


def read_table(folder: Path) -> list[RobustnessRow]:
    """Return the rows of a folder's table; episodes that two runs drove at once count once."""
    there: dict[tuple[object, ...], set[int]] = {}
    kept = []
    for row in read_as(RobustnessRow, folder / "robustness.csv"):
        known = there.setdefault(_key(row), set())
        if known.isdisjoint(_numbers(row)):
            known.update(_numbers(row))
            kept.append(row)
    return kept


def _rows(study: RobustnessStudy, agents: Mapping[str, Agent]) -> Iterator[RobustnessRow]:
    """Yield an empty row for each agent and world at each level, the undisturbed ones first."""
    given = [(axis, level) for axis, levels in study.axes.items() for level in levels]
    far = [(axis, level) for axis, level in given if level != nominal_of(axis)]
    places = far if len(far) == len(given) else [(NOMINAL, 0.0), *far]
    margin = "" if study.supervised_m is None else f"{study.supervised_m:g}"
    for axis, level in places:
        for name, agent in agents.items():
            weights = code_or_weights(agent)
            for world in study.worlds:
                yield RobustnessRow(
                    agent=name, weights=weights, supervised=margin, world=world, axis=axis, level=level,
                    first=0, episodes=0, success=0, collision=0, false_exit=0, timeout=0, stall=0,
                )  # fmt: skip


def _missing(row: RobustnessRow, there: set[int], episodes: int) -> Iterator[RobustnessRow]:
    """Yield empty rows of at most `CHUNK` episodes in a row that are not there."""
    at = 0
    while at < episodes:
        n = next((n for n in range(CHUNK) if at + n in there or at + n == episodes), CHUNK)
        if n:
            yield replace(row, first=at, episodes=n)
        at += n or 1


def _episodes_there(rows: Sequence[RobustnessRow]) -> dict[tuple[object, ...], set[int]]:
    there: dict[tuple[object, ...], set[int]] = {}
    for row in rows:
        there.setdefault(_key(row), set()).update(_numbers(row))
    return there


def _numbers(row: RobustnessRow) -> range:
    return range(row.first, row.first + row.episodes)


def _key(row: RobustnessRow) -> tuple[object, ...]:
    return row.agent, row.weights, row.supervised, row.world, row.axis, row.level


@lru_cache
def _world(reference: str, robot: str) -> World:
    return load_world(reference, robot=load_robot(robot))


def _drive(row: RobustnessRow, task: TaskConfig, seed: int) -> RobustnessRow:
    """Return a row with how its episodes ended."""
    warnings.simplefilter("ignore", Note)  # a world's were said before; where a planner has no plan its car stalls
    world, margin_m = _world(row.world, task.robot), float(row.supervised) if row.supervised else None
    records = drive_episodes(row.agent, task, world, seed, _numbers(row), supervised_m=margin_m)
    outcomes = [Outcome(record.outcome) for record in records]
    endings: dict[str, Any] = {str(each): outcomes.count(each) for each in Outcome}
    return replace(row, **endings)
