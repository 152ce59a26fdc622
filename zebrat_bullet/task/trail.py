"""Where a car was some control steps ago, reckoned from its own commands: the memory of a policy that has one."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.arrays import Array, namespace

PARTS = 4
"""Numbers that say where a car was: x, y, and sine and cosine of its yaw."""


class Trail:
    """Dead reckoning of N cars by the bicycle model, from what they were told since their episodes began.

    It needs no odometry, and errs by as much as a car does not do what it is told.

    Args:
        steps: (L,) how many control steps ago; with none nothing is remembered.
        control_step_s, wheelbase_m: of the cars.
        command: (N, 2), whose library and device hold the trail.
    """

    def __init__(self, steps: Sequence[int], control_step_s: float, wheelbase_m: float, command: Array) -> None:
        self._steps = list(steps)
        self._step_s, self._wheelbase_m = control_step_s, wheelbase_m
        xp = namespace(command)
        # (K, N, 3): x, y, yaw of the rear axle in the frame where it began; the newest first.
        self._poses = xp.stack([xp.zeros_like(command[:, [0, 0, 0]])] * (max(self._steps, default=0) + 1))

    def begin(self, cars: NDArray[np.intp] | slice = slice(None)) -> None:
        """Let some cars have stood since ever where they are."""
        self._poses[:, cars] = 0.0

    def follow(self, command: Array, step_s: float | None = None) -> None:
        """Go on by one step, None: a control step, in which the cars were told (N, 2) commands, in m/s and rad."""
        if not self._steps:
            return
        xp, (x, y, yaw) = namespace(command), self._poses[0].T
        run = command[:, 0] * (self._step_s if step_s is None else step_s)
        turn = run * xp.tan(command[:, 1]) / self._wheelbase_m
        middle = yaw + turn / 2.0
        now = xp.stack([x + run * xp.cos(middle), y + run * xp.sin(middle), yaw + turn], axis=-1)
        self._poses = xp.concat([now[None], self._poses[:-1]])

    def look(self, cars: NDArray[np.intp] | slice = slice(None)) -> Array:
        """Return (n, L * PARTS) of some cars: for each step, where they were in the frame of their rear axle now."""
        now = self._poses[0, cars]
        if not self._steps:
            return now[:, :0]
        xp, then = namespace(now), self._poses[self._steps][:, cars]
        dx, dy, turned = (then[..., i] - now[:, i] for i in range(3))
        cos, sin = xp.cos(now[:, 2]), xp.sin(now[:, 2])
        seen = xp.stack([dx * cos + dy * sin, dy * cos - dx * sin, xp.sin(turned), xp.cos(turned)], axis=-1)
        return xp.concat(list(seen), axis=-1)

    def state(self) -> dict[str, Array]:
        """Return the array that holds it; whoever writes into it changes it."""
        return {"trail": self._poses} if self._steps else {}
