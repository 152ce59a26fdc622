"""Drives planar cars from given starts to the ends of their episodes: how a policy is judged by the thousand."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.arrays import Array, like, on_host
from zebrat_bullet.geometry import driven_forward
from zebrat_bullet.planar.drive import PlanarDrive

Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""(N, size) observations in, (N, 2) actions out."""


@dataclass(frozen=True, slots=True)
class Trial:
    """How N episodes ended.

    Attributes:
        outcome: (N,) int8, codes of `Outcome`.
        n_steps: (N,) control steps that each took.
        n_reversals: (N,) how often the commanded speed changed its sign; standing still between does not count.
        backed_m: (N,) the longest way in m that each drove back in one go.
    """

    outcome: NDArray[np.int8]
    n_steps: NDArray[np.int64]
    n_reversals: NDArray[np.int64]
    backed_m: NDArray[np.float64]


def drive_out(
    drive: PlanarDrive,
    act: Act,
    worlds: NDArray[np.int32],
    poses: NDArray[np.float64],
    on_end: Callable[[int], None] = lambda n: None,
) -> Trial:
    """Drive every car of `drive` from its start until its episode is over.

    Args:
        drive: N cars.
        act: the driver.
        worlds: (N,) in which world each begins.
        poses: (N, 3) where, world frame.
        on_end: called with the number of episodes that have just ended.
    """
    outcome = np.zeros(drive.n_cars, dtype=np.int8)
    n_steps, n_reversals = (np.zeros(drive.n_cars, dtype=np.int64) for _ in range(2))
    direction, reached_m, furthest_m, backed_m = np.zeros((4, drive.n_cars))
    observation: Array = drive.begin_unchecked(worlds, poses)
    before = drive.poses()
    step = 0
    while not outcome.all():
        step += 1
        actions = like(act(on_host(observation)), observation)
        now = np.sign(on_host(actions)[:, 0])
        result = drive.step(actions)
        observation = result.observation
        under_way = outcome == 0  # a car whose episode is over goes on with others
        n_reversals += under_way & (now * direction < 0)
        direction = np.where(now == 0, direction, now)
        next_before = drive.poses()
        after = next_before.copy()
        after[result.ended] = result.last_pose
        reached_m += np.where(under_way, driven_forward(before, after), 0.0)
        np.maximum(furthest_m, reached_m, out=furthest_m)
        np.maximum(backed_m, furthest_m - reached_m, out=backed_m)
        before = next_before
        first = result.ended[under_way[result.ended]]
        outcome[first], n_steps[first] = on_host(result.outcome)[first], step
        if len(first):
            on_end(len(first))
    return Trial(outcome, n_steps, n_reversals, backed_m)
