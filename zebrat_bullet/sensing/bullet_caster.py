"""The reference ray caster: PyBullet's rayTestBatch in the simulation's own client."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from operator import itemgetter
from typing import Any

import numpy as np
import pybullet
from numpy.typing import NDArray

from zebrat_bullet.world.world import World

MAX_RAYS_PER_CALL = 16_383  # at 16,384, PyBullet's documented limit, one ray is lost (bullet3 issue 4215)

_hit_fraction = itemgetter(2)


@contextmanager
def _garbage_collector_paused() -> Iterator[None]:
    """Hold off the collector: a batch makes three tuples a ray, and walking them takes a sixth of the whole cast."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class BulletCaster:
    """Casts with `rayTestBatch`; the simulation owns walls and floor and hides the car from the rays."""

    def __init__(self, directions: NDArray[np.float32], range_max_m: float, client_id: int) -> None:
        self._range_max_m = range_max_m
        self._client_id = client_id
        self._beams_lidar = directions * np.float64(range_max_m)
        self._from_world = np.zeros_like(self._beams_lidar)
        self._to_world = self._beams_lidar.copy()
        self._n_aimed = len(directions)

    def set_world(self, world: World) -> None:
        """Do nothing: the simulation puts the world into the client."""

    def cast(
        self,
        origin_world: NDArray[np.float64],
        rotation_world: NDArray[np.float64],
        beams: NDArray[np.intp] | None = None,
    ) -> NDArray[np.float32]:
        """Return the (M,) range in m of each beam, the reach where there was no return (see `RayCaster`)."""
        aimed = self._beams_lidar if beams is None else self._beams_lidar.take(beams, axis=0)
        self._n_aimed = len(aimed)
        to_world = self._to_world[: self._n_aimed]
        np.matmul(aimed, rotation_world.T, out=to_world)
        to_world += origin_world
        self._from_world[: self._n_aimed] = origin_world
        with _garbage_collector_paused():
            hits = chain.from_iterable(self.trace())
            fractions = np.fromiter(map(_hit_fraction, hits), np.float32, self._n_aimed)
            del hits
        fractions *= self._range_max_m
        return fractions

    def trace(self) -> list[tuple[Any, ...]]:
        """Return the raw hits of each batch, for the rays last aimed."""
        start, end = self._from_world[: self._n_aimed], self._to_world[: self._n_aimed]
        batches = [slice(i, i + MAX_RAYS_PER_CALL) for i in range(0, self._n_aimed, MAX_RAYS_PER_CALL)]
        with _garbage_collector_paused():
            return [
                pybullet.rayTestBatch(start[batch], end[batch], numThreads=1, physicsClientId=self._client_id)
                for batch in batches
            ]
