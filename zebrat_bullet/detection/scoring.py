"""What each representation made of a trace: which contacts it saw and how early, and what it reported without any."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.config import FlattenConfig, LidarConfig, NoiseConfig, PhysicsConfig
from zebrat_bullet.detection.places import load_place
from zebrat_bullet.detection.representations import Representation, fires
from zebrat_bullet.detection.traces import AFTER_S, Trace
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.geometry import rotation_2d, to_world
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.sensing.cloud_check import cloud_gap
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import Pose2

BEFORE_S = 1.0
"""A report up to so long before a contact belongs to it; without a contact it is a false alarm."""


@dataclass(frozen=True, kw_only=True)
class Sensing:
    """How a trace is looked at.

    Attributes:
        lidar, noise, flatten: as in a task.
        rate_hz: sweeps a second; a sweep falls on every (physics rate / this)-th physics step.
    """

    lidar: LidarConfig = field(default_factory=lambda: LidarConfig(caster="embree"))
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    flatten: FlattenConfig = field(default_factory=FlattenConfig)
    rate_hz: float = 5.0

    def steps_between(self, physics_hz: float) -> int:
        """Return the physics steps between two sweeps.

        Raises:
            ConfigError: they are no whole number.
        """
        steps = physics_hz / self.rate_hz if self.rate_hz > 0 else 0.0
        if steps < 1 or abs(steps - round(steps)) > 1e-6:
            raise ConfigError(
                f"sweeps at {self.rate_hz:g} Hz do not fall on physics steps at {physics_hz:g} Hz; "
                "choose a rate that divides it"
            )
        return round(steps)


@dataclass(frozen=True, kw_only=True)
class Readings:
    """M sweeps along a trace.

    Attributes:
        row: (M,) int, rows of the trace.
        scans: (M, B) float32, flattened ranges in m.
        cloud_gaps_m: (M,) `cloud_gap` to the outline without margin.
        every: physics steps between two sweeps.
    """

    row: NDArray[np.int64]
    scans: NDArray[np.float32]
    cloud_gaps_m: NDArray[np.float64]
    every: int


@dataclass(frozen=True, kw_only=True)
class Event:
    """The first contact of a drive.

    Attributes:
        walls, world, driver, chunk, drive: which.
        time_s: since the drive began.
        x, y, yaw: pose of the car, world frame.
        speed_mps: measured forward speed.
        contact_x, contact_y: where on the outline, base frame: the point nearest to the wall, or where they overlap,
            the point of the outline nearest to the middle of the overlap.
    """

    walls: str
    world: str
    driver: str
    chunk: int
    drive: int
    time_s: float
    x: float
    y: float
    yaw: float
    speed_mps: float
    contact_x: float
    contact_y: float


@dataclass(frozen=True, kw_only=True)
class TraceScore:
    """What R representations made of a trace with E events.

    Attributes:
        events: the E events.
        lead_s: (R, E) how long before the contact it was first reported, from `BEFORE_S` before to `AFTER_S` after
            it; negative after it, NaN where it was not.
        in_time: (R, E) bool, reported not later than by the first sweep after the contact.
        false_alarms: (R,) int, reports that no contact follows or precedes in that time; sweeps in a row are one.
        clear_s: time driven outside of these times, in which a report is a false alarm.
        overlap_sweeps: (E,) int, sweeps taken in collision.
        overlap_reports: (R, E) int, how many of these reported it.
    """

    events: list[Event]
    lead_s: NDArray[np.float64]
    in_time: NDArray[np.bool_]
    false_alarms: NDArray[np.int64]
    clear_s: float
    overlap_sweeps: NDArray[np.int64]
    overlap_reports: NDArray[np.int64]


def take_readings(trace: Trace, robot: str, sensing: Sensing, seed: int) -> Readings:
    """Sweep the lidar of a car, by name or file, along a trace.

    Raises:
        ConfigError: the physics steps between two sweeps are no whole number.
        ZebratError: the world or the car cannot be loaded.
    """
    every = sensing.steps_between(trace.rate_hz)
    model, world = load_robot(robot), load_place(trace.world, robot)
    simulation = Simulation(model, PhysicsConfig())  # never stepped: the caster "bullet" casts against its walls
    simulation.set_world(world)
    lidar = Lidar(model, sensing.lidar, sensing.noise, sensing.flatten, simulation.client_id)
    lidar.set_world(world)
    outline = model.footprint_base - model.lidar_xyz_base[:2]
    rng = np.random.default_rng([seed, trace.chunk])
    rows = np.concatenate([np.arange(a, b, every) for a, b in pairwise(trace.first_row)])
    scans = np.empty((len(rows), sensing.lidar.n_bearings), np.float32)
    gaps = np.empty(len(rows))
    for i, row in enumerate(rows):
        sweep = lidar.sweep(trace.state_at(row), rng)
        scans[i] = lidar.flat(sweep).ranges_m
        gaps[i] = cloud_gap(lidar.cloud(sweep), sensing.flatten, outline)
    simulation.close()
    return Readings(row=rows, scans=scans, cloud_gaps_m=gaps, every=every)


def score_trace(trace: Trace, readings: Readings, representations: Sequence[Representation], robot: str) -> TraceScore:
    """Score representations on a trace; the rows of the result are in their order."""
    model, walls = load_robot(robot), load_place(trace.world, robot).walls
    reports = np.array([fires(what, robot, readings.scans, readings.cloud_gaps_m) for what in representations])
    before, after = round(BEFORE_S * trace.rate_hz), round(AFTER_S * trace.rate_hz)
    drive_of = np.searchsorted(trace.first_row, readings.row, side="right") - 1
    in_overlap = trace.hits[readings.row]
    clear = np.ones(len(readings.row), bool)
    events, first, overlaps, overlap_reports = [], [], [], []
    for drive, (begin, end) in enumerate(pairwise(trace.first_row)):
        if not trace.hits[begin:end].any():
            continue
        contact = begin + int(np.argmax(trace.hits[begin:end]))
        after_contact = readings.row - contact
        here = (drive_of == drive) & (after_contact >= -before)  # a drive ends soon after its contact
        clear &= ~here
        events.append(_event(trace, drive, contact, model, walls))
        first.append(np.where(reports & here, after_contact, after + 1).min(axis=1))
        overlaps.append(np.count_nonzero(here & in_overlap))
        overlap_reports.append(np.count_nonzero(reports & here & in_overlap, axis=1))
    first_rows = np.array(first, np.int64).reshape(-1, len(representations)).T
    alarms = reports & clear
    alarms[:, 1:] &= ~(alarms[:, :-1] & (drive_of[1:] == drive_of[:-1]))
    return TraceScore(
        events=events,
        lead_s=np.where(first_rows <= after, -first_rows / trace.rate_hz, np.nan),
        in_time=first_rows < readings.every,
        false_alarms=alarms.sum(axis=1),
        clear_s=float(clear.sum() * readings.every / trace.rate_hz),
        overlap_sweeps=np.array(overlaps, np.int64),
        overlap_reports=np.array(overlap_reports, np.int64).reshape(-1, len(representations)).T,
    )


def _event(trace: Trace, drive: int, row: int, robot: RobotModel, walls: shapely.MultiPolygon) -> Event:
    pose = Pose2(*(float(value) for value in trace.pose[row]))
    outline = shapely.Polygon(to_world(robot.footprint_base, pose))
    overlap = shapely.intersection(outline, walls)
    near = walls if overlap.is_empty else overlap.centroid
    touch = shapely.get_coordinates(shapely.shortest_line(outline.exterior, near))[0]
    x, y = (touch - (pose.x, pose.y)) @ rotation_2d(pose.yaw)
    return Event(
        walls=trace.walls,
        world=trace.world,
        driver=trace.driver,
        chunk=trace.chunk,
        drive=drive,
        time_s=(row - int(trace.first_row[drive])) / trace.rate_hz,
        x=pose.x,
        y=pose.y,
        yaw=pose.yaw,
        speed_mps=float(trace.speed_mps[row]),
        contact_x=float(x),
        contact_y=float(y),
    )
