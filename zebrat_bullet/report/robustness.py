"""Success over each disturbance: the figure of small multiples, and the tables."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from zebrat_bullet.evaluation.axes import AXIS_NAMES, EVERYTHING, NOMINAL, is_everything, label_of, nominal_of
from zebrat_bullet.evaluation.metrics import wilson_interval
from zebrat_bullet.evaluation.robustness import RobustnessRow
from zebrat_bullet.report.labels import agent_labels
from zebrat_bullet.task.episode import OUTCOMES

_COLUMNS = 5


def summarise(rows: Sequence[RobustnessRow]) -> dict[str, Any]:
    """Return how every agent did on every axis, all worlds together and each.

    Returns:
        By axis, by label of the agent, a list of levels, ascending, the undisturbed one among them: `level`,
        `episodes`, `causes` (their number by outcome), `rate` of success and its 95 % Wilson interval `low` and `high`,
        and the same of each of `worlds`.
    """
    labels = _labels(rows)
    summary: dict[str, Any] = {}
    for axis in dict.fromkeys((*AXIS_NAMES, *(row.axis for row in rows if row.axis != NOMINAL))):
        found: dict[str, dict[float, list[RobustnessRow]]] = {}
        for row in rows:
            if row.axis == axis:
                found.setdefault(labels[row], {}).setdefault(row.level, []).append(row)
        for label, levels in found.items():
            nominal = [row for row in rows if row.axis == NOMINAL and labels[row] == label]
            if nominal:
                levels[nominal_of(axis)] = nominal
            summary.setdefault(axis, {})[label] = [_pooled(level, levels[level]) for level in sorted(levels)]
    return summary


def _pooled(level: float, rows: Sequence[RobustnessRow]) -> dict[str, Any]:
    worlds = {
        world: _counted([row for row in rows if row.world == world]) for world in {row.world: None for row in rows}
    }
    return {"level": level} | _counted(rows) | {"worlds": worlds}


def _counted(rows: Sequence[RobustnessRow]) -> dict[str, Any]:
    n = sum(row.episodes for row in rows)
    causes = {str(each): sum(getattr(row, str(each)) for row in rows) for each in OUTCOMES}
    low, high = wilson_interval(causes["success"], n)
    return {"episodes": n, "rate": causes["success"] / n, "low": low, "high": high, "causes": causes}


def _labels(rows: Sequence[RobustnessRow]) -> dict[RobustnessRow, str]:
    """Return what each row's agent is called; weights are named where a name alone would say two things."""
    weights: dict[str, set[str]] = {}
    margins = {row.supervised for row in rows if row.supervised}
    for row in rows:
        weights.setdefault(row.agent, set()).add(row.weights)
    called, labels = agent_labels(weights), {}
    for row in rows:
        label = called[row.agent]
        if len(weights[row.agent]) > 1:
            label += f" {row.weights}"
        if row.supervised:
            label += ", supervised" + (f" at {row.supervised} m" if len(margins) > 1 else "")
        labels[row] = label
    return labels


def robustness_table(summary: Mapping[str, Any]) -> str:
    """Return a row an axis and level, a column an agent: success in % with its interval, contacts if there were any."""
    agents = list(dict.fromkeys(label for of_axis in summary.values() for label in of_axis))
    rows = [f"| axis | level | {' | '.join(agents)} |", "|---" * (len(agents) + 2) + "|"]
    for axis, of_axis in summary.items():
        at = {(label, each["level"]): each for label, levels in of_axis.items() for each in levels}
        for level in sorted({level for _, level in at}):
            cells = [_cell(at.get((label, level))) for label in agents]
            nominal = " (nominal)" if level == nominal_of(axis) else ""
            rows.append(f"| {label_of(axis)} | {level:g}{nominal} | {' | '.join(cells)} |")
    return "\n".join(rows)


def everything_table(summary: Mapping[str, Any]) -> str:
    """Return a row an agent, scale of "everything" and world, and one for all worlds."""
    rows = [
        "| agent | everything within | world | success | 95 % interval | contacts | other fails |",
        "|---|---|---|---|---|---|---|",
    ]
    everything = {axis: of_axis for axis, of_axis in summary.items() if is_everything(axis)}
    for axis, label, levels in (
        (axis, label, levels) for axis, at in everything.items() for label, levels in at.items()
    ):
        for each in levels:
            within = "nominal" if each["level"] == 0 else f"±{each['level']:.0%}{axis.removeprefix(EVERYTHING)}"
            for world, at in (each["worlds"] | {"all": each}).items():
                causes = at["causes"]
                other = ", ".join(f"{causes[c]} {c}" for c in ("false_exit", "timeout", "stall") if causes[c]) or "-"
                rows.append(
                    f"| {label} | {within} | {world} | {causes['success']} of {at['episodes']} "
                    f"| {at['low']:.1%}-{at['high']:.1%} | {causes['collision']} | {other} |"
                )
    return "\n".join(rows)


def draw_robustness(summary: Mapping[str, Any], path: Path) -> None:
    """Draw success over the level of each axis, a panel an axis, a line with its 95 % band an agent (PNG, SVG, PDF)."""
    agents = list(dict.fromkeys(label for of_axis in summary.values() for label in of_axis))
    colours = {label: f"C{i}" for i, label in enumerate(agents)}
    n_columns = min(_COLUMNS, len(summary))
    n_rows = math.ceil(len(summary) / n_columns)
    figure = Figure(figsize=(2.9 * n_columns + 0.4, 2.4 * n_rows + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(n_rows, n_columns, squeeze=False, sharey=True)
    for panel in panels.flat[len(summary) :]:
        panel.set_axis_off()
    for panel, (axis, of_axis) in zip(panels.flat, summary.items(), strict=False):
        _draw_axis(panel, axis, of_axis, colours)
    for panel in panels[:, 0]:
        panel.set_ylabel("success")
    handles = [panels.flat[0].plot([], [], "o-", color=colour, label=label)[0] for label, colour in colours.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(agents), 6), frameon=False)
    figure.savefig(path, dpi=110)


def _draw_axis(axes: Axes, axis: str, of_axis: Mapping[str, Any], colours: Mapping[str, str]) -> None:
    axes.axvline(nominal_of(axis), color="#bbbbbb", linestyle=":", linewidth=1.0, zorder=0)
    for i, (label, levels) in enumerate(of_axis.items()):
        at, rate, low, high = np.array([[each[k] for k in ("level", "rate", "low", "high")] for each in levels]).T
        axes.fill_between(at, low, high, color=colours[label], alpha=0.1, linewidth=0)
        # Where lines lie on one another, those below stand out.
        axes.plot(at, rate, "o-", markersize=2.8, linewidth=1.2 + 0.8 * (len(of_axis) - 1 - i), color=colours[label])
    axes.set(ylim=(-0.03, 1.03))
    axes.set_title(label_of(axis), fontsize=9)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def _cell(at: Mapping[str, Any] | None) -> str:
    if at is None:
        return "-"
    contacts = at["causes"]["collision"]
    return f"{at['rate']:.0%} ({at['low']:.0%}-{at['high']:.0%})" + (f", {contacts} contacts" if contacts else "")
