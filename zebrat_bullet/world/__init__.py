"""Places to drive in: read, built, meshed and checked, without any simulator."""

from zebrat_bullet.world.load import load_world
from zebrat_bullet.world.world import Mesh, Start, World

__all__ = ["Mesh", "Start", "World", "load_world"]
