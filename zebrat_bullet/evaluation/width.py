"""Success over the width of a passage: for every agent, shape of passage and sense of its turn."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from zebrat_bullet.agents import Agent, code_or_weights, load_agent
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import TaskConfig, with_engine, within
from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.evaluation.claim import claim_folder
from zebrat_bullet.evaluation.csv_log import CsvLog, read_as
from zebrat_bullet.evaluation.endings import SIMULATORS, Endings, engine_endings, planar_endings
from zebrat_bullet.evaluation.metrics import wilson_interval
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.world.passage import SHAPES, START_GAP_M, passage, senses
from zebrat_bullet.world.world import World

MASTERED = 0.95
_MOST_WIDTHS = 10_000
"""Success at a width, and at every wider one, from which on an agent masters it."""


@dataclass(frozen=True, kw_only=True)
class WidthStudy:
    """What to drive.

    Attributes:
        agents: names, policy files or run folders.
        shapes: of `SHAPES`.
        widths_m: ascending.
        episodes: for each agent, shape, sense and width.
        sim: "planar", "bullet" or "mujoco"; where policies drive planar cars, other agents drive in PyBullet.
        seed: of the episodes in PyBullet; on planar cars, which begin at a passage's own poses, of noise and dynamics.
        action_noise: Gaussian noise on the commands, as a fraction of the limits.
        workers: processes; None takes one a core.
        task: the task driven; limits, lidar and safety region of a policy are those that it was trained with.
    """

    agents: tuple[str, ...]
    shapes: tuple[str, ...] = SHAPES
    widths_m: tuple[float, ...]
    episodes: int
    sim: str = "planar"
    seed: int = 0
    action_noise: float = 0.0
    workers: int | None = None
    task: TaskConfig

    def __post_init__(self) -> None:
        if unknown := set(self.shapes) - set(SHAPES):
            raise ConfigError(f"no shape {sorted(unknown)}; there are {', '.join(SHAPES)}")
        if self.sim not in SIMULATORS:
            raise ConfigError(f"sim must be one of {', '.join(SIMULATORS)}, got {self.sim!r}")
        if not self.widths_m or self.episodes < 1:
            raise ConfigError(f"name at least 1 width and 1 episode, got {len(self.widths_m)} and {self.episodes}")
        within(self, episodes=(1, 10**6), seed=(0, 2**63 - 1), action_noise=(0.0, 100.0), widths_m=(0.0, 1000.0))


@dataclass(frozen=True, kw_only=True)
class WidthRow:
    """How an agent's episodes ended in one passage; a row of the table.

    Attributes:
        agent, sim: who drove, where.
        weights: `code_or_weights` of the agent, so that a policy that learned on counts as another.
        shape, sense, width_m: the passage.
        episodes: how many; success, collision, false_exit, timeout and stall add up to it.
    """

    agent: str
    sim: str
    weights: str
    shape: str
    sense: str
    width_m: float
    episodes: int
    success: int
    collision: int
    false_exit: int
    timeout: int
    stall: int


COLUMNS = tuple(field.name for field in fields(WidthRow))


def run_study(
    study: WidthStudy, folder: Path, on_rows: Callable[[str, int, int], None] = lambda doing, done, total: None
) -> list[WidthRow]:
    """Drive what a folder's table does not yet hold, and return all that it holds then.

    Every passage is written as soon as it has been driven, so a kill loses little. A passage is driven again only where
    more episodes are asked for than were driven.

    Args:
        study: what to drive.
        folder: holds `width.csv`, and in `study.json` what all its rows have in common.
        on_rows: called with what is driven, how many passages of that are done, and how many there are.

    Raises:
        ConfigError: the folder's rows were driven under another task, seed or noise, or the car is too long.
        ZebratError: an agent or passage that there is not; nothing was driven then.
    """
    own = {name: replace(study, task=as_trained(study.task, name, own_robot=False)[0]) for name in study.agents}
    agents = {name: load_agent(name, own[name].task) for name in study.agents}
    task = with_engine(study.task, "bullet")  # the rows say what they were driven in
    robot = load_robot(study.task.robot)
    courses = [(shape, sense) for shape in study.shapes for sense in senses(shape)]
    worlds = {(*course, width): _passage(*course, width, robot) for course in courses for width in study.widths_m}
    claim_folder(folder, "widths", task, seed=study.seed, action_noise=study.action_noise)
    log = CsvLog(folder / "width.csv", COLUMNS)
    for name, agent in agents.items():
        done = {_key(row) for row in read_table(folder) if row.episodes >= study.episodes}
        start = replace(_blank(study, name, agent), episodes=study.episodes)
        for shape, sense in courses:
            rows = [replace(start, shape=shape, sense=sense, width_m=width) for width in study.widths_m]
            missing = [row for row in rows if _key(row) not in done]
            doing, n_done = f"{name}, {shape} {sense}", len(rows) - len(missing)
            on_rows(doing, n_done, len(rows))
            for i, endings in _drive(own[name], name, agent, [worlds[shape, sense, row.width_m] for row in missing]):
                log.append(asdict(missing[i]) | endings.causes())
                n_done += 1
                on_rows(doing, n_done, len(rows))
    return read_table(folder)


def read_table(folder: Path) -> list[WidthRow]:
    """Return the rows of a folder's table; of those that were driven again, the last."""
    return list({_key(row): row for row in read_as(WidthRow, folder / "width.csv")}.values())


