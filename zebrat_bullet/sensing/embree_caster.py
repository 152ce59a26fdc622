"""The fast ray caster: Open3D's RaycastingScene (Embree) over the world's wall mesh."""

from collections import OrderedDict

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from zebrat_bullet.world.world import World

MAX_SCENES = 128  # training goes round about a hundred generated worlds
FLOOR_MARGIN_M = 50.0


class EmbreeCaster:
    """Casts with `RaycastingScene.cast_rays` on one thread, keeping the scenes of the latest worlds."""

    def __init__(self, directions: NDArray[np.float32], range_max_m: float) -> None:
        n_rays = len(directions)
        self._range_max_m = np.float32(range_max_m)
        # One product [direction, 1] @ [[0, R^T], [origin, 0]] fills the (origin, direction) rows that Open3D wants.
        self._beams = np.hstack([directions, np.ones((n_rays, 1), np.float32)])
        self._aim = np.zeros((4, 6), np.float32)
        self._rays = np.zeros((n_rays, 6), np.float32)
        self._ray_tensor = o3d.core.Tensor.from_numpy(self._rays)  # shares the array's memory
        self._n_aimed = n_rays
        self._scene: o3d.t.geometry.RaycastingScene | None = None
        # Keyed by identity; each entry holds its world, so that no id is reused while it is a key.
        self._scenes: OrderedDict[int, tuple[World, o3d.t.geometry.RaycastingScene]] = OrderedDict()

    def set_world(self, world: World) -> None:
        """Cast against this world from now on; its scene is built once and kept."""
        key = id(world)
        if key not in self._scenes:
            self._scenes[key] = (world, _build_scene(world))
            if len(self._scenes) > MAX_SCENES:
                self._scenes.popitem(last=False)
        self._scenes.move_to_end(key)
        self._scene = self._scenes[key][1]

    def cast(
        self,
        origin_world: NDArray[np.float64],
        rotation_world: NDArray[np.float64],
        beams: NDArray[np.intp] | None = None,
    ) -> NDArray[np.float32]:
        """Return the (M,) range in m of each beam, the reach where there was no return (see `RayCaster`)."""
        self._aim[:3, 3:] = rotation_world.T
        self._aim[3, :3] = origin_world
        aimed = self._beams if beams is None else self._beams.take(beams, axis=0)
        self._n_aimed = len(aimed)
        np.matmul(aimed, self._aim, out=self._rays[: self._n_aimed])
        ranges: NDArray[np.float32] = self.trace()["t_hit"].numpy()
        return np.minimum(ranges, self._range_max_m, out=ranges)

    def trace(self) -> dict[str, o3d.core.Tensor]:
        """Return Open3D's raw answer for the rays last aimed.

        Raises:
            RuntimeError: `set_world` was never called.
        """
        if self._scene is None:
            raise RuntimeError("no world to cast against; call set_world first")
        return self._scene.cast_rays(self._ray_tensor[: self._n_aimed], nthreads=1)


def _build_scene(world: World) -> o3d.t.geometry.RaycastingScene:
    """Put the walls and a floor that reaches far beyond them into a new scene."""
    vertices, faces = world.mesh.vertices.reshape(-1, 3), world.mesh.faces.reshape(-1, 3)
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    if len(faces):
        scene.add_triangles(_tensor(vertices, np.float32), _tensor(faces, np.uint32))
    ground = np.vstack([vertices[:, :2], [[0.0, 0.0]]])
    (x0, y0), (x1, y1) = ground.min(axis=0) - FLOOR_MARGIN_M, ground.max(axis=0) + FLOOR_MARGIN_M
    floor = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    scene.add_triangles(_tensor(floor, np.float32), _tensor(np.array([[0, 1, 2], [0, 2, 3]]), np.uint32))
    return scene


def _tensor(array: NDArray[np.generic], dtype: type) -> o3d.core.Tensor:
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array, dtype))
