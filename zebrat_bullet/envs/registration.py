"""Registers two gymnasium ids a world, `ZebraT/BigTrack-v0` and, with the six actions, `ZebraT/BigTrackDiscrete-v0`.

And `ZebraT/Planar-v0`, for `gymnasium.make_vec` alone: planar cars by the thousand.
"""

import gymnasium

from zebrat_bullet.assets import list_assets

PLANAR_ID = "ZebraT/Planar-v0"


def env_id(world: str, discrete: bool = False) -> str:
    """Return the gymnasium id of a shipped world, e.g. "big_track" -> "ZebraT/BigTrack-v0"."""
    name = "".join(part.capitalize() for part in world.split("_"))
    return f"ZebraT/{name}{'Discrete' if discrete else ''}-v0"


def register_envs() -> None:
    """Register every shipped world and the planar cars."""
    if PLANAR_ID not in gymnasium.registry:
        where = "zebrat_bullet.envs.planar_env"
        gymnasium.register(PLANAR_ID, f"{where}:refuse_single", vector_entry_point=f"{where}:make_planar")
    for world in list_assets("worlds", ".yaml"):
        for discrete in (False, True):
            if env_id(world, discrete) not in gymnasium.registry:
                gymnasium.register(
                    env_id(world, discrete),
                    entry_point="zebrat_bullet.envs.zebrat_env:ZebratEnv",
                    kwargs={"world": world, "discrete": discrete},
                )
