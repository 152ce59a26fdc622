"""Places to drive in: read, built, meshed and checked, without any simulator."""

from zebrat_bullet.world.generate import generate_track
from zebrat_bullet.world.load import load_world
from zebrat_bullet.world.summary import world_summary
from zebrat_bullet.world.world import Mesh, Start, World

__all__ = ["Mesh", "Start", "World", "generate_track", "load_world", "world_summary"]
