"""NumPy arrays into VTK poly data and actors; the only place that knows VTK's array layout."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

Color = tuple[float, float, float]


def _cells(ids: ArrayLike, cell_size: int) -> vtkCellArray:
    connectivity = np.ascontiguousarray(ids, dtype=np.int64).ravel()
    offsets = np.arange(0, connectivity.size + 1, cell_size, dtype=np.int64)
    cells = vtkCellArray()
    cells.SetData(numpy_to_vtkIdTypeArray(offsets, deep=1), numpy_to_vtkIdTypeArray(connectivity, deep=1))
    return cells


def _set_positions(data: vtkPolyData, points: ArrayLike) -> None:
    positions = vtkPoints()
    positions.SetData(numpy_to_vtk(np.ascontiguousarray(points, dtype=np.float32), deep=1))
    data.SetPoints(positions)


def set_colors(data: vtkPolyData, colors: NDArray[np.uint8]) -> None:
    """Paint the P points of `data` with (P, 3) colours in 0..255."""
    data.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(colors, dtype=np.uint8), deep=1))


def triangles(points: ArrayLike, faces: ArrayLike) -> vtkPolyData:
    """Return a triangle mesh from (P, 3) points in m and (F, 3) indices."""
    data = vtkPolyData()
    _set_positions(data, points)
    data.SetPolys(_cells(faces, 3))
    return data


def set_points(data: vtkPolyData, points: ArrayLike) -> None:
    """Make `data` a cloud of (N, 3) points in m."""
    _set_positions(data, points)
    data.SetVerts(_cells(np.arange(len(np.asarray(points))), 1))


def set_lines(data: vtkPolyData, points: ArrayLike, segments: ArrayLike) -> None:
    """Make `data` the straight lines between the (P, 3) points in m named by (S, 2) `segments`."""
    _set_positions(data, points)
    data.SetLines(_cells(segments, 2))


def chain(n_points: int, closed: bool = False) -> NDArray[np.int64]:
    """Return the (S, 2) segments that join `n_points` points in order, back to the first if `closed`."""
    start = np.arange(n_points if closed else max(n_points - 1, 0))
    return np.stack([start, (start + 1) % max(n_points, 1)], axis=1)


def set_ribbon(data: vtkPolyData, points_xy: NDArray[np.float64], width_m: float, height_m: float) -> None:
    """Make `data` a band of `width_m` along (K, 2) points in m, lying `height_m` above the floor."""
    ahead = np.gradient(points_xy, axis=0) if len(points_xy) > 1 else np.zeros_like(points_xy)
    # Where the points stand still the band has no direction and closes to a point.
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    aside = 0.5 * width_m * np.column_stack([-ahead[:, 1], ahead[:, 0]])
    _set_positions(data, on_floor(np.stack([points_xy - aside, points_xy + aside], axis=1), height_m))
    first = 2 * np.arange(max(len(points_xy) - 1, 0))[:, None]
    data.SetPolys(_cells(first + np.array([0, 2, 1, 1, 2, 3]), 3))


def on_floor(points_xy: ArrayLike, height_m: float) -> NDArray[np.float64]:
    """Return (K, 3) points at `height_m` above the floor from (K, 2)."""
    xy = np.asarray(points_xy, dtype=np.float64).reshape(-1, 2)
    return np.column_stack([xy, np.full(len(xy), height_m)])


def unlit_actor(
    data: vtkPolyData, color: Color = (1.0, 1.0, 1.0), opacity: float = 1.0, size_px: float = 1.0
) -> vtkActor:
    """Return an actor in the colours of its points, or in `color`; `size_px` is its line width or point size."""
    mapper = vtkPolyDataMapper()
    mapper.SetInputData(data)
    actor = vtkActor()
    actor.SetMapper(mapper)
    surface = actor.GetProperty()
    surface.LightingOff()
    surface.SetColor(*color)
    surface.SetOpacity(opacity)
    surface.SetLineWidth(size_px)
    surface.SetPointSize(size_px)
    return actor
