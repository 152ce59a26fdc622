"""Places to drive in: read, built, meshed and checked, without any simulator."""

from zebrat_bullet.world.generate import (
    FAMILIES,
    HELD_OUT_SEED,
    difficulty_of,
    generate_spec,
    generate_track,
    generate_tracks,
)
from zebrat_bullet.world.load import load_world
from zebrat_bullet.world.summary import world_summary
from zebrat_bullet.world.world import Mesh, Start, World

__all__ = [
    "FAMILIES",
    "HELD_OUT_SEED",
    "Mesh",
    "Start",
    "World",
    "difficulty_of",
    "generate_spec",
    "generate_track",
    "generate_tracks",
    "load_world",
    "world_summary",
]
