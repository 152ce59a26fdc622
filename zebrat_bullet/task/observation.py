"""The only encoder of observations and decoder of actions, for one car or thousands; needs no simulator.

So the real car uses it too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.arrays import Array, clamp, like, namespace
from zebrat_bullet.config import MOST_TRAIL_STEPS, TaskConfig, within
from zebrat_bullet.errors import ActionError, ConfigError
from zebrat_bullet.task.trail import PARTS, Trail
from zebrat_bullet.types import Command, Commands, Reading

if TYPE_CHECKING:
    from zebrat_bullet.robot import RobotModel
    from zebrat_bullet.sensing.safety_region import SafetyRegion

DISCRETE_COMMANDS = tuple((speed, steering) for speed in (-1.0, 1.0) for steering in (-1.0, 0.0, 1.0))
"""The six discrete actions as fractions of the speed and steering limits (paper: {-0.6, 0.6} x {-0.6, 0, 0.6})."""
LEAST_GAP_M = 0.003
"""Smaller gaps are observed as this one."""


@dataclass(frozen=True, kw_only=True)
class ObservationSpec:
    """The observation: V_obs by bearing, logarithms of the gaps, last command, next waypoint, and where the car was.

    The paper's is 32 + 2 numbers, the default; under waypoint guidance 32 + 2 + 2, or 32 + 2 without the last command.
    Numbers are scaled to [-1, 1]: ranges and the waypoint's distance, cut off at the lidar's reach, linearly from 0 to
    that reach; logarithms linearly from that of `LEAST_GAP_M` to that of the reach; the command by its limits; the
    waypoint's bearing by pi; where the car was by how far it could have come since then.

    Attributes:
        n_rays: bearings of the safety region.
        range_max_m: the lidar's reach.
        max_speed_mps, max_steering_rad: limits of a command.
        raw: True for SI values (m, log10 of m, m/s, rad) as in the paper, False for the same scaled to [-1, 1].
        gap_ranges_m: V_range of each bearing, where log10(V_obs - V_range) is part of the observation; else empty.
        last_command: the last speed and steering are part of it.
        waypoint: distance and bearing of the next waypoint are part of it.
        trail_steps: where the car was so many control steps ago is part of it, four numbers each: see `task.trail`.
        control_step_s, wheelbase_m: by which that is reckoned; 0 without it.
    """

    n_rays: int
    range_max_m: float
    max_speed_mps: float
    max_steering_rad: float
    raw: bool = False
    gap_ranges_m: tuple[float, ...] = ()
    last_command: bool = True
    waypoint: bool = False
    trail_steps: tuple[int, ...] = ()
    control_step_s: float = 0.0
    wheelbase_m: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "gap_ranges_m", tuple(self.gap_ranges_m))  # JSON knows lists only
        object.__setattr__(self, "trail_steps", tuple(self.trail_steps))
        within(self, n_rays=(1, 36_000), range_max_m=(0.01, 1000.0), max_speed_mps=(1e-6, 100.0))
        within(self, max_steering_rad=(1e-6, math.pi / 2), gap_ranges_m=(0.0, 1000.0))
        if len(self.gap_ranges_m) not in (0, self.n_rays):
            raise ConfigError(f"gap_ranges_m must hold none or {self.n_rays} ranges, got {len(self.gap_ranges_m)}")
        if self.trail_steps:
            within(self, trail_steps=(1, MOST_TRAIL_STEPS), control_step_s=(0.001, 10.0), wheelbase_m=(0.001, 100.0))

    @property
    def size(self) -> int:
        """Numbers in an observation."""
        n_trail = PARTS * len(self.trail_steps)
        return self.n_rays + len(self.gap_ranges_m) + 2 * self.last_command + 2 * self.waypoint + n_trail

    @property
    def limits(self) -> NDArray[np.float32]:
        """Return the (2,) limits of a command: speed in m/s and steering in rad."""
        return np.array([self.max_speed_mps, self.max_steering_rad], dtype=np.float32)

    @property
    def bounds(self) -> NDArray[np.float32]:
        """Return the (2, size) least and greatest observation."""
        si = self._raw_bounds().astype(np.float32)
        gaps = slice(self.n_rays, self.n_rays + len(self.gap_ranges_m))
        si[0, gaps] = np.nextafter(si[0, gaps], np.float32(-np.inf))  # a logarithm in single precision may round there
        return si if self.raw else np.stack([np.full_like(si[0], -1.0), np.ones_like(si[0])])

    @property
    def trail_reach_m(self) -> tuple[float, ...]:
        """How far the car can have come since each of the trail's steps."""
        return tuple(n * self.control_step_s * self.max_speed_mps for n in self.trail_steps)

    def new_trail(self, command: Array) -> Trail:
        """Return the trail of N cars that begin to drive; `command` (N, 2) says where its numbers are held."""
        return Trail(self.trail_steps, self.control_step_s, self.wheelbase_m, command)

    def _raw_bounds(self) -> NDArray[np.float64]:
        """Return the (2, size) least and greatest SI values of an observation."""
        reach, speed, steering = self.range_max_m, self.max_speed_mps, self.max_steering_rad
        least, most = [0.0] * self.n_rays, [reach] * self.n_rays
        least += [math.log10(LEAST_GAP_M)] * len(self.gap_ranges_m)
        most += [math.log10(reach)] * len(self.gap_ranges_m)
        if self.last_command:
            least, most = [*least, -speed, -steering], [*most, speed, steering]
        if self.waypoint:
            least, most = [*least, 0.0, -np.pi], [*most, reach, np.pi]
        for reach_m in self.trail_reach_m:
            least, most = [*least, -reach_m, -reach_m, -1.0, -1.0], [*most, reach_m, reach_m, 1.0, 1.0]
        return np.array([least, most])

    def encode(self, reading: Reading, trail: Trail | None = None) -> NDArray[np.float32]:
        """Return the (size,) float32 observation of a reading, by a car whose trail is this one.

        Raises:
            ConfigError: the waypoint is part of it and the reading names none; or the trail, and there is none.
        """
        command = np.array([[reading.last_command.speed_mps, reading.last_command.steering_rad]], dtype=np.float32)
        waypoint = None
        if self.waypoint and reading.waypoint is not None:
            waypoint = np.array([[reading.waypoint.distance_m, reading.waypoint.bearing_rad]], dtype=np.float32)
        encoded: NDArray[np.float32] = self.encode_cars(
            reading.clearance.obs_m[None], command, waypoint, None if trail is None else trail.look()
        )[0]
        return encoded

    def encode_cars(
        self, obs_m: Array, last_command: Array, waypoint: Array | None = None, trail: Array | None = None
    ) -> Array:
        """Return the (N, size) float32 observations of N cars.

        Args:
            obs_m: (N, n_rays) float32, V_obs in m.
            last_command: (N, 2) float32, m/s and rad.
            waypoint: (N, 2) float32, distance in m and bearing in rad of each car's next waypoint.
            trail: (N, 4 L) float32, as `Trail.look` gives it.

        Raises:
            ConfigError: the waypoint or the trail is part of it and there is none.
        """
        xp = namespace(obs_m)
        parts = [obs_m]
        if self.gap_ranges_m:
            gaps = obs_m - like(np.array(self.gap_ranges_m), obs_m)
            parts.append(xp.log10(clamp(gaps, LEAST_GAP_M)))
        if self.last_command:
            parts.append(last_command)
        if self.waypoint:
            if waypoint is None:
                raise ConfigError(
                    "the observation holds the next waypoint and the reading names none; declare the privilege "
                    "'waypoint'"
                )
            parts += [clamp(waypoint[:, :1], most=self.range_max_m), waypoint[:, 1:]]
        if self.trail_steps:
            if trail is None:
                raise ConfigError("the observation holds where the car was, and no trail is kept here")
            parts.append(trail)
        joined = xp.concat(parts, axis=1)
        if self.raw:
            return joined
        scale, shift = self._scaling
        joined *= like(scale, joined)
        joined += like(shift, joined)
        return joined

    @cached_property
    def _scaling(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (size,) factors and (size,) summands that turn SI values into [-1, 1]."""
        least, most = self._raw_bounds()
        scale = 2.0 / (most - least)
        return scale, -1.0 - least * scale

    def decode(self, action: NDArray[np.float32] | Sequence[float]) -> Command:
        """Turn a (2,) action, in [-1, 1] (or SI where raw), into a command; beyond the limits it is clipped.

        Raises:
            ActionError: the action is not two finite numbers.
        """
        try:
            values = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError):  # a text, a ragged list
            values = np.empty(0)
        if values.shape != (2,) or not np.isfinite(values).all():
            raise ActionError(f"an action is two finite numbers (speed, steering), got {action!r}")
        command = self.decode_cars(values[None])
        return Command(float(command.speed_mps[0]), float(command.steering_rad[0]))

    def decode_cars(self, actions: Array) -> Commands:
        """Turn (N, 2) finite actions, in [-1, 1] (SI where raw), into commands; beyond the limits they are clipped."""
        speed, steering = self.max_speed_mps, self.max_steering_rad
        by_speed, by_steering = (1.0, 1.0) if self.raw else (speed, steering)
        return Commands(
            clamp(actions[:, 0] * by_speed, -speed, speed), clamp(actions[:, 1] * by_steering, -steering, steering)
        )

    def decode_discrete(self, action: int) -> Command:
        """Turn an index into DISCRETE_COMMANDS into a command.

        Raises:
            ActionError: the index is out of range.
        """
        try:
            index = int(action)
            index = index if index == action else -1
        except (TypeError, ValueError, OverflowError):  # a text, no number, an array of several
            index = -1
        if not 0 <= index < len(DISCRETE_COMMANDS):
            raise ActionError(f"a discrete action is 0..{len(DISCRETE_COMMANDS) - 1}, got {action!r}")
        speed, steering = DISCRETE_COMMANDS[index]
        return Command(speed * self.max_speed_mps, steering * self.max_steering_rad)


def observation_spec(
    task: TaskConfig, region: "SafetyRegion", robot: "RobotModel", raw: bool = False
) -> ObservationSpec:
    """Return what a task observes with the bearings of a region of a car."""
    trail_steps = task.observation.trail_steps
    return ObservationSpec(
        n_rays=len(region.range_m),
        range_max_m=task.lidar.range_max_m,
        max_speed_mps=task.physics.max_speed_mps,
        max_steering_rad=task.physics.max_steering_rad,
        raw=raw,
        gap_ranges_m=tuple(region.range_m.tolist()) if task.observation.log_gaps else (),
        last_command=task.observation.last_command,
        waypoint=task.observation.waypoint,
        trail_steps=trail_steps,
        control_step_s=task.physics.control_step_s if trail_steps else 0.0,
        wheelbase_m=robot.wheelbase_m if trail_steps else 0.0,
    )


class Observer:
    """Encodes the readings of one car, one each control step, and keeps its trail."""

    def __init__(self, spec: ObservationSpec) -> None:
        self._spec = spec
        self._trail = spec.new_trail(np.zeros((1, 2), dtype=np.float32))

    def begin(self) -> None:
        """Begin an episode: the car has come from nowhere."""
        self._trail.begin()

    def observe(self, reading: Reading) -> NDArray[np.float32]:
        """Return the (size,) float32 observation of the next reading."""
        last = reading.last_command
        self._trail.follow(np.array([[last.speed_mps, last.steering_rad]], dtype=np.float32))
        return self._spec.encode(reading, self._trail)
