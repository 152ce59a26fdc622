"""Every drive in a track as a line, a panel a method, coloured by how it ended."""

from collections.abc import Mapping, Sequence
from io import BytesIO

import numpy as np
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from PIL import Image

from zebrat_bullet.report.comparison.evidence import Drive, Way
from zebrat_bullet.report.comparison.figures import OUTCOMES, outcome_of, sheet
from zebrat_bullet.report.track_figure import draw_track
from zebrat_bullet.world import World

_DPI = 130
_COLOURS = 256
_ROOM_M = 0.6


def draw_ways(world: World, footprint: NDArray[np.float64], drives: Mapping[str, Sequence[tuple[Drive, Way]]]) -> bytes:
    """Return a PNG of a track's drives, a panel a method; failures lie on top.

    Args:
        world: the track.
        footprint: (K, 2) outline of the car in its base frame, m.
        drives: by method.
    """
    low_x, low_y, high_x, high_y = world.walls.bounds
    wide = (high_x - low_x) > 1.6 * (high_y - low_y)
    n_columns = 1 if wide and len(drives) < 2 else 2
    n_rows = -(-len(drives) // n_columns)
    height = 4.8 / n_columns * (high_y - low_y + 2 * _ROOM_M) / (high_x - low_x + 2 * _ROOM_M) + 0.3
    figure, panels = sheet(n_rows, n_columns, min(max(height, 0.9), 4.0))
    for axes in panels.flat:
        axes.set_axis_off()
    for axes, (method, of_method) in zip(panels.flat, drives.items(), strict=False):
        draw_track(axes, world, footprint, np.zeros(2))
        for outcome, colour in OUTCOMES.items():
            ways = [(drive, way) for drive, way in of_method if outcome_of(drive) == outcome]
            for drive, way in ways:
                axes.plot(*way.T, color=colour, linewidth=0.7, alpha=0.7, zorder=6)
                if not drive.success:
                    axes.plot(*way[-1], "x", color=colour, markersize=4, markeredgewidth=1.2, zorder=7)
        won = sum(drive.success for drive, _ in of_method)
        axes.set(xlim=(low_x - _ROOM_M, high_x + _ROOM_M), ylim=(low_y - _ROOM_M, high_y + _ROOM_M), aspect="equal")
        axes.set_title(f"{method}: {won} of {len(of_method)}", fontsize=9)
    handles = [Line2D([], [], color=colour, label=name) for name, colour in OUTCOMES.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    out, small = BytesIO(), BytesIO()
    figure.savefig(out, format="png", dpi=_DPI, metadata={"Software": None})
    out.seek(0)
    with Image.open(out) as image:  # few colours: a third of the size
        image.convert("RGB").quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
            small, format="PNG", optimize=True
        )
    return small.getvalue()
