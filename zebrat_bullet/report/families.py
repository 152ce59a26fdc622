"""Success by policy and family: a table, and a heat map."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from zebrat_bullet.evaluation.families import FamilyScore

Scores = Mapping[str, Mapping[str, FamilyScore]]


def families_table(scores: Scores) -> str:
    """Return a row an agent, a column a family: success in % of all tracks / of the worst tenth, mean reversals."""
    families = list(next(iter(scores.values())))
    rows = [f"| agent | {' | '.join(families)} |", "|---" * (len(families) + 1) + "|"]
    return "\n".join([*rows, *(f"| {agent} | {' | '.join(map(_cell, of.values()))} |" for agent, of in scores.items())])


def _cell(at: FamilyScore) -> str:
    reversals = "-" if at.reversals is None else f"{at.reversals:.1f}"
    return f"{100 * at.score.success:.1f} / {100 * at.score.worst_tenth:.0f}, {reversals}"


def draw_families(scores: Scores, path: Path) -> None:
    """Draw success in % as a heat map, a row an agent, a column a family (PNG, SVG or PDF)."""
    families = list(next(iter(scores.values())))
    percent = np.array([[100.0 * at.score.success for at in of.values()] for of in scores.values()])
    figure = Figure(figsize=(1.6 + 0.75 * len(families), 1.5 + 0.38 * len(scores)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.imshow(percent, vmin=0.0, vmax=100.0, cmap="viridis", aspect="auto")
    axes.set_xticks(range(len(families)), families, rotation=35, ha="right")
    axes.set_yticks(range(len(scores)), [Path(agent).name for agent in scores])
    axes.set_xlabel("judged on")
    axes.set_ylabel("policy")
    for (row, column), value in np.ndenumerate(percent):
        axes.text(
            column, row, f"{value:.0f}", ha="center", va="center", fontsize=8, color="black" if value > 60 else "white"
        )
    figure.savefig(path, dpi=150)
