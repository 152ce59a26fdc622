"""The learning curve of a training run, from the tables in its folder."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.csv_log import read_rows
from zebrat_bullet.files import refusing
from zebrat_bullet.report.learning_curves import BLOCK


def draw_learning_curve(folder: Path, path: Path) -> None:
    """Draw the best and mean return and the success of every 20 episodes, and the noise-free evaluations (PNG).

    Args:
        folder: the run folder.
        path: the picture to write.
    """
    with refusing(folder, ZebratError, "its tables are not those of a run", "restore them, or begin the run anew"):
        _draw(read_rows(folder / "episodes.csv"), read_rows(folder / "evaluations.csv"), path)


def _draw(episodes: list[dict[str, str]], evaluations: list[dict[str, str]], path: Path) -> None:
    figure = Figure(figsize=(8, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    top, bottom = figure.subplots(2, 1, sharex=True)
    returns = np.array([float(row["return"]) for row in episodes])
    success = np.array([row["outcome"] == "success" for row in episodes], dtype=float)
    starts = np.arange(0, len(returns), BLOCK)
    middles = [min(start + BLOCK, len(returns)) for start in starts]
    top.plot(middles, [returns[s : s + BLOCK].max() for s in starts], label=f"best of {BLOCK} episodes")
    top.plot(middles, [returns[s : s + BLOCK].mean() for s in starts], label=f"mean of {BLOCK} episodes", alpha=0.6)
    top.set_ylabel("return")
    bottom.plot(middles, [success[s : s + BLOCK].mean() for s in starts], label="success while exploring")
    bottom.plot(
        [int(row["episode"]) for row in evaluations],
        [float(row["success"]) for row in evaluations],
        "o-",
        markersize=3,
        label="success in evaluations",
    )
    bottom.set(ylabel="success rate", xlabel="episode", ylim=(-0.03, 1.03))
    for axes in (top, bottom):
        axes.grid(alpha=0.25)
        axes.legend(frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)
