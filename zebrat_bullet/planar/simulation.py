"""Motion, contact and scan of N planar cars; knows nothing of tasks, rewards or episodes."""

import ctypes.util
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext

import numpy as np
import warp as wp
from numpy.typing import NDArray

from zebrat_bullet.arrays import Array
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.planar.atlas import CELL_M, Chart, bind, chart
from zebrat_bullet.planar.car import ROLLING, planar_car, to_device
from zebrat_bullet.planar.kernels.drive import make_drive
from zebrat_bullet.planar.kernels.look import N_RAYS_ABREAST, look
from zebrat_bullet.planar.kernels.walls import Walls
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.values import of_kind, whole_number
from zebrat_bullet.world import World

CARS_ABREAST = 16
"""Cars that one thread of a processor drives together, by SIMD; on a GPU each car is a thread."""


class PlanarSimulation:
    """N cars, each in one of W worlds; every array is on one device, as NumPy (cpu) or torch (cuda) sees it.

    A world's positions are relative to its `origin`.

    Args:
        robot: the car.
        task: physics, lidar and noise.
        indices: (B,) ascending scan indices of the bearings to look along.
        worlds: where; `add_worlds` brings more.
        n_cars: N.
        device: "cpu", "cuda" or "cuda:0", ...

    Attributes:
        pose: (N, 3) float32, x, y in m and yaw in rad of the body's middle.
        motion: (N, 4) float32: left and right knuckle in rad, speed in m/s and yaw rate in rad/s of the rear axle.
        contact: (N,) bool, the body touched a wall in the last step, and the car went no further in it.
        ranges: (N, B) float32, m.
        command: (N, 2) float32, m/s and rad; `step` drives what stands here.
        origin: (W, 2) float64, m, world frame.

    Raises:
        ConfigError: there is no such device, or its memory does not hold so many cars.
        WorldError: the height band cannot see a world's walls whole.
    """

    def __init__(
        self,
        robot: RobotModel,
        task: TaskConfig,
        indices: NDArray[np.intp],
        worlds: Sequence[World],
        n_cars: int,
        device: str = "cpu",
    ) -> None:
        n_cars = whole_number(n_cars, "n_cars", 1, 10**15)
        self.device = find_device(device)
        self._n_abreast = CARS_ABREAST if self.device == "cpu" else 1
        self._physics, self._reach_m = task.physics, task.lidar.range_max_m
        self._car = planar_car(robot, task, indices)
        self._charts: list[Chart] = []
        car = self._car
        self._corners, self._sides = self._upload(car.corners, wp.vec2), self._upload(car.sides, wp.vec3)
        self._rays = self._upload(car.rays, wp.vec2)
        self._channels = self._upload(car.channels, wp.float32)
        self.add_worlds(worlds)
        try:
            self._require_memory(n_cars, len(indices))
            self._allocate(n_cars, len(indices))
        except (RuntimeError, MemoryError, ValueError) as error:
            raise ConfigError(f"{n_cars} cars do not fit into the memory of {device!r}: {error}") from error

    def _upload(self, values: NDArray, dtype: type) -> wp.array:
        with self._in_order():
            return to_device(values, dtype, self.device)

    def _in_order(self) -> AbstractContextManager[object]:
        """Queue what Warp does on a GPU behind what torch has queued there, and before what it queues next."""
        return nullcontext() if self.device == "cpu" else wp.ScopedStream(wp.stream_from_torch(self.device))

    def _require_memory(self, n: int, n_rays: int) -> None:
        """Raise MemoryError where a processor's arrays would not fit: Linux gives the memory and kills who fills it."""
        needed, there = 4 * n * (n_rays + 22), os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if self.device == "cpu" and needed > there:
            raise MemoryError(f"their arrays take {needed / 2**30:.0f} GiB of {there / 2**30:.0f} GiB")

    def _allocate(self, n: int, n_rays: int) -> None:
        def made(shape: int | tuple[int, int], dtype: type) -> tuple[wp.array, Array]:
            with self._in_order():
                array = wp.zeros(shape, dtype=dtype, device=self.device)
                return array, self._view(array)

        self._world, self.world = made(n, wp.int32)
        self._pose, self.pose = made(n, wp.vec3)
        self._motion, self.motion = made(n, wp.vec4)
        self._clear, self._clear_view = made(n, wp.float32)
        self._contact, self.contact = made(n, wp.bool)
        self._ranges, self.ranges = made((n, n_rays), wp.float32)
        self._command, self.command = made(n, wp.vec2)
        self._asked, self._asked_view = made(n, wp.vec2)
        self._dynamics, self._dynamics_view = made((n, 5), wp.float32)
        self._margin, self.margin = made(n, wp.float32)
        self._draws, self.draws = made(n, wp.int32)
        self._everyone = self._upload(np.arange(n), wp.int32)

    def _view(self, array: wp.array) -> Array:
        return array.numpy() if self.device == "cpu" else wp.to_torch(array)

    def add_worlds(self, worlds: Sequence[World]) -> None:
        """Add worlds behind those there are; cars may be placed in them from now on.

        Raises:
            WorldError: the height band cannot see the walls of one whole.
        """
        for world in worlds:
            require_planar(of_kind(world, World, "a world", "give load_world(...)"))
        near_m = self._car.circumradius_m + self._car.data.near
        self._charts += [chart(world, near_m, self._reach_m) for world in worlds]
        atlas = bind(self._charts)
        self.origin = atlas.origin
        walls = Walls()
        walls.segments = self._upload(atlas.segments, wp.vec4)
        walls.grid = self._upload(atlas.grid, wp.vec4)
        walls.first_cell = self._upload(atlas.first_cell, wp.int32)
        walls.cells = self._upload(atlas.cells, wp.vec2i)
        walls.near_far = self._upload(atlas.near_far, wp.int32)
        walls.all_first = self._upload(atlas.all_first, wp.int32)
        walls.all_last = self._upload(atlas.all_last, wp.int32)
        walls.cells_per_m = 1.0 / CELL_M
        self._walls = walls

    def place(self, cars: Array, worlds: Array, poses: Array, dynamics: Array) -> None:
        """Stand some cars still, wheels straight.

        Args:
            cars: (K,) which.
            worlds: (K,) in which world each.
            poses: (K, 3) where, relative to the world's origin.
            dynamics: (K, 5), as `draw_dynamics` returns them.
        """
        self.world[cars], self.pose[cars] = worlds, poses
        self.motion[cars], self._clear_view[cars] = 0.0, 0.0
        self._asked_view[cars, 0], self._asked_view[cars, 1] = 0.0, dynamics[:, 2]  # a late command follows this one
        self.contact[cars] = False
        self._dynamics_view[cars] = dynamics
        self._dynamics_view[cars, 3] *= ROLLING
        self._dynamics_view[cars, 4] = (dynamics[:, 4] * self._physics.rate_hz).round()

    def step(self) -> None:
        """Drive every car one control step as `command` says; it must be finite and within the limits."""
        outline = [self._car.data, self._corners, self._sides]
        asked = [self._world, self._dynamics, self._margin, self._command, self._physics.max_steering_rad, self._asked]
        state = [self._pose, self._motion, self._clear, self._contact]
        n_threads = -(-len(self._pose) // self._n_abreast)
        with self._in_order():
            wp.launch(
                make_drive(self._n_abreast), n_threads, [*outline, self._walls, *asked, *state], device=self.device
            )

    def look(self, cars: NDArray[np.intp] | None = None) -> None:
        """Cast the rays of some cars, or of all, from where they stand; the noise of each is a function of its `draws`.

        Args:
            cars: (K,) which; None for all.
        """
        who = self._everyone if cars is None else self._upload(cars, wp.int32)
        place = [self._car.data, self._walls, self._world, self._pose]
        beams = [self._rays, self._channels, self._draws]
        shape, inputs = (len(who), len(self._rays) // N_RAYS_ABREAST), [*place, *beams, who, self._ranges]
        with self._in_order():
            wp.launch(look, shape, inputs, device=self.device)

    def wait(self) -> None:
        """Wait until the device has done all that it was asked to."""
        wp.synchronize_device(self.device)

    def state(self) -> dict[str, Array]:
        """Return the arrays that say where every car is and what it does, by name; not copies."""
        return {
            **{"world": self.world, "pose": self.pose, "motion": self.motion, "contact": self.contact},
            **{"clear": self._clear_view, "asked": self._asked_view, "dynamics": self._dynamics_view},
            "margin": self.margin,
            **{"draws": self.draws, "ranges": self.ranges},
        }


def device_name(name: str) -> str:
    """Return what a device is called, "cpu" or the GPU's name.

    Raises:
        ConfigError: it is unknown, or not there; the message lists those there are.
    """
    alias = find_device(name)
    return alias if alias == "cpu" else str(wp.get_device(alias).name)


def find_device(name: str) -> str:
    """Return the device that a name means.

    Raises:
        ConfigError: it is unknown, or not there; the message lists those there are.
    """
    wp.config.log_level = wp.LOG_WARNING
    with _no_warning_of_no_gpu():
        wp.init()
    there = ["cpu", *(device.alias for device in wp.get_cuda_devices())]
    alias = "cuda:0" if name == "cuda" else name
    if alias not in there:
        raise ConfigError(f"device must be one of {', '.join(there)} on this machine, got {name!r}")
    return alias


@contextmanager
def _no_warning_of_no_gpu() -> Iterator[None]:
    """Keep off the standard error what Warp's library writes there on every machine without a GPU's driver."""
    if ctypes.util.find_library("cuda"):
        yield
        return
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def require_planar(world: World) -> None:
    """Refuse a world that a plane cannot stand for.

    Raises:
        WorldError: some of its walls are not seen from top to bottom of the height band.
    """
    if not world.low_obstacles.is_empty:
        raise WorldError(
            f"{world.name}: has walls under 0.8 m (`low`), which the lidar loses near by and a plane cannot lose; "
            "drive it in PyBullet, or make them higher"
        )
