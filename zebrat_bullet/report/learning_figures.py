"""Training runs as figures: curves with their spread over seeds, and what was reached with its interval."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from zebrat_bullet.report.learning_curves import Curve

_PALETTE = matplotlib.color_sequences["tab10"]
_REACHED = {"best_success": "best policy", "last_success": "policy at the end"}


def draw_curves(curves: Sequence[Curve], x_label: str, path: Path) -> None:
    """Draw a column of panels a reward and a row a measure: returns of different rewards cannot be compared (PNG).

    The line is the mean, the dark band the standard deviation, the light one least to greatest. Where a seed has ended
    or has no value yet there is no band, and the line, of the seeds that are left, is dashed.
    """
    rewards = list(dict.fromkeys(curve.group.reward for curve in curves))
    measures = list(dict.fromkeys(curve.measure for curve in curves))
    figure, panels = _panels(len(measures), len(rewards))
    colours = _colours([curve.group.label for curve in curves])
    for curve in curves:
        axes = panels[measures.index(curve.measure), rewards.index(curve.group.reward)]
        _draw_band(axes, curve, colours[curve.group.label])
    for row, measure in zip(panels, measures, strict=True):
        for axes, reward in zip(row, rewards, strict=True):
            axes.set(title=f"{reward}" if axes in panels[0] else "", ylabel=measure)
            if "success" in measure:
                axes.set_ylim(-0.03, 1.03)
    for axes in panels[0]:
        axes.legend(frameon=False, fontsize="small")
    for axes in panels[-1]:
        axes.set_xlabel(x_label)
    figure.savefig(path, dpi=120)


def draw_reached(summaries: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw each group's success in evaluations: interquartile mean and mean with their intervals (PNG)."""
    figure, panels = _panels(1, len(_REACHED), height=1.2 + 0.45 * len(summaries))
    names = [f"{at['algo']} {at['reward']} {at['variant']}" for at in summaries]
    y = np.arange(len(names))
    for axes, (key, title) in zip(panels[0], _REACHED.items(), strict=True):
        for shift, marker, name, label in ((-0.12, "o", "iqm", "interquartile mean"), (0.12, "D", "mean", "mean")):
            colour = _PALETTE[0 if name == "iqm" else 1]
            for at, height in zip(summaries, y + shift, strict=True):
                if (interval := at[key][f"{name}_ci"]) is not None:
                    axes.plot(interval, [height, height], color=colour, linewidth=2, alpha=0.6)
            centres = [np.nan if at[key][name] is None else at[key][name] for at in summaries]
            axes.plot(centres, y + shift, marker, color=colour, markersize=5, label=label)
        axes.set(
            title=title, xlabel="success in evaluations, 95 % over seeds", xlim=(-0.03, 1.03), ylim=(len(y) - 0.5, -0.5)
        )
        axes.set_yticks(y, names if axes is panels[0, 0] else [""] * len(names))
    panels[0, 0].legend(frameon=False, fontsize="small")
    figure.savefig(path, dpi=120)


def _panels(n_rows: int, n_columns: int, height: float = 3.2) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(max(5.2 * n_columns, 7.0), height * n_rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels: np.ndarray = figure.subplots(n_rows, n_columns, squeeze=False, sharex="col")
    for axes in panels.flat:
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, panels


def _colours(labels: Sequence[str]) -> dict[str, Any]:
    return {label: _PALETTE[i % len(_PALETTE)] for i, label in enumerate(dict.fromkeys(labels))}


def _draw_band(axes: Axes, curve: Curve, colour: Any) -> None:
    band, n = curve.band, len(curve.group.runs)
    whole = band.n_seeds == n
    label = f"{curve.group.label}, {n} seed{'s' if n > 1 else ''}"
    axes.plot(band.x, np.where(whole, band.mean, np.nan), color=colour, label=label)
    axes.plot(band.x, np.where(whole, np.nan, band.mean), color=colour, linestyle=":", linewidth=1)
    if n > 1:
        axes.fill_between(band.x, band.low, band.high, color=colour, alpha=0.08, linewidth=0)
        axes.fill_between(band.x, band.mean - band.std, band.mean + band.std, color=colour, alpha=0.2, linewidth=0)
