"""Three contacts that three representations missed, from above and slowed down, side by side."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from zebrat_bullet.config import NoiseConfig
from zebrat_bullet.detection.cases import Case
from zebrat_bullet.detection.places import load_place
from zebrat_bullet.detection.representations import RAY_REPRESENTATIONS, region_of
from zebrat_bullet.detection.scoring import Event
from zebrat_bullet.detection.summary import Results, base_tallies
from zebrat_bullet.detection.traces import Trace
from zebrat_bullet.geometry import to_world
from zebrat_bullet.report.collision_figures import COLOURS
from zebrat_bullet.report.collisions import LABELS
from zebrat_bullet.report.mp4 import write_mp4
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.types import Pose2, RobotState

SIZE = (1260, 480)
FPS = 24
_SLOWER = 4
_BEFORE_S, _AFTER_S = 0.6, 0.5
_HIT = "#c8322b"


def find_misses(results: Results, walls: str) -> dict[str, Event]:
    """Return, for SR, FIRect and FIFR, a contact each that it did not report: the longest not yet taken by another.

    A representation that missed none is absent.
    """
    misses: dict[str, Event] = {}
    for kind in RAY_REPRESENTATIONS:
        tally = base_tallies(results, walls)[kind]
        missed = [
            (int(n), -e)
            for e, (n, lead) in enumerate(zip(tally.overlap_sweeps, tally.lead_s, strict=True))
            if np.isnan(lead) and tally.events[e] not in misses.values()
        ]
        if missed:
            misses[kind] = tally.events[-max(missed)[1]]
    return misses


def write_miss_video(scenes: list[tuple[Case, Event, Trace]], robot: str, path: Path) -> None:
    """Write the contacts as an MP4 at a quarter of the speed; what is said is what the last sweep said.

    Args:
        scenes: up to three base cases, each with a contact and the trace that holds it.
        robot: the car that drove.
        path: the .mp4 to write.

    Raises:
        RenderError: another suffix.
    """
    write_mp4(path, _pictures(scenes, robot), FPS, SIZE)


def _pictures(scenes: list[tuple[Case, Event, Trace]], robot: str) -> Iterator[NDArray[np.uint8]]:
    figure = Figure(figsize=(SIZE[0] / 100, SIZE[1] / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    grid = figure.subplots(1, len(scenes), squeeze=False)[0]
    figure.subplots_adjust(0.01, 0.02, 0.99, 0.88, 0.03)
    views = [_View(axes, *scene, robot) for axes, scene in zip(grid, scenes, strict=True)]
    for time_s in np.arange(-_BEFORE_S, _AFTER_S, 1.0 / (FPS * _SLOWER)):
        for view in views:
            view.show(time_s)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3]


class _View:
    """One contact, seen from above, with the rays of the representation that missed it."""

    def __init__(self, axes: Axes, case: Case, event: Event, trace: Trace, robot: str) -> None:
        self._axes, self._kind, self._trace = axes, case.representation.kind, trace
        self._robot = load_robot(robot)
        sensing = case.sensing
        self._region = region_of(case.representation, robot, sensing.lidar.n_bearings)
        self._every = sensing.steps_between(trace.rate_hz)
        world = load_place(trace.world, robot)
        self._lidar = Lidar(self._robot, replace(sensing.lidar, caster="embree"), NoiseConfig(), sensing.flatten)
        self._lidar.set_world(world)
        self._first = int(trace.first_row[event.drive])
        self._last = int(trace.first_row[event.drive + 1]) - 1
        self._contact = self._first + round(event.time_s * trace.rate_hz)
        view = shapely.box(event.x - 1.1, event.y - 1.1, event.x + 1.1, event.y + 1.1)
        for part in shapely.get_parts(shapely.intersection(world.walls, view)):
            if part.geom_type == "Polygon":
                axes.add_patch(Polygon(np.array(part.exterior.coords), closed=True, fc="#2f3b4c"))
        self._body = Polygon(np.zeros((4, 2)), closed=True, fc="none", ec="#111", lw=1.5, zorder=4)
        self._rays = LineCollection([], linewidths=1.0, zorder=3)
        axes.add_patch(self._body)
        axes.add_collection(self._rays)
        axes.set(xlim=(event.x - 1.1, event.x + 1.1), ylim=(event.y - 1.1, event.y + 1.1), aspect="equal")
        axes.set_xticks([])
        axes.set_yticks([])

    def show(self, time_s: float) -> None:
        row = int(np.clip(self._contact + round(time_s * self._trace.rate_hz), self._first, self._last))
        state = self._trace.state_at(row)
        self._body.set_xy(to_world(self._robot.footprint_base, state.pose))
        hit = bool(self._trace.hits[row])
        self._body.set_edgecolor(_HIT if hit else "#111")
        swept = row - (row - self._first) % self._every
        reported = self._draw_rays(state.pose, self._trace.state_at(swept))
        said = "REPORTED" if reported else ("collision, not reported" if hit else "free")
        when = f"{(row - self._contact) / self._trace.rate_hz:+.2f} s"
        self._axes.set_title(f"{LABELS[self._kind]}  {when}\n{said}", color=_HIT if hit else "#111", fontsize=11)

    def _draw_rays(self, pose: Pose2, swept: RobotState) -> bool:
        scan = self._lidar.scan(swept, np.random.default_rng(0))
        clearance = self._region.measure(scan)
        bearings = beam_bearings(len(scan.ranges_m))[self._region.indices]
        mount = self._robot.lidar_xyz_base[:2]
        ends = mount + clearance.range_m[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
        begin, ends_world = to_world(mount[None], pose), to_world(ends, pose)
        self._rays.set_segments([np.vstack([begin, end]) for end in ends_world])
        self._rays.set_color([_HIT if at else COLOURS[self._kind] for at in clearance.obs_m <= clearance.range_m])
        return clearance.collision
