"""Pictures of the car in its world through VTK and OSMesa; it draws states and never steps physics."""

from zebrat_bullet.render.frame import Frame
from zebrat_bullet.render.live import live_frame
from zebrat_bullet.render.renderer import Renderer

__all__ = ["Frame", "Renderer", "live_frame"]
