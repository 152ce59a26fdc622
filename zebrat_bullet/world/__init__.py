"""Places to drive in: read, built, meshed and checked, without any simulator."""

from zebrat_bullet.world.generate import (
    FAMILIES,
    HELD_OUT_SEED,
    check_family,
    difficulty_of,
    generate_spec,
    generate_track,
    generate_tracks,
)
from zebrat_bullet.world.goal import require_winnable
from zebrat_bullet.world.load import WorldNote, load_world, load_worlds, sketch_world
from zebrat_bullet.world.reference import anywhere, parse_reference, unique_names, world_labels, world_names
from zebrat_bullet.world.schema import WorldSpec, write_spec
from zebrat_bullet.world.summary import world_summary
from zebrat_bullet.world.world import Mesh, Start, World

__all__ = [
    "FAMILIES",
    "HELD_OUT_SEED",
    "Mesh",
    "Start",
    "World",
    "WorldNote",
    "WorldSpec",
    "anywhere",
    "check_family",
    "difficulty_of",
    "generate_spec",
    "generate_track",
    "generate_tracks",
    "load_world",
    "load_worlds",
    "parse_reference",
    "require_winnable",
    "sketch_world",
    "unique_names",
    "world_labels",
    "world_names",
    "world_summary",
    "write_spec",
]