def pooled(rows: Sequence[WidthRow]) -> dict[float, tuple[float, float, float]]:
    """Return success and its 95 % Wilson interval over all rows of a width, by width, ascending."""
    counts: dict[float, tuple[int, int]] = {}
    for row in rows:
        success, episodes = counts.get(row.width_m, (0, 0))
        counts[row.width_m] = success + row.success, episodes + row.episodes
    return {width: (s / n, *wilson_interval(s, n)) for width, (s, n) in sorted(counts.items())}


def mastered_m(rows: Sequence[WidthRow]) -> float | None:
    """Return the least width with 95 % success at it and at every wider one that was driven, both senses together."""
    least = None
    for width, (success, *_) in reversed(pooled(rows).items()):
        if success < MASTERED:
            break
        least = width
    return least


def width_range(least_m: float, most_m: float, step_m: float) -> tuple[float, ...]:
    """Return the widths from least to most, both included, to a millimetre.

    Raises:
        ConfigError: these are no numbers in ascending order, or the step is not a millimetre at least.
    """
    if not (0 < least_m <= most_m and step_m >= 0.001):
        raise ConfigError(f"widths need 0 < least <= most and a step from 0.001 m, got {least_m}, {most_m}, {step_m}")
    n = round((most_m - least_m) / step_m) if most_m > least_m else 0
    if n > _MOST_WIDTHS:
        raise ConfigError(f"{n} widths are more than {_MOST_WIDTHS}; take a larger step")
    return tuple(round(float(width), 3) for width in least_m + step_m * np.arange(n + 1) if width < most_m + 1e-6)


def _passage(shape: str, sense: str, width_m: float, robot: RobotModel) -> World:
    length, breadth = np.ptp(robot.footprint_base, axis=0)
    try:
        return passage(shape, width_m, sense, robot)
    except WorldError as error:
        if width_m <= breadth + 2 * START_GAP_M:
            raise
        behind = -float(robot.footprint_base[:, 0].min())
        raise ConfigError(
            f"{robot.source}, {length:.2f} m long, {behind:.2f} m of it behind its base, has no room to begin in the "
            "passages of this study, which are as long whatever the car; judge it in worlds of your own: "
            "zebrat evaluate --worlds"
        ) from error


def _drive(study: WidthStudy, name: str, agent: Agent, worlds: list[World]) -> Iterator[tuple[int, Endings]]:
    """Yield place and endings of each world."""
    if not worlds:
        return
    sim = _sim(study, agent)
    if sim != "planar":
        yield from engine_endings(
            name, with_engine(study.task, sim), worlds, study.episodes,
            seed=study.seed, action_noise=study.action_noise, workers=study.workers,
        )  # fmt: skip
        return
    assert isinstance(agent, PolicyAgent)
    noise, seed = study.action_noise, study.seed
    found = planar_endings(agent, study.task, worlds, study.episodes, seed=seed, action_noise=noise)
    for i in range(len(worlds)):
        part = slice(i, i + 1)
        yield i, Endings(found.outcome[part], found.time_s[part], found.n_reversals[part], found.backed_m[part])


def _sim(study: WidthStudy, agent: Agent) -> str:
    return study.sim if isinstance(agent, PolicyAgent) or study.sim != "planar" else "bullet"


def _blank(study: WidthStudy, name: str, agent: Agent) -> WidthRow:
    weights = code_or_weights(agent)
    return WidthRow(
        agent=name, sim=_sim(study, agent), weights=weights, shape="", sense="", width_m=0.0,
        episodes=0, success=0, collision=0, false_exit=0, timeout=0, stall=0,
    )  # fmt: skip


def _key(row: WidthRow) -> tuple[object, ...]:
    return row.agent, row.sim, row.weights, row.shape, row.sense, row.width_m
