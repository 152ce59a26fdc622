"""Stands between any driver and the wheels, and stops the car before it touches what its lidar shows."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.deploy.car import Car
from zebrat_bullet.deploy.decision import Decision
from zebrat_bullet.deploy.sweep import Outline, motion, scan_points
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.types import Command, FlatScan

MARGIN_M = 0.02
STEERING_LAG_S = 0.08
"""Time constant of PyBullet's steering: each physics step of 1/120 s closes a tenth of its error."""
_SAME_M = 1e-4
_SIDES = ("behind", "behind-right", "right", "ahead-right", "ahead", "ahead-left", "left", "behind-left")


class Supervisor:
    """Lets a command through, or stops the car and says why.

    **What is checked.** A command holds until the next check, `control_step_s` later, and should that stop the car, it
    brakes from there. The supervisor follows the outline along this path: first, for as long as the scan is old and a
    command takes to reach the motors, on as the last command had it; then a control step under the new one; then
    braking to rest. Speed changes by the car's deceleration (and 1.5 times that where it speeds up), steering turns
    from where it stands to where it is told, once at its rate and once with a servo's lag, and both paths count. The
    least gap between the outline and all returns of the scan, at poses 1 cm apart, is the clearance of the path.

    **What is refused.** A command whose path's clearance is less than the margin, and less than that of stopping at
    once. So a car within the margin, or in contact, may do all that brings it no nearer: back away, drive off, or on
    along a wall.

    **What a stop is.** Speed 0, and the wheels turn to the command's steering where braking with them so comes no
    nearer than with the steering of the last command, along which there was room to brake when it was let through;
    else these. Where the scan cannot be used it is the last command's steering.

    The lidar must not see the car itself: its returns would be contacts.

    Args:
        car: the car; its deceleration must be one that it can do at every steering.
        control_step_s: time until the next check.
        margin_m: how far every side of the outline is moved outwards.
        late_s: age at which a scan is too old; None: one control step.
        delay_s: time until a command reaches the motors.
        steering_lag_s: time constant of the steering.
        least_returns: fewest bearings with a return; a lidar that sees nothing cannot be told from a blind one.

    Raises:
        ConfigError: a number is not finite, below 0, or no control step.
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
        self._outline = Outline(car.outline_base)
        self.reset()

    def reset(self) -> None:
        """Begin anew with a car at rest whose wheels are straight."""
        raise NotImplementedError

    def check(
        self,
        command: Command,
        scan: FlatScan | None,
        speed_mps: float | None,
        steering_rad: float | None,
        age_s: float = 0.0,
    ) -> Decision:
        """Return the command, within the car's limits, or a stop and why.

        Args:
            command: what the driver wants.
            scan: what the lidar shows, all bearings of it; None: there is none.
            speed_mps: measured forward speed; None: as the commands so far should have brought it about.
            steering_rad: measured angle of the virtual centre wheel; None: likewise.
            age_s: how old the scan is.
        """
        raise NotImplementedError
