"""Drives planar cars from given starts to the ends of their episodes: how a policy is judged by the thousand."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.arrays import Array, like, on_host
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
    """

    outcome: NDArray[np.int8]
    n_steps: NDArray[np.int64]
    n_reversals: NDArray[np.int64]


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
    direction = np.zeros(drive.n_cars)
    observation: Array = drive.begin_unchecked(worlds, poses)
    step = 0
    while not outcome.all():
        step += 1
        actions = like(act(on_host(observation)), observation)
        now = np.sign(on_host(actions)[:, 0])
        result = drive.step(actions)
        observation = result.observation
        n_reversals += (outcome == 0) & (now * direction < 0)
        direction = np.where(now == 0, direction, now)
        first = result.ended[outcome[result.ended] == 0]  # a car whose episode is over goes on with others
        outcome[first], n_steps[first] = on_host(result.outcome)[first], step
        if len(first):
            on_end(len(first))
    return Trial(outcome, n_steps, n_reversals)
