"""One interface for the ray casters."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.sim.engine import require_engine
from zebrat_bullet.world.world import World


class RayCaster(Protocol):
    """Casts a fixed set of beams, or some of them, from any pose, against the walls of a world and the floor z = 0."""

    def set_world(self, world: World) -> None:
        """Cast against this world from now on."""

    def cast(
        self,
        origin_world: NDArray[np.float64],
        rotation_world: NDArray[np.float64],
        beams: NDArray[np.intp] | None = None,
    ) -> NDArray[np.float32]:
        """Return the (M,) range in m of each beam; exactly the reach of the lidar where there was no return.

        Args:
            origin_world: (3,) position of the lidar in m.
            rotation_world: (3, 3) turns vectors of the lidar frame into the world frame.
            beams: (M,) which of the N beams to cast, None for all; each gets the same range either way.
        """

    def trace(self) -> object:
        """Repeat the library's own call for the beams that `cast` last aimed, the bare cast of a benchmark."""


def make_caster(name: str, directions: NDArray[np.float32], range_max_m: float, client: object) -> RayCaster:
    """Return the caster called "bullet", "mujoco" or "embree"; each library is loaded only when it is asked for.

    Args:
        name: which one.
        directions: (N, 3) unit vectors in the lidar frame.
        range_max_m: reach of the lidar.
        client: of the simulation that holds walls and floor, which "bullet" and "mujoco" cast in; None: there is none.

    Raises:
        ConfigError: the caster of an engine was asked for without a simulation in it.
    """
    if name == "embree":
        from zebrat_bullet.sensing.embree_caster import EmbreeCaster

        return EmbreeCaster(directions, range_max_m)
    if name == "mujoco":
        return _mujoco_caster(directions, range_max_m, client)
    if not isinstance(client, int):
        remedy = "pass its client_id, or use" if client is None else "with that engine let lidar.caster be 'mujoco' or"
        raise ConfigError(
            f"caster 'bullet' casts in a PyBullet simulation's client, got {_kind(client)}; {remedy} 'embree'"
        )
    from zebrat_bullet.sensing.bullet_caster import BulletCaster

    return BulletCaster(directions, range_max_m, client)


def _mujoco_caster(directions: NDArray[np.float32], range_max_m: float, client: object) -> RayCaster:
    require_engine("mujoco")
    from zebrat_bullet.sensing.mujoco_caster import MujocoCaster
    from zebrat_bullet.sim.mujoco.model import SceneHolder

    if not isinstance(client, SceneHolder):
        raise ConfigError(
            f"caster 'mujoco' casts in a MuJoCo simulation's scene, got {_kind(client)}; drive with the engine "
            "'mujoco' (task.physics.engine), or use 'embree'"
        )
    return MujocoCaster(directions, range_max_m, client)


def _kind(client: object) -> str:
    return "PyBullet's" if isinstance(client, int) else "none" if client is None else "MuJoCo's"
