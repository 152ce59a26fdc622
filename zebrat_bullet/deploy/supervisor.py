"""Stands between any driver and the wheels, and stops the car before it touches what its lidar shows."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.deploy.car import Car
from zebrat_bullet.deploy.decision import Decision
from zebrat_bullet.deploy.sweep import Outline, apart, motion, scan_points
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.types import Command, FlatScan

MARGIN_M = 0.01
STEERING_LAG_S = 0.08
"""Time constant of PyBullet's steering: each physics step of 1/120 s closes a tenth of its error."""
INSIDE_M = 0.05
"""A return so far inside the outline is no wall that is touched: the lidar sees the car, or something lies on it."""
_SAME_M = 1e-4
_FASTEST = 3.0
"""A measured speed of more than so many times the car's greatest is none."""
_LONGEST_BRAKING_S = 10.0
_LEAST_BEARINGS = 8
_COARSE = 6
_HERE = np.zeros((1, 3))
_SIDES = ("behind", "behind-right", "right", "ahead-right", "ahead", "ahead-left", "left", "behind-left")
_WAYS = ("ahead left", "ahead straight", "ahead right", "back left", "back straight", "back right")


class Supervisor:
    """Lets a command through, or stops the car and says why.

    **What is checked.** A command holds until the next check, `control_step_s` later, and should that stop the car, it
    brakes from there. The supervisor follows the outline along this path: first, for as long as the scan is old and a
    command takes to reach the motors, on as the last command had it; then a control step under the new one; then
    braking to rest. Speed changes by the car's deceleration (and 1.5 times that where it speeds up), steering turns
    from where it stands to where it is told, once at its rate and once with a servo's lag, and both paths count. The
    least gap between the outline and all returns of the scan, at poses 1 cm apart, is the clearance of the path.

    **What is refused.** A command with a path whose clearance is less than the margin, and less than that of stopping
    at once. So a car within the margin may do all that brings it no nearer: back away, drive off, or on along a wall.
    And a command that brings inside the outline what is outside, would stay there if the car stopped, and is no part of
    a wall that is touched already (`SAME_WALL_M`): contact with one is no leave to drive into another.

    **What a stop is.** Speed 0, and the wheels turn to the command's steering where braking with them so comes no
    nearer than with the steering of the last command, along which there was room to brake when it was let through;
    else these. Where the scan cannot be used it is the last command's steering.

    The lidar must not see the car itself: a return more than `INSIDE_M` inside the outline stops it until that is
    removed. A measured speed that is far from what the commands should have brought about is not relied on alone: both
    are followed, for odometry may be stuck.

    Args:
        car: the car; its deceleration must be one that it can do at every steering.
        control_step_s: time until the next check.
        margin_m: how far every side of the outline is moved outwards.
        late_s: age at which a scan is too old; None: one control step.
        delay_s: time until a command reaches the motors.
        steering_lag_s: time constant of the steering.
        least_returns: fewest bearings with a return; a lidar that sees nothing cannot be told from a blind one.

    Raises:
        ConfigError: a number is not finite, below 0, or no control step; or the car takes too long to brake.
    """

    def __init__(
        self,
        car: Car,
        control_step_s: float,
        margin_m: float = MARGIN_M,
        late_s: float | None = None,
        *,
        delay_s: float = 0.0,
        steering_lag_s: float = STEERING_LAG_S,
        least_returns: int = 1,
    ) -> None:
        self.car, self.control_step_s, self.margin_m, self.delay_s = car, control_step_s, margin_m, delay_s
        self.late_s = control_step_s if late_s is None else late_s
        self.least_returns = least_returns
        self._lags_s = (0.0, steering_lag_s)
        for name, value in {
            "margin_m": margin_m,
            "late_s": self.late_s,
            "delay_s": delay_s,
            "steering_lag_s": steering_lag_s,
        }.items():
            if not 0.0 <= value < math.inf:
                raise ConfigError(f"{name} must be a finite number of at least 0, got {value}")
        if not 0.0 < control_step_s < math.inf:
            raise ConfigError(f"control_step_s must be a finite number above 0, got {control_step_s}")
        if car.max_speed_mps > _LONGEST_BRAKING_S * car.deceleration_mps2:
            raise ConfigError(
                f"a car brakes to rest in {_LONGEST_BRAKING_S:g} s at most, got {car.max_speed_mps} m/s and "
                f"{car.deceleration_mps2} m/s2"
            )
        self._outline = Outline(car.outline_base)
        self.reset()

    def reset(self) -> None:
        """Begin anew with a car at rest whose wheels are straight."""
        self._last = self._before = Command(0.0, 0.0)
        self._speeds_mps = [0.0]
        self._steerings_rad = (0.0,) * len(self._lags_s)

    def check(
        self,
        command: Command,
        scan: FlatScan | None,
        speed_mps: float | None,
        steering_rad: float | None,
        age_s: float = 0.0,
        hold_s: float | None = None,
        since_s: float | None = None,
    ) -> Decision:
        """Return the command, within the car's limits, or a stop and why.

        Args:
            command: what the driver wants.
            scan: what the lidar shows, all bearings of it; None: there is none.
            speed_mps: measured forward speed; None: as the commands so far should have brought it about.
            steering_rad: measured angle of the virtual centre wheel; None: likewise.
            age_s: how old the scan is.
            hold_s: longest time that there may be until the next check; None: a control step.
            since_s: time since the last one; None: a control step.
        """
        hold_s, since_s = (self.control_step_s if each is None else each for each in (hold_s, since_s))
        timed = all(isinstance(each, float | int) and 0.0 <= each < math.inf for each in (hold_s, since_s))
        # Later than that it moves as it was told, however long ago.
        self._advance(min(since_s, _LONGEST_BRAKING_S) if timed else self.control_step_s)
        wrong = self._wrong(command, scan, age_s, speed_mps, steering_rad)
        if not timed or hold_s > _LONGEST_BRAKING_S:
            wrong = (
                f"times to (up to {_LONGEST_BRAKING_S:g}) and since a check are in s from 0, got {hold_s}, {since_s}"
            )
        if speed_mps is not None and abs(speed_mps) <= _FASTEST * self.car.max_speed_mps:
            reckoned = self._speeds_mps[0]
            far_off = abs(speed_mps - reckoned) > 0.5 * self.car.max_speed_mps
            self._speeds_mps = [speed_mps, reckoned] if far_off else [speed_mps]
        if steering_rad is not None and abs(steering_rad) < math.pi / 2.0:
            self._steerings_rad = (steering_rad,) * len(self._lags_s)
        decision = Decision(Command(0.0, self._last.steering_rad), wrong) if wrong else None
        if decision is None:
            assert scan is not None
            decision = self._judge(self._clipped(command), scan, age_s, hold_s)
        self._before, self._last = self._last, decision.command
        return decision

    def _wrong(
        self,
        command: Command,
        scan: FlatScan | None,
        age_s: float,
        speed_mps: float | None,
        steering_rad: float | None,
    ) -> str:
        """Return why nothing can be said of the command; empty if nothing is wrong."""
        if not (math.isfinite(command.speed_mps) and math.isfinite(command.steering_rad)):
            return (
                f"the command must be finite, got {command.speed_mps} m/s and {command.steering_rad} rad; give another"
            )
        fastest, lock = _FASTEST * self.car.max_speed_mps, math.pi / 2.0
        if not (abs(speed_mps or 0.0) <= fastest and abs(steering_rad or 0.0) < lock):  # what is no number fails, too
            return (
                f"measured speed and steering must be within {fastest:g} m/s and {lock:.2f} rad, got {speed_mps} and "
                f"{steering_rad}; mend the odometry, or give None"
            )
        if scan is None:
            return "there is no scan; look whether the lidar runs, the car drives on with the next one"
        if not 0.0 <= age_s <= self.late_s:  # a number that is none fails both
            return (
                f"the scan is {age_s:.3g} s old, allowed are 0 to {self.late_s:.3g} s; look at the lidar, the network "
                "and the clocks, the car drives on with the next scan in time"
            )
        ranges = scan.ranges_m
        if not isinstance(ranges, np.ndarray) or ranges.dtype.kind != "f":
            return f"the scan's ranges are a NumPy array of floats, got {type(ranges).__name__}; convert them"
        if ranges.ndim != 1 or len(ranges) < _LEAST_BEARINGS:
            return f"the scan has the shape {ranges.shape}, needed is (n,) of {_LEAST_BEARINGS} bearings or more"
        bad = int((~(np.isfinite(ranges) & (ranges >= 0.0))).sum())
        if bad or not 0.0 < scan.range_max_m < math.inf:
            return (
                f"{bad} of {len(ranges)} ranges up to {scan.range_max_m} m are not finite or below 0; give whole "
                "scans, range_max_m where nothing was seen"
            )
        seen = int((ranges < scan.range_max_m).sum())
        if seen < self.least_returns:
            return (
                f"the scan is empty: {seen} of {len(ranges)} bearings have a return within {scan.range_max_m:g} m, "
                f"needed are {self.least_returns}; look whether the lidar is covered, or allow fewer (least_returns)"
            )
        return ""

    def _judge(self, command: Command, scan: FlatScan, age_s: float, hold_s: float) -> Decision:
        points = scan_points(scan, self.car)
        now = self._outline.gaps(points, _HERE)[0]
        if (deepest := now.min(initial=math.inf)) < -INSIDE_M:
            return Decision(
                Command(0.0, self._last.steering_rad),
                f"{int((now < -INSIDE_M).sum())} returns stand up to {-deepest:.2f} m inside the car's outline, as if "
                "the lidar saw the car itself, or something on it; take it away, or filter these returns out",
            )
        path = self._paths(command, age_s, hold_s)
        least = self._rooms(points, now, [path])[0]
        if least.min() >= self.margin_m:
            return Decision(command)
        stops = [Command(0.0, steering) for steering in (command.steering_rad, self._last.steering_rad)]
        braked = [self._paths(stop, age_s, hold_s) for stop in stops]
        rooms = np.minimum(self._rooms(points, now, braked), self.margin_m)
        best = 0 if rooms[0].min() >= rooms[1].min() - _SAME_M else 1
        nearer = (least < rooms[best] - _SAME_M).any()
        if not nearer and not self._touches_more(apart(points, now), path, braked[best]):
            return Decision(command)
        return Decision(stops[best], self._reason(points, now, path) + self._advice(points, now, age_s, hold_s))

    def _touches_more(
        self, points: NDArray[np.float64], path: list[NDArray[np.float64]], stop: list[NDArray[np.float64]]
    ) -> bool:
        """Return whether a path brings points into the outline, or deeper into it, that stopping does not."""
        for driven, braked in zip(path, stop, strict=True):
            gap = self._outline.gaps(points, driven).min(axis=0)
            touched = gap < 0.0
            if (gap[touched] < self._outline.gaps(points[touched], braked).min(axis=0) - _SAME_M).any():
                return True
        return False

    def _paths(self, command: Command, age_s: float, hold_s: float) -> list[NDArray[np.float64]]:
        """Return the (T, 4) poses of a command and of braking after it, for each way in which the steering may turn."""
        brake = (math.inf, Command(0.0, command.steering_rad))
        phases = [(age_s + self.delay_s, self._last), (hold_s, command), brake]
        if command.speed_mps == 0.0:
            del phases[1]
        return [
            motion(self.car, speed, steering, phases, lag)[0]
            for speed in self._speeds_mps
            for steering, lag in zip(self._steerings_rad, self._lags_s, strict=True)
        ]

    def _rooms(
        self,
        points: NDArray[np.float64],
        now: NDArray[np.float64],
        ways: Sequence[list[NDArray[np.float64]]],
        every: int = 1,
    ) -> NDArray[np.float64]:
        """Return (W, P) the clearance of the P paths of each way, exact where it is less than the margin.

        Args:
            points: (N, 2) returns.
            now: (N,) how far each is outside of the outline where the car is.
            ways: the paths of each.
            every: of each path one pose in so many is looked at.
        """
        paths = [path[::-every] for way in ways for path in way]
        poses = np.concatenate(paths)
        near = points[now < self.margin_m + self._outline.moved_m(poses, self.margin_m)]
        least = self._outline.gaps(near, poses).min(axis=1, initial=math.inf)
        begin = np.cumsum([0, *map(len, paths[:-1])])
        return np.minimum.reduceat(least, begin).reshape(len(ways), -1)

    def _reason(self, points: NDArray[np.float64], now: NDArray[np.float64], path: list[NDArray[np.float64]]) -> str:
        """Return what a command comes too near to, where and when."""
        poses = np.concatenate(path)
        gaps = self._outline.gaps(points, poses)
        nearest, least_m = int(gaps.min(axis=0).argmin()), float(gaps.min())
        time_s = poses[int((gaps < self.margin_m).any(axis=1).argmax()), 3]
        what = "would touch what" if least_m <= 0.0 else f"would come to {least_m:.3f} m of what"
        margin = f" (margin {self.margin_m:g} m)" if least_m > 0.0 else ""
        return f"{what} is {now[nearest]:.2f} m {self._side(points[nearest])} in {time_s:.1f} s{margin}; "

    def _side(self, point: NDArray[np.float64]) -> str:
        """Return on which side of the car a point is, eight to choose from."""
        half = np.abs(np.asarray(self.car.outline_base)).max(axis=0)
        bearing = math.atan2(point[1] / half[1], point[0] / half[0])
        return _SIDES[round((bearing + math.pi) / (math.pi / 4.0)) % len(_SIDES)]

    def _advice(self, points: NDArray[np.float64], now: NDArray[np.float64], age_s: float, hold_s: float) -> str:
        """Return which ways the car could go, looked at coarsely: each is checked when it is commanded."""
        speed, lock = self.car.max_speed_mps, self.car.max_steering_rad
        ways = [Command(speed * sign, steering) for sign in (1.0, -1.0) for steering in (lock, 0.0, -lock)]
        rooms = self._rooms(points, now, [self._paths(way, age_s, hold_s) for way in ways], _COARSE).min(axis=1)
        free = [name for name, room in zip(_WAYS, rooms, strict=True) if room >= self.margin_m]
        return f"free at full speed: {', '.join(free)}" if free else "no way is free at full speed, go slower"

    def _clipped(self, command: Command) -> Command:
        most, lock = self.car.max_speed_mps, self.car.max_steering_rad
        return Command(max(-most, min(most, command.speed_mps)), max(-lock, min(lock, command.steering_rad)))

    def _advance(self, since_s: float) -> None:
        """Reckon how the car moves now, so long after the last check."""
        late = min(self.delay_s, since_s)
        phases = [(late, self._before), (since_s - late, self._last)]
        ends = [
            motion(self.car, self._speeds_mps[0], steering, phases, lag)
            for steering, lag in zip(self._steerings_rad, self._lags_s, strict=True)
        ]
        self._steerings_rad = tuple(end[2] for end in ends)
        self._speeds_mps = [ends[0][1]]
