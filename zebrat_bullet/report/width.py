"""Success over the width of a passage: the figure, the table, and the least widths that agents master."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.evaluation.certified_width import CertifiedRow, bracket
from zebrat_bullet.evaluation.swept_width import one_sweep_width_m, rigid_width_m
from zebrat_bullet.evaluation.width import MASTERED, WidthRow, mastered_m, pooled
from zebrat_bullet.report.labels import SIMS, agent_labels
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world.passage import SHAPES

_TITLES = {"straight": "straight", "45": "45° corner", "90": "90° corner", "180": "U-turn"}
_BOUNDS = {
    "rigid_m": ("least for a rectangle of its size, however it moves", "#999999", ":"),
    "certified_m": ("a drive is certified", "#222222", "-"),
    "one_sweep_m": ("one forward sweep at full lock", "#999999", "--"),
}
_MARKERS = dict(zip(SHAPES, "osDv", strict=True))


def summarise(rows: Sequence[WidthRow], certified: Sequence[CertifiedRow], task: TaskConfig) -> dict[str, Any]:
    """Return what the car's geometry allows, and what each agent masters, by shape.

    Returns:
        `bounds` by shape: `rigid_m` and `one_sweep_m` (`evaluation.swept_width`), `certified_m` and `not_certified_m`
        (the least certified width, and the widest below it for which no drive was found; None where none was asked
        for). `agents` by label and shape: `mastered_m` (None where not even the widest is), `widths` (how many were
        driven, `least_driven_m` and `widest_driven_m` of them), `success` by width with its 95 % interval.
    """
    robot = load_robot(task.robot)
    bounds = {}
    for shape in SHAPES:
        without, found = bracket(certified, shape)
        bounds[shape] = {
            "rigid_m": rigid_width_m(shape, robot),
            "one_sweep_m": one_sweep_width_m(shape, robot, task.physics),
            "certified_m": found,
            "not_certified_m": without,
        }
    agents: dict[str, Any] = {}
    for label, of_agent in _by_agent(rows).items():
        agents[label] = {}
        for shape in SHAPES:
            driven = [row for row in of_agent if row.shape == shape]
            if driven:
                success = pooled(driven)
                agents[label][shape] = {
                    "mastered_m": mastered_m(driven),
                    "widths": len(success),
                    "least_driven_m": min(success),
                    "widest_driven_m": max(success),
                    "success": {f"{width:.3f}": values for width, values in success.items()},
                }
    return {"car_width_m": float(np.ptp(robot.footprint_base[:, 1])), "bounds": bounds, "agents": agents}


def width_table(summary: Mapping[str, Any]) -> str:
    """Return a row an agent and a bound, a column a shape, widths in m; says where an agent drove only part of them."""
    rows = [f"| least width, m | {' | '.join(_TITLES[shape] for shape in SHAPES)} |", "|---" * (len(SHAPES) + 1) + "|"]
    bounds = summary["bounds"]
    for name, (label, *_) in _BOUNDS.items():
        cells = [_bound(bounds[shape], name) for shape in SHAPES]
        rows.append(f"| {label} | {' | '.join(cells)} |")
    agents = summary["agents"]
    widest = max((at["widest_driven_m"] for shapes in agents.values() for at in shapes.values()), default=0.0)
    for label, shapes in agents.items():
        cells = ["-" if shape not in shapes else _mastered(shapes[shape], widest) for shape in SHAPES]
        rows.append(f"| {label}, {MASTERED:.0%} success | {' | '.join(cells)} |")
    return "\n".join(rows)


def draw_width(summary: Mapping[str, Any], path: Path) -> None:
    """Draw success against width, a panel a shape, and below the least widths side by side (PNG, SVG or PDF)."""
    agents = summary["agents"]
    colours = {label: f"C{i}" for i, label in enumerate(agents)}
    figure = Figure(figsize=(13.0, 5.4 + 0.28 * len(agents)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, len(SHAPES), height_ratios=[3.2, 1.2 + 0.28 * len(agents)])
    panel = None
    for column, shape in enumerate(SHAPES):
        panel = figure.add_subplot(grid[0, column], sharex=panel, sharey=panel)
        _draw_shape(panel, summary, shape, colours, first=column == 0)
    _draw_least(figure.add_subplot(grid[1, :]), summary, colours)
    figure.savefig(path, dpi=130)


def _draw_shape(axes: Axes, summary: Mapping[str, Any], shape: str, colours: Mapping[str, Any], first: bool) -> None:
    for name, (_, colour, style) in _BOUNDS.items():
        if (at := summary["bounds"][shape][name]) is not None:
            axes.axvline(at, color=colour, linestyle=style, linewidth=1.2, zorder=1)
    for label, shapes in summary["agents"].items():
        if shape in shapes:
            success = shapes[shape]["success"]
            widths = np.array(list(success), dtype=float)
            mean, low, high = np.array(list(success.values())).T
            axes.fill_between(widths, low, high, color=colours[label], alpha=0.15, linewidth=0)
            axes.plot(widths, mean, "o-", markersize=2.5, linewidth=1.4, color=colours[label])
    axes.axhline(MASTERED, color="#bbbbbb", linewidth=0.8, zorder=0)
    axes.set(title=_TITLES[shape], xlabel="width of the passage, m", ylim=(-0.03, 1.03))
    axes.spines[["top", "right"]].set_visible(False)
    if first:
        axes.set_ylabel("success, both senses, 95 % interval")


def _draw_least(axes: Axes, summary: Mapping[str, Any], colours: Mapping[str, Any]) -> None:
    lines = [
        (label, colour, {s: summary["bounds"][s][name] for s in SHAPES}) for name, (label, colour, _) in _BOUNDS.items()
    ]
    for label, shapes in summary["agents"].items():
        lines.append(
            (f"{label}, from {MASTERED:.0%}", colours[label], {s: at["mastered_m"] for s, at in shapes.items()})
        )
    for i, (_, colour, of_line) in enumerate(lines):
        axes.axhline(-i, color="#eeeeee", linewidth=0.8, zorder=0)
        for j, (shape, at) in enumerate(of_line.items()):
            if at is not None:
                axes.plot(at, -i + 0.18 * (1.5 - j), _MARKERS[shape], color=colour, markersize=6)
    axes.set_yticks([-i for i in range(len(lines))], [label for label, *_ in lines], fontsize=8)
    for text, (_, colour, _) in zip(axes.get_yticklabels(), lines, strict=True):
        text.set_color(colour)
    for shape, marker in _MARKERS.items():
        axes.plot([], [], marker, color="#555555", label=_TITLES[shape])
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.set(xlabel="least width, m")
    axes.spines[["top", "right", "left"]].set_visible(False)


def _by_agent(rows: Sequence[WidthRow]) -> dict[str, list[WidthRow]]:
    """Return the rows by agent; simulator and weights are named where a name alone would say two things."""
    weights: dict[str, set[str]] = {}
    for row in rows:
        weights.setdefault(row.agent, set()).add(row.weights)
    labels = agent_labels(weights)
    found: dict[str, list[WidthRow]] = {}
    for row in rows:
        parts = [labels[row.agent], SIMS[row.sim]]
        if len(weights[row.agent]) > 1:
            parts.append(row.weights)
        found.setdefault(" ".join(parts), []).append(row)
    return found


def _bound(at: Mapping[str, float | None], name: str) -> str:
    if at[name] is None:
        return "-"
    narrowest = name == "certified_m" and at["not_certified_m"] is None
    return ("at most " if narrowest else "") + f"{at[name]:.3f}"


def _mastered(at: Mapping[str, Any], widest: float) -> str:
    least = at["mastered_m"]
    if least is None:
        return "none"
    below = "at most " if least == at["least_driven_m"] else ""
    above = f" (driven to {at['widest_driven_m']:.3f})" if at["widest_driven_m"] < widest else ""
    return f"{below}{least:.3f}{above}"
