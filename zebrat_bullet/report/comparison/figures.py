"""The report's charts, each as an SVG: the same bytes from the same tables."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from zebrat_bullet.detection.summary import PAPER_COUNTS
from zebrat_bullet.report.collision_figures import COLOURS
from zebrat_bullet.report.collisions import LABELS
from zebrat_bullet.report.comparison.evidence import Drive, Evidence
from zebrat_bullet.report.comparison.studies import COUNTED, base_cases
from zebrat_bullet.report.learning_curves import Band
from zebrat_bullet.report.track_figure import EXIT

OUTCOMES = {"success": EXIT, "fail": "#f2b134", "collision": "#c8322b"}
"""Colours; a fail is what ends without success and without contact."""
_PALETTE = matplotlib.color_sequences["tab10"]
_NONE = "#e7ebf1"
_WIDTH_INCH = 4.8
"""Narrow, so that letters are still to be read on a phone."""
_SETTINGS: Any = {"svg.hashsalt": "zebrat", "svg.fonttype": "none", "font.size": 9.0}


def as_svg(figure: Figure) -> bytes:
    """Return a figure as SVG, without a date or random names."""
    out = BytesIO()
    with matplotlib.rc_context(_SETTINGS):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def sheet(n_rows: int, n_columns: int, height_inch: float) -> tuple[Figure, np.ndarray]:
    """Return a figure with so many panels, rows of this height."""
    with matplotlib.rc_context(_SETTINGS):
        figure = Figure(figsize=(_WIDTH_INCH, height_inch * n_rows), layout="constrained")
        FigureCanvasAgg(figure)
        panels: np.ndarray = figure.subplots(n_rows, n_columns, squeeze=False)
    for axes in panels.flat:
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
    return figure, panels


def draw_counts(evidence: Evidence) -> bytes | None:
    """Draw the paper's counts of detected collisions beside ours, each relative to the safety region's."""
    cases = base_cases(evidence, "ghost")
    if not set(PAPER_COUNTS) <= set(cases):
        return None
    groups = {"paper,\nFig. 4c": PAPER_COUNTS}
    for count, word in COUNTED.items():
        groups[f"ours,\n{word}"] = {kind: cases[kind][count] for kind in PAPER_COUNTS}
    figure, panels = sheet(1, 1, 2.9)
    axes = panels[0, 0]
    for g, counts in enumerate(groups.values()):
        for i, kind in enumerate(PAPER_COUNTS):
            share = counts[kind] / max(counts["sr"], 1)
            label = LABELS[kind] if g == 0 else None
            axes.bar(g + 0.27 * (i - 1), share, 0.25, color=COLOURS[kind], label=label)
            axes.text(g + 0.27 * (i - 1), share + 0.02, str(counts[kind]), ha="center", fontsize=7.5)
    axes.set_xticks(range(len(groups)), list(groups))
    axes.set(ylim=(0.0, 1.28), ylabel="reported, relative to SR")
    axes.legend(frameon=False, ncols=3, loc="upper right", fontsize=8)
    return as_svg(figure)


def draw_bands(bands: Mapping[str, Band], x_label: str, y_label: str) -> bytes:
    """Draw one curve a label: mean over seeds, standard deviation, least to greatest."""
    figure, panels = sheet(1, 1, 3.2)
    axes = panels[0, 0]
    for i, (label, at) in enumerate(bands.items()):
        colour = _PALETTE[i % len(_PALETTE)]
        n = int(at.n_seeds.max(initial=0))
        axes.plot(at.x, at.mean, color=colour, linewidth=1.5, label=f"{label}, {n} seed{'s' if n > 1 else ''}")
        axes.fill_between(at.x, at.low, at.high, color=colour, alpha=0.08, linewidth=0)
        axes.fill_between(at.x, at.mean - at.std, at.mean + at.std, color=colour, alpha=0.2, linewidth=0)
    axes.set(xlabel=x_label, ylabel=y_label)
    if "success" in y_label:
        axes.set_ylim(-0.03, 1.03)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8)
    return as_svg(figure)


def draw_outcomes(parts: Mapping[str, Mapping[str, Sequence[Drive]]], n_columns: int = 2) -> bytes:
    """Draw a panel a place with a bar a method: success, fail and collision; hatched where nothing was driven."""
    n_rows = -(-len(parts) // n_columns)
    methods = list(next(iter(parts.values())))
    figure, panels = sheet(n_rows, n_columns, 0.55 + 0.19 * len(methods))
    for axes in panels.flat[len(parts) :]:
        axes.set_axis_off()
    for i, (axes, (place, of_method)) in enumerate(zip(panels.flat, parts.items(), strict=False)):
        for row, drives in enumerate(of_method.values()):
            if drives:
                _stack(axes, row, drives)
            else:
                axes.barh(row, 1.0, 0.7, color="white", edgecolor=_NONE, hatch="////", linewidth=0)
        axes.set_title(place, fontsize=9)
        axes.set(xlim=(0.0, 1.0), ylim=(len(methods) - 0.5, -0.5))
        axes.set_yticks(range(len(methods)), methods if i % n_columns == 0 else [""] * len(methods))
        axes.set_xticks([0.0, 0.5, 1.0], ["0", "50", "100 %"])
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
    handles = [panels.flat[0].barh(0, 0, color=colour, label=name) for name, colour in OUTCOMES.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return as_svg(figure)


def _stack(axes: Axes, row: int, drives: Sequence[Drive]) -> None:
    left = 0.0
    for name, colour in OUTCOMES.items():
        share = sum(outcome_of(drive) == name for drive in drives) / len(drives)
        axes.barh(row, share, 0.7, left=left, color=colour)
        left += share


def outcome_of(drive: Drive) -> str:
    """Return which of the paper's three outcomes a drive had."""
    return drive.outcome if drive.outcome in ("success", "collision") else "fail"


