"""The least width of each passage for which the planner finds a drive, by bisection."""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import PlanError
from zebrat_bullet.evaluation.csv_log import CsvLog, read_as
from zebrat_bullet.evaluation.workers import worker_pool
from zebrat_bullet.planning.certify import certify
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world.passage import passage


@dataclass(frozen=True, kw_only=True)
class CertifiedRow:
    """What the planner found in one passage (left turns: a right one is its mirror image).

    Attributes:
        robot: the car.
        shape, width_m: the passage.
        certified: 1 where it found a drive.
        proven: 1 where it found none and proves that there is none.
        reversals, clearance_m: of the drive; 0 where there is none.
        wall_s: what the search took.
    """

    robot: str
    shape: str
    width_m: float
    certified: int
    proven: int
    reversals: int
    clearance_m: float
    wall_s: float


COLUMNS = tuple(field.name for field in fields(CertifiedRow))


def certify_widths(
    shapes: Sequence[str],
    widths_m: Sequence[float],
    task: TaskConfig,
    folder: Path,
    workers: int | None = None,
    on_row: Callable[[CertifiedRow], None] = lambda row: None,
) -> list[CertifiedRow]:
    """Narrow down the least certified width of each shape, and return every width that was asked for, so far.

    Bisection rests on this: what leads through a passage leads through the wider one, which holds it. Only what it asks
    for is searched, and is written at once to `certified.csv`, which a later call goes on with.

    Args:
        shapes: of `SHAPES`.
        widths_m: ascending.
        task: the car and its limits.
        folder: holds `certified.csv`.
        workers: processes; None takes one a core.
        on_row: called with each result.
    """
    log = CsvLog(folder / "certified.csv", COLUMNS)
    with worker_pool(workers, len(shapes)) as pool:
        while True:
            known = read_certified(folder)
            asked = {shape: _next([row for row in known if _is(row, task.robot, shape)], widths_m) for shape in shapes}
            jobs = [pool.submit(_certified, task, shape, at) for shape, at in asked.items() if at is not None]
            if not jobs:
                return [row for row in known if row.robot == task.robot]
            for job in as_completed(jobs):
                log.append(asdict(job.result()))
                on_row(job.result())


def read_certified(folder: Path) -> list[CertifiedRow]:
    """Return the rows of a folder's table of certificates."""
    return list(read_as(CertifiedRow, folder / "certified.csv"))


def bracket(rows: Sequence[CertifiedRow], shape: str) -> tuple[float | None, float | None]:
    """Return the widest width of a shape without a drive, and the least with one above it; None where there is none."""
    without = max((row.width_m for row in rows if row.shape == shape and not row.certified), default=None)
    found = [row.width_m for row in rows if row.shape == shape and row.certified]
    return without, min((width for width in found if without is None or width > without), default=None)


def _is(row: CertifiedRow, robot: str, shape: str) -> bool:
    return row.robot == robot and row.shape == shape


def _next(rows: Sequence[CertifiedRow], widths_m: Sequence[float]) -> float | None:
    """Return the width to ask for next, None once no width lies between one without a drive and one with."""
    without, found = bracket(rows, rows[0].shape) if rows else (None, None)
    between = [w for w in widths_m if (without is None or w > without) and (found is None or w < found)]
    return between[len(between) // 2] if between else None


def _certified(task: TaskConfig, shape: str, width_m: float) -> CertifiedRow:
    began, robot = time.perf_counter(), load_robot(task.robot)
    proven, reversals, clearance_m, certified = 0, 0, 0.0, 0
    try:
        found = certify(passage(shape, width_m, robot=robot), robot, task.physics)
        certified, reversals, clearance_m = 1, found.n_reversals, found.clearance_m
    except PlanError as error:
        proven = int(error.proven)
    return CertifiedRow(
        robot=task.robot,
        shape=shape,
        width_m=width_m,
        certified=certified,
        proven=proven,
        reversals=reversals,
        clearance_m=clearance_m,
        wall_s=round(time.perf_counter() - began, 1),
    )
