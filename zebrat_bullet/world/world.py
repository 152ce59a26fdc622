"""The geometry of a place to drive in; knows nothing of any simulator."""

from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.types import Pose2


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: `vertices` (V, 3) float64 in m, world frame; `faces` (F, 3) int32, outward counter-clockwise."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]


@dataclass(frozen=True)
class Start:
    """A start pose with the half-widths of its uniform random range (m, m, rad; x and y in the pose's own frame)."""

    pose: Pose2
    range_x_m: float = 0.0
    range_y_m: float = 0.0
    range_yaw_rad: float = 0.0


@dataclass(frozen=True)
class World:
    """One world, checked and meshed.

    Attributes:
        name: file stem or the user's name for it.
        description: one line.
        mesh: all solid walls and obstacles (not the floor, which is the plane z = 0), watertight.
        walls: the outlines of everything the body can hit, world frame.
        low_obstacles: the part of `walls` that the lidar cannot always see (declared low); often empty.
        free_space: the drivable interior up to the open-space line.
        centre_line: (N, 2) float64, m, from the start to past the open-space line, points at most 0.1 m apart;
            (0, 2) where the world has none (a user's mesh or map).
        widths_m: (N,) float64, width of the passage at those points.
        start: where the car begins.
        waypoints: (K, 2) float64; the last is the goal, 1 m past the open-space line.
        open_line: (2, 2) float64, end points of the line where open space begins, ordered so that open space lies to
            the right when going from the first to the second; None where the world declares no exit.
        max_steps: overrides the time-out of the task, or None.
        turns_deg: the turns of the centre line in order, left positive.
        family, difficulty: how a generated track was drawn, 0 easy to 1 hard; empty and None for others.
        source: what `load_world` was given: a shipped name or a path, with its start, goal or exit where these were
            given too; empty for a world made in memory.
        gates: (G, 2, 2) float64, end points of the lines that the car's middle must cross one after the other, or,
            where both are one point, come near to: the goal, or the quarters of a lap. (0, 2, 2) where the open-space
            line decides, or nothing does.
        unknown_ground: what nobody has mapped of a map: no wall, but no car begins there.
        notes: what was taken to be meant where its file leaves it open.
        valid_for: the measures of the car that it was last checked with (`validate.validate_world`); None for a world
            that nobody has checked, as one is again of which something was replaced.
    """

    name: str
    description: str
    mesh: Mesh
    walls: shapely.MultiPolygon
    low_obstacles: shapely.MultiPolygon
    free_space: shapely.Polygon
    centre_line: NDArray[np.float64]
    widths_m: NDArray[np.float64]
    start: Start
    waypoints: NDArray[np.float64]
    open_line: NDArray[np.float64] | None
    max_steps: int | None = None
    turns_deg: tuple[float, ...] = ()
    family: str = ""
    difficulty: float | None = None
    source: str = ""
    gates: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2, 2)))
    unknown_ground: shapely.MultiPolygon = field(default_factory=shapely.MultiPolygon)
    notes: tuple[str, ...] = ()
    valid_for: object = field(default=None, init=False, repr=False, compare=False)

    @property
    def can_be_won(self) -> bool:
        """Return whether an episode in it can succeed."""
        return self.open_line is not None or len(self.gates) > 0

    @property
    def is_circuit(self) -> bool:
        """Return whether its centre line ends where it begins."""
        return len(self.centre_line) > 3 and bool(np.allclose(self.centre_line[0], self.centre_line[-1]))

    def past_open_line(self, x: float, y: float) -> bool:
        """Return whether a world point lies past the line where open space begins.

        The track may turn back, so a point inside the passage is never past the line, on whichever side it lies.
        """
        if self.open_line is None:
            return False
        (ax, ay), (bx, by) = self.open_line
        beyond = (bx - ax) * (y - ay) - (by - ay) * (x - ax) < 0.0
        return bool(beyond and not shapely.intersects_xy(self.free_space, x, y))
