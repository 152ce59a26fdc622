"""The scene: floor, walls, car and what the car senses. It is told what to show and never asks a simulator."""

import numpy as np
import shapely
from numpy.typing import NDArray
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkRenderer

from zebrat_bullet.geometry import to_world
from zebrat_bullet.render.car import Car
from zebrat_bullet.render.frame import Frame
from zebrat_bullet.render.polydata import (
    chain,
    on_floor,
    set_colors,
    set_lines,
    set_points,
    set_ribbon,
    triangles,
    unlit_actor,
)
from zebrat_bullet.render.shading import shade
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.types import FlatScan, Pose2
from zebrat_bullet.world.world import World

BACKGROUND = (0.105, 0.120, 0.145)
_FLOOR, _GRID = (0.165, 0.185, 0.215), (0.225, 0.250, 0.290)
_WALL_SIDE, _WALL_CAP = (172, 184, 200), (226, 232, 240)
_PATH, _SCAN = (0.36, 0.62, 1.0), (1.0, 0.36, 0.78)
_FLOOR_MARGIN_M = 12.0
# Heights above the floor, far enough apart for the depth buffer.
_GRID_Z, _PATH_Z, _GLOW_Z, _OUTLINE_Z, _SCAN_Z = 0.003, 0.008, 0.014, 0.020, 0.050
_SKIN_M = 0.02  # returns lie exactly in the walls; drawn this much nearer to the lidar they stay visible
_SCAN_BREAK_M = 0.3  # neighbouring bearings further apart than this see different walls

_HEIGHT_RAMP_M = np.linspace(0.0, 1.2, 5)
_HEIGHT_COLORS = np.array([[70, 105, 255], [0, 205, 235], [70, 225, 110], [255, 215, 40], [255, 95, 50]])
_PATH_WIDTH_M = 0.04
_GLOW_M = 0.07  # how far the region shines out from under the car
_GAP_RAMP_M = np.array([0.02, 0.12, 0.25])
_GAP_COLORS = np.array([[1.0, 0.16, 0.16], [1.0, 0.72, 0.10], [0.20, 0.90, 0.40]])


def _ramp(values: NDArray[np.float64] | float, stops: NDArray[np.float64], colors: NDArray) -> NDArray[np.float64]:
    return np.stack([np.interp(values, stops, channel) for channel in colors.T], axis=-1)


def gap_color(gap_m: float) -> tuple[float, float, float]:
    """Return the safety region's colour in 0..1: red where something touches it, then amber, green when it is free."""
    red, green, blue = _ramp(gap_m, _GAP_RAMP_M, _GAP_COLORS)
    return float(red), float(green), float(blue)


