"""One picture a frame: chase view beside top view in one window, with the numbers on a panel below."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from zebrat_bullet.render.osmesa import offscreen_window  # before any other import of VTK

from vtkmodules.util.numpy_support import vtk_to_numpy  # isort: skip
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray  # isort: skip

from zebrat_bullet.errors import RenderError
from zebrat_bullet.render.cameras import ChaseCamera, TopCamera
from zebrat_bullet.render.frame import Frame
from zebrat_bullet.render.hud import Hud
from zebrat_bullet.render.scene import Scene
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.world.world import World

_CHASE_SHARE = 0.6
_GUTTER_PX = 2
# Drawn this much larger each way and averaged: cheaper in software than four-sample antialiasing (49 for 71 ms of CPU).
_OVERSAMPLING = 2
_LINE_PX = 2.5
_MIN_SIZE_PX = (320, 180)


class Renderer:
    """Draws a car in a world off screen, through OSMesa.

    Args:
        robot: the car; its URDF's visuals are drawn.
        world: the walls.
        width, height: size of the picture in px.

    Attributes:
        world: as given.

    Raises:
        MissingSystemLibraryError: libOSMesa is absent.
        RenderError: the picture is too small for two views and a panel.
    """

    def __init__(self, robot: RobotModel, world: World, width: int = 960, height: int = 540) -> None:
        if width < _MIN_SIZE_PX[0] or height < _MIN_SIZE_PX[1]:
            raise RenderError(f"a picture needs at least {_MIN_SIZE_PX[0]}x{_MIN_SIZE_PX[1]} px, got {width}x{height}")
        self.world = world
        self._hud = Hud(width, height)
        self._size = _OVERSAMPLING * width, _OVERSAMPLING * (height - self._hud.height)
        self._window = offscreen_window(*self._size)
        self._scene = Scene(robot, world, _OVERSAMPLING * _LINE_PX)
        gutter = _GUTTER_PX / width
        chase = self._scene.renderer((0.0, 0.0, _CHASE_SHARE, 1.0))
        top = self._scene.renderer((_CHASE_SHARE + gutter, 0.0, 1.0, 1.0))
        self._window.AddRenderer(chase)
        self._window.AddRenderer(top)
        self._chase, self._top = ChaseCamera(chase.GetActiveCamera()), TopCamera(top.GetActiveCamera())
        self._pixels = vtkUnsignedCharArray()

    def frame(self, frame: Frame) -> NDArray[np.uint8]:
        """Return the (height, width, 3) picture of one moment."""
        self._scene.show(frame)
        self._chase.follow(frame.pose, frame.time_s)
        self._top.follow(frame.pose)
        self._window.Render()
        return np.concatenate([self._read_pixels(), self._hud.panel(frame)])

    def capabilities(self) -> str:
        """Return what OpenGL says of itself: vendor, renderer, version."""
        return self._window.ReportCapabilities()

    @property
    def window_class(self) -> str:
        """VTK's name for the kind of window in use."""
        return self._window.GetClassName()

    def close(self) -> None:
        """Free the window's buffers; the renderer is of no use afterwards."""
        self._window.Finalize()

    def _read_pixels(self) -> NDArray[np.uint8]:
        width, height = self._size
        self._window.GetPixelData(0, 0, width - 1, height - 1, 0, self._pixels, 0)
        # OpenGL counts rows from the bottom.
        upside_down = Image.fromarray(vtk_to_numpy(self._pixels).reshape(height, width, 3))
        return np.asarray(upside_down.reduce(_OVERSAMPLING))[::-1]
