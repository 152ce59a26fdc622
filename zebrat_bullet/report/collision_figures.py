"""The study of representations as figures: the counts, where on the body contacts are missed, and what was varied."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from zebrat_bullet.detection.cases import Case
from zebrat_bullet.detection.representations import KINDS, region_of
from zebrat_bullet.detection.study import Tally
from zebrat_bullet.detection.summary import (
    COUNTS,
    PAPER_COUNTS,
    Results,
    base_cases,
    base_tallies,
    event_counts,
    relative_difference,
    summarise,
)
from zebrat_bullet.report.collisions import LABELS
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.beams import beam_bearings

COLOURS = {"sr": "#2a6f97", "firect": "#e07a3f", "fifr": "#7b5ea7", "cloud": "#7d8a97"}
_ALARM_SCALE = 20.0
_SCATTER_M = 0.02
_SEEN, _LATE, _MISSED = "#b9c4cf", "#f2b134", "#c8322b"


def draw_counts(results: Results, path: Path) -> None:
    """Draw the paper's bar chart beside ours, each count relative to the safety region's (PNG, SVG or PDF).

    Ours are those of ghost walls, if they were driven: solid ones stop the car before there is anything to see.
    """
    driven = list(dict.fromkeys(walls for walls, _ in results))
    groups = [("ghost" if "ghost" in driven else driven[0], count) for count in COUNTS]
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for i, (kind, count) in enumerate(PAPER_COUNTS.items()):
        share = count / PAPER_COUNTS["sr"]
        axes.bar(0.25 * (i - 1), share, 0.23, color=COLOURS[kind], label=LABELS[kind])
        axes.text(0.25 * (i - 1), share + 0.02, str(count), ha="center", fontsize=8)
    for g, (walls, name) in enumerate(groups, start=1):
        tallies = base_tallies(results, walls)
        for i, kind in enumerate(PAPER_COUNTS):
            difference, low, high = relative_difference(tallies[kind], tallies["sr"], name)
            spread = [[difference - low], [high - difference]] if kind != "sr" else None
            at = g + 0.25 * (i - 1)
            axes.bar(at, 1.0 + difference, 0.23, color=COLOURS[kind], yerr=spread, error_kw={"lw": 1, "capsize": 2})
            axes.text(
                at,
                1.03 + max(difference, high),
                f"{event_counts(tallies[kind], name).sum():.0f}",
                ha="center",
                fontsize=8,
            )
    said = {
        "in_time": "contacts\nin time",
        "within_1_s": "contacts\nwithin 1 s",
        "overlap_reports": "sweeps\nin collision",
    }
    labels = ["paper,\nFig. 4c", *(f"{walls} walls,\n{said[name]}" for walls, name in groups)]
    axes.set_xticks(range(len(labels)), labels, fontsize=9)
    axes.set_ylabel("reported, relative to SR")
    _finish(axes)
    axes.set_ylim(0.0, 1.25)
    axes.legend(frameon=False, ncols=3, loc="upper right")
    figure.savefig(path, dpi=130)


def draw_misses(results: Results, robot: str, path: Path) -> None:
    """Draw every contact where it met the body: seen in time, seen late, missed; a row a kind of walls."""
    kinds_of_walls = list(dict.fromkeys(walls for walls, _ in results))
    model = load_robot(robot)
    outline = model.footprint_base
    span = np.ptp(outline, axis=0)
    figure = Figure(
        figsize=(3.3 * len(KINDS), 3.3 * span[1] / span[0] * len(kinds_of_walls) + 1.4), layout="constrained"
    )
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(kinds_of_walls), len(KINDS), squeeze=False)
    for row, walls in zip(grid, kinds_of_walls, strict=True):
        for axes, (kind, tally) in zip(row, base_tallies(results, walls).items(), strict=True):
            at = np.array([(event.contact_x, event.contact_y) for event in tally.events])
            at += np.random.default_rng(0).normal(0.0, _SCATTER_M, at.shape)  # most lie on one another, at a corner
            late = np.isfinite(tally.lead_s) & ~tally.in_time
            missed = ~np.isfinite(tally.lead_s)
            axes.add_patch(Polygon(outline, closed=True, fc="#f4f6f8", ec="#2f3b4c"))
            for chosen, colour in ((tally.in_time, _SEEN), (late, _LATE), (missed, _MISSED)):
                axes.scatter(*at[chosen].T, s=5, color=colour, linewidths=0, alpha=0.6, zorder=3)
            if kind != "cloud":
                _draw_rays(axes, base_cases(results)[kind], robot)
            share = f"in time {tally.in_time.mean():.0%}, late {late.mean():.0%}, missed {missed.mean():.0%}"
            axes.set_title(f"{LABELS[kind]}, {walls} walls\n{share}", fontsize=9)
            (low_x, low_y), (high_x, high_y) = outline.min(axis=0) - 0.08, outline.max(axis=0) + 0.08
            axes.set(aspect="equal", xlim=(low_x, high_x + 0.15), ylim=(low_y, high_y))  # FIFR reaches past the nose
            axes.axis("off")
    handles = [
        grid[0][0].scatter([], [], color=colour, label=name)
        for colour, name in ((_SEEN, "reported in time"), (_LATE, "reported within 1 s"), (_MISSED, "missed"))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    figure.savefig(path, dpi=130)


def _draw_rays(axes: Axes, case: Case, robot: str) -> None:
    n_bearings = case.sensing.lidar.n_bearings
    region = region_of(case.representation, robot, n_bearings)
    bearings = beam_bearings(n_bearings)[region.indices]
    mount = load_robot(robot).lidar_xyz_base[:2]
    ends = mount + region.range_m[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    for end in ends:
        axes.plot(*np.array([mount, end]).T, color=COLOURS[case.representation.kind], lw=0.5, alpha=0.5, zorder=1)


_SWEEPS: dict[str, tuple[str, Callable[[Case], float]]] = {
    "margin": ("margin, cm", lambda case: 100.0 * case.representation.margin_m),
    "rays": ("number of rays", lambda case: case.representation.n_rays),
    "rate": ("sweeps a second", lambda case: case.sensing.rate_hz),
    "resolution": ("bearings of the scan", lambda case: case.sensing.lidar.n_bearings),
    "noise": ("range noise, sigma in cm", lambda case: 100.0 * case.sensing.noise.range_sigma_m),
}
"""By panel: the axis label, and where a case lies on the axis."""


def draw_sweeps(results: Results, path: Path) -> None:
    """Draw recall, and false alarms a minute, over what was varied (if anything was), a column a kind of walls."""
    columns = list(dict.fromkeys(walls for walls, _ in results))
    margins = {
        panel: [None]
        if panel == "margin"
        else sorted({c.representation.margin_m for _, c in results if c.panel == panel})
        for panel in _SWEEPS
        if any(case.panel == panel for _, case in results)
    }
    rows = [(panel, margin) for panel, of_panel in margins.items() for margin in of_panel]
    if not rows:
        return
    figure = Figure(figsize=(4.6 * len(columns), 2.8 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), len(columns), squeeze=False)
    for line, (panel, margin) in zip(grid, rows, strict=True):
        for axes, walls in zip(line, columns, strict=True):
            chosen = {
                case: tally
                for (w, case), tally in results.items()
                if (w, case.panel) == (walls, panel) and margin in (None, case.representation.margin_m)
            }
            _draw_sweep(axes, chosen, panel)
            axes.set_title(f"{walls} walls" + ("" if margin is None else f", margin {100 * margin:g} cm"), fontsize=10)
    grid.flat[0].legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)


def _draw_sweep(axes: Axes, cases: Mapping[Case, Tally], panel: str) -> None:
    label, value = _SWEEPS[panel]
    lasting = [case for case in cases if panel != "noise" or case.sensing.noise.dropout == 0.0]
    for kind in KINDS:
        chosen = sorted((value(case), case.setting) for case in lasting if case.representation.kind == kind)
        at = {case.setting: summarise(cases[case]) for case in lasting if case.representation.kind == kind}
        if not chosen:
            continue
        x, each = [place for place, _ in chosen], [at[setting] for _, setting in chosen]
        low, high = zip(*(one.recall_ci for one in each), strict=True)
        axes.plot(x, [one.recall for one in each], "-", color=COLOURS[kind], label=LABELS[kind])
        axes.fill_between(x, low, high, color=COLOURS[kind], alpha=0.15)
        rate = [one.false_alarms / max(one.clear_minutes, 1e-9) for one in each]
        axes.plot(x, np.array(rate) / _ALARM_SCALE, ":", color=COLOURS[kind], lw=1)
    axes.plot([], [], ":", color="#555", label=f"false alarms, {_ALARM_SCALE:g} a minute = 1")
    if panel in ("rays", "resolution"):
        axes.set_xscale("log", base=2)
        axes.set_xticks(x, [f"{place:g}" for place in x], fontsize=7)
    axes.set(xlabel=label, ylabel="reported in time", ylim=(-0.02, 1.02))
    _finish(axes)


def _finish(axes: Axes) -> None:
    axes.grid(alpha=0.25, axis="y")
    axes.spines[["top", "right"]].set_visible(False)
