"""A figure of worlds that cannot be driven yet, with axes: where are the walls, and where would the car stand?"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from zebrat_bullet.geometry import to_world
from zebrat_bullet.report.track_figure import CAR, EXIT, WALL, patch
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.free_start import free_start
from zebrat_bullet.world.validate import stands_free
from zebrat_bullet.world.world import World

_FREE, _UNKNOWN = "#7a4fd0", "#f1d9a7"
_INCHES, _MARGIN_M = 9.0, 1.0


def draw_sketches(worlds: Sequence[World], path: Path, footprint: NDArray[np.float64]) -> None:
    """Draw worlds one below the other, each with axes in m, the car where its file starts it, and where it would fit.

    Args:
        worlds: what there is of them; nothing is checked.
        path: the picture to write.
        footprint: (K, 2) outline of the car in its base frame, m.
    """
    figure = Figure(figsize=(_INCHES, _INCHES * len(worlds)), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    for i, world in enumerate(worlds):
        _draw(figure.add_subplot(len(worlds), 1, i + 1), world, footprint)
    figure.savefig(path, dpi=110)


def _draw(axes: Axes, world: World, footprint: NDArray[np.float64]) -> None:
    still = np.zeros(2)
    for part in world.unknown_ground.geoms:
        axes.add_patch(patch(part, still, facecolor=_UNKNOWN))
    for wall in world.walls.geoms:
        axes.add_patch(patch(wall, still, facecolor=WALL))
    for line in (world.open_line, *world.gates):
        if line is not None:
            axes.plot(*np.asarray(line).T, color=EXIT, linewidth=2.0, marker="o")
    if len(world.waypoints):
        axes.plot(*world.waypoints.T, color=EXIT, marker="x", linestyle="none")
    _draw_car(axes, footprint, world.start.pose, CAR, "start")
    free = None if stands_free(world, footprint) else free_start(world, footprint)
    if free is not None:
        _draw_car(axes, footprint, free, _FREE, "would be free")
    shown = shapely.GeometryCollection([world.walls, shapely.Point(world.start.pose.x, world.start.pose.y)])
    low_x, low_y, high_x, high_y = shown.bounds
    axes.set(
        xlim=(low_x - _MARGIN_M, high_x + _MARGIN_M),
        ylim=(low_y - _MARGIN_M, high_y + _MARGIN_M),
        aspect="equal",
        xlabel=f"x in m, walls {world.walls.bounds[0]:.2f} to {world.walls.bounds[2]:.2f}",
        ylabel=f"y in m, walls {world.walls.bounds[1]:.2f} to {world.walls.bounds[3]:.2f}",
        title=world.name,
    )
    axes.grid(alpha=0.3)
    axes.legend(loc="best")


def _draw_car(axes: Axes, footprint: NDArray[np.float64], pose: Pose2, colour: str, name: str) -> None:
    label = f"{name}: ({pose.x:.2f}, {pose.y:.2f}), {np.degrees(pose.yaw):.0f} degrees"
    axes.add_patch(Polygon(to_world(footprint, pose), facecolor=colour, label=label, zorder=4))
    nose = np.array([[0.0, 0.0], [2.0 * float(footprint[:, 0].max()), 0.0]])
    axes.plot(*to_world(nose, pose).T, color=colour, linewidth=1.5, zorder=5)