class Scene:
    """All actors of one world and one car, shared by every view of one window.

    Args:
        robot, world: what stands still and what drives.
        line_px: width of lines and points.
    """

    def __init__(self, robot: RobotModel, world: World, line_px: float) -> None:
        self._robot = robot
        self._car = Car(robot)
        self._cloud, self._scan, self._path = vtkPolyData(), vtkPolyData(), vtkPolyData()
        self._glow, self._outline = vtkPolyData(), vtkPolyData()
        self._glow_actor = unlit_actor(self._glow, opacity=0.45)
        self._outline_actor = unlit_actor(self._outline, size_px=1.4 * line_px)
        self._cloud_actor = unlit_actor(self._cloud, size_px=line_px)
        self._scan_actor = unlit_actor(self._scan, _SCAN, size_px=line_px)
        self._actors = [
            *_floor_actors(world, line_px),
            _wall_actor(world),
            *self._car.actors,
            unlit_actor(self._path, _PATH),
            self._glow_actor,
            self._outline_actor,
            self._cloud_actor,
            self._scan_actor,
        ]

    def renderer(self, viewport: tuple[float, float, float, float]) -> vtkRenderer:
        """Return a view of this scene in a part (x0, y0, x1, y1 in 0..1) of a window."""
        view = vtkRenderer()
        view.SetViewport(viewport)
        view.SetBackground(BACKGROUND)
        view.SetUseOIT(False)
        for actor in self._actors:
            view.AddActor(actor)
        return view

    def show(self, frame: Frame) -> None:
        """Move and recolour everything that changes."""
        self._car.place(frame.pose, frame.knuckle_rad, frame.wheel_rad)
        set_ribbon(self._path, frame.path_world, _PATH_WIDTH_M, _PATH_Z)
        self._show_region(frame)
        self._show_senses(frame)

    def _show_region(self, frame: Frame) -> None:
        for actor in (self._glow_actor, self._outline_actor):
            actor.SetVisibility(frame.gap_m is not None)
        if frame.gap_m is None:
            return
        region = self._robot.footprint_base if frame.region_base is None else frame.region_base
        corners = on_floor(to_world(region, frame.pose), _OUTLINE_Z)
        set_lines(self._outline, corners, chain(len(corners), closed=True))
        glow = shapely.Polygon(to_world(region, frame.pose)).buffer(_GLOW_M, quad_segs=4)
        rim = on_floor(glow.exterior.coords[:-1], _GLOW_Z)
        self._glow.ShallowCopy(triangles(rim, [(0, i, i + 1) for i in range(1, len(rim) - 1)]))
        for actor in (self._glow_actor, self._outline_actor):
            actor.GetProperty().SetColor(*gap_color(frame.gap_m))

    def _show_senses(self, frame: Frame) -> None:
        pose = frame.scan_pose or frame.pose
        lidar = self._robot.lidar_xyz_base
        eye = np.append(to_world(lidar[None, :2], pose)[0], lidar[2])
        self._cloud_actor.SetVisibility(frame.cloud_world is not None)
        if frame.cloud_world is not None:
            colors = _ramp(frame.cloud_world[:, 2], _HEIGHT_RAMP_M, _HEIGHT_COLORS)
            set_points(self._cloud, _nearer(frame.cloud_world, eye))
            set_colors(self._cloud, colors.astype(np.uint8))
        self._scan_actor.SetVisibility(frame.scan is not None)
        if frame.scan is not None:
            yaw = pose.yaw + float(self._robot.lidar_rpy[2])
            points, segments = _scan_lines(frame.scan, Pose2(float(eye[0]), float(eye[1]), yaw))
            set_lines(self._scan, points, segments)


def _nearer(points: NDArray[np.float64], eye: NDArray[np.float64]) -> NDArray[np.float64]:
    away = points - eye
    return points - away * (_SKIN_M / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), _SKIN_M))


def _scan_lines(scan: FlatScan, lidar: Pose2) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return (n, 3) end points of the scan's bearings and the (S, 2) segments between neighbours on one wall."""
    ranges = np.asarray(scan.ranges_m, dtype=np.float64)
    bearings = -np.pi + np.arange(len(ranges)) * 2.0 * np.pi / len(ranges)
    ends = (ranges - _SKIN_M)[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
    segments = chain(len(ranges), closed=True)
    near, far = ranges[segments].min(axis=1), ranges[segments].max(axis=1)
    joined = (far < scan.range_max_m) & (far - near < _SCAN_BREAK_M)
    return on_floor(to_world(ends, lidar), _SCAN_Z), segments[joined]


def _wall_actor(world: World) -> vtkActor:
    corners = world.mesh.vertices[world.mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colors = np.where(normals[:, 2:] > 0.9, _WALL_CAP, _WALL_SIDE)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    # Every face has its own three vertices, so that walls are shaded flat.
    data = triangles(corners.reshape(-1, 3), faces)
    set_colors(data, np.repeat(shade(colors, normals), 3, axis=0))
    return unlit_actor(data)


def _floor_actors(world: World, line_px: float) -> list[vtkActor]:
    (x0, y0), (x1, y1) = _floor_bounds(world)
    floor = triangles(on_floor([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], 0.0), [(0, 1, 2), (0, 2, 3)])
    ends = [((x, y0), (x, y1)) for x in np.arange(x0, x1 + 0.5)] + [((x0, y), (x1, y)) for y in np.arange(y0, y1 + 0.5)]
    grid = vtkPolyData()
    set_lines(grid, on_floor(ends, _GRID_Z), np.arange(2 * len(ends)).reshape(-1, 2))
    return [unlit_actor(floor, _FLOOR), unlit_actor(grid, _GRID, size_px=0.5 * line_px)]


def _floor_bounds(world: World) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = np.concatenate([world.mesh.vertices[:, :2], world.centre_line, [[world.start.pose.x, world.start.pose.y]]])
    return np.floor(points.min(axis=0) - _FLOOR_MARGIN_M), np.ceil(points.max(axis=0) + _FLOOR_MARGIN_M)
