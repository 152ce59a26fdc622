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
        n_rays = len(directions)
        self._range_max_m = range_max_m
        self._client_id = client_id
        self._beams_lidar = directions * np.float64(range_max_m)
        self._from_world = np.zeros((n_rays, 3))
        self._to_world = self._beams_lidar.copy()
        self._batches = [
            (self._from_world[i : i + MAX_RAYS_PER_CALL], self._to_world[i : i + MAX_RAYS_PER_CALL])
            for i in range(0, n_rays, MAX_RAYS_PER_CALL)
        ]

    def set_world(self, world: World) -> None:
        """Do nothing: the simulation puts the world into the client."""

    def cast(self, origin_world: NDArray[np.float64], rotation_world: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the (N,) range in m of each beam, the reach where there was no return (see `RayCaster`)."""
        self._from_world[:] = origin_world
        np.matmul(self._beams_lidar, rotation_world.T, out=self._to_world)
        self._to_world += origin_world
        with _garbage_collector_paused():
            hits = chain.from_iterable(self.trace())
            fractions = np.fromiter(map(_hit_fraction, hits), np.float32, len(self._beams_lidar))
            del hits
        fractions *= self._range_max_m
        return fractions

    def trace(self) -> list[tuple[Any, ...]]:
        """Return the raw hits of each batch, for the rays as last aimed."""
        with _garbage_collector_paused():
            return [
                pybullet.rayTestBatch(start, end, numThreads=1, physicsClientId=self._client_id)
                for start, end in self._batches
            ]
