"""Registers one gymnasium id a world: `ZebraT/BigTrack-v0`, `ZebraT/Track1-v0`, ... (and any world by keyword)."""

import gymnasium

from zebrat_bullet.assets import list_assets


def env_id(world: str) -> str:
    """Return the gymnasium id of a shipped world, e.g. "big_track" -> "ZebraT/BigTrack-v0"."""
    return f"ZebraT/{''.join(part.capitalize() for part in world.split('_'))}-v0"


def register_envs() -> None:
    """Register every shipped world; called by gymnasium through the package's entry point."""
    for world in list_assets("worlds", ".yaml"):
        if env_id(world) not in gymnasium.registry:
            gymnasium.register(
                env_id(world), entry_point="zebrat_bullet.envs.zebrat_env:ZebratEnv", kwargs={"world": world}
            )
