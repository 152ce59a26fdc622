"""The ray caster of the second engine: MuJoCo's mj_multiRay in the simulation's own scene."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import SimulationError
from zebrat_bullet.sim.mujoco.model import SEEN_GROUP, SceneHolder
from zebrat_bullet.world.world import World


class MujocoCaster:
    """Casts with `mj_multiRay`; the simulation owns walls and floor, and rays look at these alone."""

    def __init__(self, directions: NDArray[np.float32], range_max_m: float, client: SceneHolder) -> None:
        self._range_max_m = range_max_m
        self._client = client
        self._beams = directions.astype(np.float64)
        n_rays = len(directions)
        self._aimed = np.zeros((n_rays, 3))
        self._hit, self._ranges_m = np.zeros(n_rays, np.int32), np.zeros(n_rays)
        self._origin = np.zeros(3)
        self._n_aimed = n_rays
        self._seen = np.array([group == SEEN_GROUP for group in range(mujoco.mjNGROUP)], np.uint8)

    def set_world(self, world: World) -> None:
        """Do nothing: the simulation puts the world into the scene."""

    def cast(
        self,
        origin_world: NDArray[np.float64],
        rotation_world: NDArray[np.float64],
        beams: NDArray[np.intp] | None = None,
    ) -> NDArray[np.float32]:
        """Return the (M,) range in m of each beam, the reach where there was no return (see `RayCaster`)."""
        aimed = self._beams if beams is None else self._beams.take(beams, axis=0)
        self._n_aimed = len(aimed)
        np.matmul(aimed, rotation_world.T, out=self._aimed[: self._n_aimed])
        self._origin[:] = origin_world
        ranges = self.trace()
        ranges = np.where(ranges < 0.0, self._range_max_m, ranges)  # -1 where nothing was hit
        return np.minimum(ranges, self._range_max_m).astype(np.float32)

    def trace(self) -> NDArray[np.float64]:
        """Return MuJoCo's raw answer for the rays last aimed.

        Raises:
            SimulationError: the simulation is closed.
        """
        scene = self._client.scene
        if scene is None:
            raise SimulationError("the simulation whose scene the rays are cast in is closed; make another")
        n = self._n_aimed
        # Normals must be None, or the call wants room for them and slows down.
        mujoco.mj_multiRay(
            scene.model, scene.data, self._origin, self._aimed[:n].ravel(), self._seen, True, -1,
            self._hit[:n], self._ranges_m[:n], None, n, self._range_max_m,
        )  # fmt: skip
        return self._ranges_m[:n]
