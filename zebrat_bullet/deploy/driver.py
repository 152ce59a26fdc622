"""Drives a real car: what its lidar says in, speed and steering out, and a stop where that cannot be relied on."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.deploy.car import Car, differences
from zebrat_bullet.deploy.decision import Decision
from zebrat_bullet.deploy.definition import MODEL_FILE, Definition, read_definition
from zebrat_bullet.deploy.network import Network
from zebrat_bullet.deploy.senses import ScanReader, cloud_of
from zebrat_bullet.errors import ConfigError, PolicyError, SensorError
from zebrat_bullet.files import shown
from zebrat_bullet.sensing.flatten import flatten_cloud
from zebrat_bullet.types import Command, FlatScan

AHEAD_S = 0.02
"""A scan may be so far from the future: two clocks joined by NTP on one network differ by a few ms."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a driver takes for a scan that can be relied on.

    Attributes:
        stale_s: a scan that is older is refused; None: one and a half control steps, so that a car whose lidar dies
            is told to stop at the second step after that.
        least_points: returns of a cloud, anywhere within reach (the floor counts).
        least_sector_points: of these, in each eighth of a turn: a cloud of half a turn says nothing of the other half.
            0 for a lidar that does not see the floor, so that where the way is free nothing returns.
        least_share: returns of a 2D scan, as a share of its rays.
    """

    stale_s: float | None = None
    least_points: int = 100
    least_sector_points: int = 1
    least_share: float = 0.05

    def __post_init__(self) -> None:
        if self.stale_s is not None and not 0.0 < self.stale_s <= 10.0:
            raise ConfigError(f"stale_s must be above 0 and at most 10, got {self.stale_s}")
        if not 1 <= self.least_points <= 10_000_000:
            raise ConfigError(f"least_points must be 1 to 10,000,000, got {self.least_points}")
        if not 0 <= self.least_sector_points <= 10_000_000:
            raise ConfigError(f"least_sector_points must be 0 to 10,000,000, got {self.least_sector_points}")
        if not 0.0 < self.least_share <= 1.0:
            raise ConfigError(f"least_share must be above 0 and at most 1, got {self.least_share}")


class Driver:
    """An exported policy in a car. Call one of the `drive_` methods once a control step and send what it decides.

    Args:
        definition: what the policy observes and commands.
        network: the policy.
        limits: of what is refused.
        car: the real one; None: that of the definition.

    Attributes:
        definition: as given.
        car: the real one, or else that of the training.
        last_command: that the policy observes next; set it where another one was sent, as a supervisor does.
        last_scan: what the last call flattened, None where it was refused before that.
    """

    def __init__(
        self, definition: Definition, network: Network, limits: Limits | None = None, car: Car | None = None
    ) -> None:
        self.definition, self.car = definition, car or definition.car
        self._limits = limits or Limits()
        self._stale_s = self._limits.stale_s or 1.5 * definition.control_step_s
        self._network = network
        self._actions = definition.actions
        self._trail = definition.observation.new_trail(np.zeros((1, 2), dtype=np.float32))
        self._indices = np.array(definition.indices)
        self._rotation = np.array(definition.car.lidar_rotation_base)
        self._scans = ScanReader(definition.n_bearings, self._indices, self.range_max_m, self._limits.least_share)
        self.last_command: Command
        self.last_scan: FlatScan | None
        self.reset()

    @classmethod
    def load(cls, folder: str | Path, car: Car | None = None, limits: Limits | None = None) -> "Driver":
        """Load what `zebrat export` wrote. Nothing in it can run code.

        Args:
            folder: of `policy.json` and `policy.onnx`.
            car: the real one, to be compared with the one that the policy was trained for; how hard it brakes and how
                fast its steering turns may differ.
            limits: of what is refused.

        Raises:
            PolicyError: a file is missing, damaged, changed or not ours; or the car is another.
        """
        folder = Path(folder)
        definition = read_definition(folder)
        if car is not None:
            if not isinstance(car, Car):
                raise PolicyError(f"car must be a zebrat_bullet.deploy.Car, got {shown(repr(car))}")
            if different := differences(car, definition.car):
                raise PolicyError(
                    f"policy {definition.name!r} was trained for another car: {'; '.join(different)}; train and export "
                    "one for this car"
                )
        network = Network(folder / MODEL_FILE, definition.observation.size, definition.model_sha256)
        return cls(definition, network, limits, car)

    @property
    def range_max_m(self) -> float:
        """Reach of the lidar that the policy was trained with; what lies beyond is not seen."""
        return self.definition.observation.range_max_m

    def reset(self) -> None:
        """Begin anew: the car stands, its wheels are straight, it has come from nowhere."""
        self._trail.begin()
        self.last_command, self.last_scan = Command(0.0, 0.0), None

    def drive_cloud(
        self,
        points_lidar: NDArray[np.floating],
        age_s: float = 0.0,
        rotation_level: NDArray[np.floating] | None = None,
        height_m: float | None = None,
        since_s: float | None = None,
    ) -> Decision:
        """Decide by a revolution of a 3D lidar.

        Args:
            points_lidar: (N, 3) float32 or float64, m, lidar frame (x forward, y left, z up where it is mounted level).
                A point that is nan, infinite, the origin or out of reach is no return.
            age_s: time since the scan was taken.
            rotation_level: (3, 3), turns lidar-frame vectors into the gravity-levelled frame at the lidar, x along the
                car's heading; None: the car stands level, and the lidar on it as it is mounted.
            height_m: of the lidar above the floor; None: as it is mounted.
            since_s: time since the last call, for a policy with a memory; None: a control step.
        """
        definition = self.definition
        rotation = self._rotation if rotation_level is None else rotation_level
        height = definition.car.lidar_xyz_base[2] if height_m is None else height_m
        try:
            self.follow(since_s)
            self._check_age(age_s)
            limits = self._limits
            fewest = limits.least_points, limits.least_sector_points
            cloud = cloud_of(points_lidar, rotation, height, self.range_max_m, *fewest)
            scan = flatten_cloud(cloud, definition.flatten, definition.n_bearings, self.range_max_m)
            return self._drive(scan)
        except SensorError as error:
            return self._refuse(error)

    def drive_scan(
        self,
        ranges_m: NDArray[np.floating],
        angle_min_rad: float = -math.pi,
        angle_increment_rad: float | None = None,
        age_s: float = 0.0,
        since_s: float | None = None,
    ) -> Decision:
        """Decide by a scan of a 2D lidar, as ROS LaserScan, that stands level where the 3D one does.

        Args:
            ranges_m: (n,) float32 or float64, m; inf where the way is free, nan (or 0) where a ray was lost, -inf
                where something is too near to be measured.
            angle_min_rad: bearing of the first ray, counter-clockwise from straight ahead.
            angle_increment_rad: from ray to ray; None: n rays all around.
            age_s: time since the scan was taken.
            since_s: time since the last call, for a policy with a memory; None: a control step.
        """
        try:
            self.follow(since_s)
            self._check_age(age_s)
            return self._drive(self._scans.read(ranges_m, angle_min_rad, angle_increment_rad))
        except SensorError as error:
            return self._refuse(error)

    def follow(self, since_s: float | None = None) -> None:
        """Take it that the car has done for so long what it was told last; None: for a control step.

        The `drive_` methods do so themselves: call it before `last_command` is set without one of them.

        Raises:
            SensorError: that is no time.
        """
        self.last_scan = None
        if since_s is not None and not (isinstance(since_s, float | int | np.number) and 0.0 <= since_s < math.inf):
            raise SensorError(f"the time since the last call is finite and at least 0 s, got {shown(repr(since_s))}")
        last = _numbers(self.last_command)
        if np.isfinite(last).all():
            self._trail.follow(last, since_s)

    def _drive(self, scan: FlatScan) -> Decision:
        self.last_scan = scan
        last = self.last_command
        if not (math.isfinite(last.speed_mps) and math.isfinite(last.steering_rad)):
            self.last_command = Command(0.0, 0.0)
            raise SensorError(f"last_command must be finite, got {last}; set it to what was really sent")
        observation = self.definition.observation.encode_cars(
            scan.ranges_m[self._indices][None], _numbers(last), trail=self._trail.look()
        )
        action = self._network(observation)[0]
        if not np.isfinite(action).all():
            raise SensorError(
                f"the policy's action is {action.tolist()}, not two finite numbers: this is a bug of ours"
            )
        self.last_command = self._actions.decode(action)
        return Decision(self.last_command)

    def _refuse(self, error: SensorError) -> Decision:
        self.last_command = Command(0.0, self.last_command.steering_rad)
        return Decision(self.last_command, str(error))

    def _check_age(self, age_s: float) -> None:
        """Refuse a scan that is old, and one from the future, where the clocks of sensor and driver disagree."""
        if not isinstance(age_s, int | float | np.number):
            raise SensorError(f"a scan's age is a number of seconds, got {shown(repr(age_s))}")
        if age_s < -AHEAD_S:
            raise SensorError(
                f"the scan is from {-age_s:.3f} s in the future: the lidar's clock is ahead of this computer's; "
                "synchronise them"
            )
        if not age_s <= self._stale_s:
            raise SensorError(
                f"the scan is {age_s:.3f} s old, at most {self._stale_s:.3f} s are allowed; look whether the lidar is "
                "alive and its clock is right"
            )


def _numbers(command: Command) -> NDArray[np.float32]:
    """Return a command as (1, 2) numbers, m/s and rad."""
    return np.array([[command.speed_mps, command.steering_rad]], dtype=np.float32)
