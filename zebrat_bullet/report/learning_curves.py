"""Curves of training runs: what a group of seeds has in common along episodes, steps or hours."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.report.learning_runs import RunGroup, TrainingRun

BLOCK = 20
"""Episodes of which the paper's training curve shows the best, and over which success and return are averaged."""
GRID = 201
PROGRESS = ("success in evaluations", f"success of the last {BLOCK} episodes", f"return of the last {BLOCK} episodes")


@dataclass(frozen=True, slots=True)
class Band:
    """What seeds have in common along an axis.

    Attributes:
        x: (G,) where.
        n_seeds: (G,) seeds that have a value there.
        mean: (G,) of those; NaN where there are none.
        std, low, high: (G,) standard deviation (n - 1), least and greatest; NaN unless all seeds have a value, as a
            spread of those that are left would look like agreement.
    """

    x: NDArray[np.float64]
    n_seeds: NDArray[np.int64]
    mean: NDArray[np.float64]
    std: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Curve:
    """One measure of a group."""

    group: RunGroup
    measure: str
    band: Band


def band(x: NDArray[np.float64], values: Sequence[NDArray[np.float64]]) -> Band:
    """Return mean and spread of one (G,) curve a seed, NaN where that seed has no value."""
    curves = np.array(values)
    has = np.isfinite(curves)
    n = has.sum(axis=0)
    mean = np.where(has, curves, 0.0).sum(axis=0) / np.where(n > 0, n, np.nan)
    whole = curves[:, n == len(curves)]
    spread = np.full((3, len(x)), np.nan)
    if whole.size:
        std = whole.std(axis=0, ddof=1) if len(curves) > 1 else np.zeros(whole.shape[1])
        spread[:, n == len(curves)] = std, whole.min(axis=0), whole.max(axis=0)
    return Band(x, n, mean, *spread)


def _best_of_blocks(run: TrainingRun) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the last episode of every complete block of 20, and the best return in it (paper's training curve)."""
    n = len(run.episodes["return"]) // BLOCK
    return BLOCK * np.arange(1.0, n + 1), run.episodes["return"][: n * BLOCK].reshape(n, BLOCK).max(axis=1)


def _trailing_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of each value and the 19 before it, of fewer at the start."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    end = np.arange(1, len(values) + 1)
    begin = np.maximum(end - BLOCK, 0)
    return (total[end] - total[begin]) / (end - begin)


def at_grid(
    x: NDArray[np.float64], y: NDArray[np.float64], grid: NDArray[np.float64], end: float
) -> NDArray[np.float64]:
    """Return the last of the (N,) values known at each point of a (G,) grid, never one from its future.

    NaN before the first value and after `end`, where the run was over.
    """
    last = np.searchsorted(x, grid, side="right") - 1
    known = (last >= 0) & (grid <= end)
    return np.where(known, y[last] if len(y) else np.nan, np.nan)


def training_curve(groups: Sequence[RunGroup]) -> list[Curve]:
    """Return the paper's training curve of each group: best return in every 20 episodes, over episodes."""
    curves = []
    for group in groups:
        of_seeds = [_best_of_blocks(run) for run in group.runs]
        ends = max((x for x, _ in of_seeds), key=len)
        padded = [np.pad(best, (0, len(ends) - len(best)), constant_values=np.nan) for _, best in of_seeds]
        curves.append(Curve(group, f"best return in {BLOCK} episodes", band(ends, padded)))
    return curves


def progress(groups: Sequence[RunGroup], axis: Literal["steps", "hours"]) -> list[Curve]:
    """Return three curves of each group over environment steps or wall-clock hours, on one grid for all groups.

    Noise-free success in the evaluations; success and mean return of the last 20 training episodes.
    """
    column, unit = ("total_steps", 1.0) if axis == "steps" else ("wall_s", 3600.0)
    grid = np.linspace(0.0, max(_end(run, column) for group in groups for run in group.runs), GRID)
    curves = []
    for group in groups:
        of_seeds: dict[str, list[NDArray[np.float64]]] = {name: [] for name in PROGRESS}
        for run in group.runs:
            episodes, judged = run.episodes, run.evaluations
            known = (
                (judged[column], judged["success"]),
                (episodes[column], _trailing_mean(episodes["outcome"] == "success")),
                (episodes[column], _trailing_mean(episodes["return"])),
            )
            for name, (x, y) in zip(PROGRESS, known, strict=True):
                of_seeds[name].append(at_grid(x, y, grid, _end(run, column)))
        curves += [Curve(group, name, band(grid / unit, values)) for name, values in of_seeds.items()]
    return curves


def _end(run: TrainingRun, column: str) -> float:
    return float(max([*run.episodes[column], *run.evaluations[column]], default=0.0))