def draw_intervals(rows: Mapping[str, tuple[float, float, float, Sequence[float]]], x_label: str) -> bytes:
    """Draw a row a label: a value with its interval, and the values that it is of as small dots."""
    figure, panels = sheet(1, 1, 0.8 + 0.24 * len(rows))
    axes = panels[0, 0]
    for i, (value, low, high, each) in enumerate(rows.values()):
        axes.plot([low, high], [i, i], color=_PALETTE[0], linewidth=4, alpha=0.35, solid_capstyle="butt")
        axes.plot(each, np.full(len(each), i), "|", color=_PALETTE[0], markersize=7)
        axes.plot(value, i, "o", color=_PALETTE[0], markersize=5)
    axes.set_yticks(range(len(rows)), list(rows))
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(-0.03, 1.03), xlabel=x_label)
    axes.grid(alpha=0.25, axis="x")
    return as_svg(figure)


def draw_seed_lines(parts: Mapping[str, Mapping[str, Sequence[float]]], x_label: str) -> bytes:
    """Draw a line a label over categories: the mean of some values, one a seed, and from least to greatest."""
    figure, panels = sheet(1, 1, 3.2)
    axes = panels[0, 0]
    names = list(dict.fromkeys(name for of_label in parts.values() for name in of_label))
    for i, (label, of_label) in enumerate(parts.items()):
        at = [names.index(name) + 0.07 * (i - (len(parts) - 1) / 2) for name in of_label]
        mean = np.array([np.mean(values) for values in of_label.values()])
        spread = np.array([(np.min(values), np.max(values)) for values in of_label.values()]).T
        colour = _PALETTE[i % len(_PALETTE)]
        axes.errorbar(at, mean, np.abs(spread - mean), fmt="o-", color=colour, markersize=3.5, lw=1.2, label=label)
    axes.set_xticks(range(len(names)), names)
    axes.set(ylim=(-0.03, 1.03), xlabel=x_label, ylabel="success")
    axes.grid(alpha=0.25, axis="y")
    figure.legend(loc="outside upper center", ncols=2, frameon=False, fontsize=8)
    return as_svg(figure)


def draw_spreads(measures: Mapping[str, Mapping[str, Sequence[float]]]) -> bytes:
    """Draw a panel a measure and a box a method: quartiles, and from the 5th to the 95th hundredth."""
    methods = list(next(iter(measures.values())))
    figure, panels = sheet(len(measures), 1, 0.7 + 0.2 * len(methods))
    for axes, (measure, of_method) in zip(panels[:, 0], measures.items(), strict=True):
        at = [(i, values) for i, values in enumerate(of_method.values()) if len(values)]
        if at:
            axes.boxplot(
                [values for _, values in at],
                positions=[i for i, _ in at],
                orientation="horizontal",
                whis=(5.0, 95.0),
                showfliers=False,
                widths=0.6,
                patch_artist=True,
                boxprops={"facecolor": "#cfe0ec", "edgecolor": "#2a6f97"},
                medianprops={"color": "#22303f"},
                whiskerprops={"color": "#2a6f97"},
                capprops={"color": "#2a6f97"},
                manage_ticks=False,
            )
        axes.set_yticks(range(len(methods)), methods)
        axes.set_title(measure, fontsize=9)
        axes.set(ylim=(len(methods) - 0.5, -0.5))
        axes.grid(alpha=0.25, axis="x")
    return as_svg(figure)
