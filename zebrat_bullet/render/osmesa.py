"""The off-screen window: Mesa's software renderer in plain memory; no X server, no GPU, no EGL device.

VTK picks its window class when a window is made and prefers EGL where libEGL exists, so the class is asked for by name
and checked. Without libOSMesa VTK warns and then crashes the interpreter, so the library is looked for first.
"""

import contextlib
import ctypes
import importlib
import os

from zebrat_bullet.errors import MissingSystemLibraryError, RenderError

WINDOW_CLASS = "vtkOSOpenGLRenderWindow"
_LIBRARIES = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")

os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = WINDOW_CLASS

# Only now: the variable has to stand before VTK is imported.
from vtkmodules import vtkRenderingFreeType, vtkRenderingOpenGL2  # noqa: E402, F401
from vtkmodules.vtkRenderingCore import vtkRenderWindow  # noqa: E402


def require_osmesa(names: tuple[str, ...] = _LIBRARIES) -> None:
    """Check that one of the shared libraries `names` can be loaded.

    Raises:
        MissingSystemLibraryError: none can; says which package brings it.
    """
    for name in names:
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return
    raise MissingSystemLibraryError(
        f"rendering without a screen needs OSMesa, and none of {', '.join(names)} can be loaded; "
        "install it with: apt-get install libosmesa6"
    )


def load_triton() -> None:
    """Load Triton, which torch's CUDA builds bring, where it is installed; to be done before VTK loads OSMesa.

    VTK makes the LLVM of OSMesa visible to every library loaded later, and Triton, which holds an LLVM of its own, then
    crashes the interpreter: a camera image, then an optimizer of torch, would end in a segmentation fault.
    """
    with contextlib.suppress(ImportError):
        importlib.import_module("triton._C.libtriton")


def offscreen_window(width: int, height: int) -> vtkRenderWindow:
    """Return an off-screen window of `width` x `height` pixels, one sample each.

    Raises:
        MissingSystemLibraryError: libOSMesa is absent.
        RenderError: VTK made a window of another class.
    """
    require_osmesa()
    load_triton()
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = WINDOW_CLASS
    window = vtkRenderWindow()
    if window.GetClassName() != WINDOW_CLASS:
        raise RenderError(
            f"VTK made a {window.GetClassName()}, rendering needs {WINDOW_CLASS}: import zebrat_bullet.render before "
            "vtk or pyvista, and use VTK 9.5 or newer (pip install 'vtk>=9.5')"
        )
    window.SetOffScreenRendering(True)
    window.SetMultiSamples(0)
    window.SetSize(width, height)
    return window
