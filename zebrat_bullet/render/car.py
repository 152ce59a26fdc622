"""The car as its URDF paints it: one actor for each link that moves on its own."""

import numpy as np
import trimesh
import yourdfpy
from numpy.typing import NDArray
from trimesh.visual import ColorVisuals, TextureVisuals
from vtkmodules.vtkCommonMath import vtkMatrix4x4
from vtkmodules.vtkRenderingCore import vtkActor

from zebrat_bullet.errors import RenderError
from zebrat_bullet.files import refusing
from zebrat_bullet.geometry import rotation_2d
from zebrat_bullet.render.polydata import set_colors, triangles, unlit_actor
from zebrat_bullet.render.shading import shade
from zebrat_bullet.robot import STEERING_JOINTS, WHEEL_JOINTS, RobotModel
from zebrat_bullet.robot.document import parse_urdf
from zebrat_bullet.types import Pose2

_CREASE_RAD = np.radians(35.0)  # flatter edges are shaded smooth


class Car:
    """The car's actors, posed by planar pose, hinge angles and wheel angles.

    Attributes:
        actors: what to add to a renderer.
    """

    def __init__(self, robot: RobotModel) -> None:
        with refusing(robot.urdf_path, RenderError, "cannot be drawn", "mend the mesh it names, or leave it out"):
            self._urdf = parse_urdf(robot.drawn_urdf, load_meshes=True)
        self._signs = robot.drawn_signs
        self._base_from_root = robot.base_from_root
        self._parts = {link: _Part(meshes) for link, meshes in _meshes_by_link(self._urdf).items()}

    @property
    def actors(self) -> list[vtkActor]:
        return [part.actor for part in self._parts.values()]

    def place(self, pose: Pose2, knuckle_rad: NDArray[np.float64], wheel_rad: NDArray[np.float64]) -> None:
        """Move all actors: base at `pose`, hinges (2,) left, right; wheels (4,) rear to front, left first."""
        angles = np.concatenate([knuckle_rad, wheel_rad])
        turned = zip(map(self._signs.__getitem__, (*STEERING_JOINTS, *WHEEL_JOINTS)), angles, strict=True)
        self._urdf.update_cfg({joint: sign * angle for (joint, sign), angle in turned})
        world_from_base = _planar(pose) @ self._base_from_root
        for link, part in self._parts.items():
            part.place(world_from_base @ self._urdf.get_transform(link))


class _Part:
    """What moves with one link: one actor, lit anew wherever it turns."""

    def __init__(self, meshes: list[trimesh.Trimesh]) -> None:
        starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
        faces = np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=True)])
        self._data = triangles(np.concatenate([m.vertices for m in meshes]), faces)
        self._normals = np.concatenate([m.vertex_normals for m in meshes])
        self._colors = np.concatenate([_vertex_colors(m)[:, :3] for m in meshes])
        self.actor = unlit_actor(self._data)

    def place(self, world_from_link: NDArray[np.float64]) -> None:
        matrix = vtkMatrix4x4()
        matrix.DeepCopy(world_from_link.ravel().tolist())
        self.actor.SetUserMatrix(matrix)
        set_colors(self._data, shade(self._colors, self._normals @ world_from_link[:3, :3].T))


def _planar(pose: Pose2) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:2, :2] = rotation_2d(pose.yaw)
    matrix[:2, 3] = pose.x, pose.y
    return matrix


def _meshes_by_link(urdf: yourdfpy.URDF) -> dict[str, list[trimesh.Trimesh]]:
    """Return the visuals in the frame of the link they move with; links fixed to another go with that one."""
    graph, moving = urdf.scene.graph, {j.child for j in urdf.robot.joints if j.type != "fixed"}
    parts: dict[str, list[trimesh.Trimesh]] = {}
    for node in graph.nodes_geometry:
        link = node
        while link not in moving and link != urdf.base_link:
            link = graph.transforms.parents[link]
        transform, geometry = graph.get(frame_to=node, frame_from=link)
        parts.setdefault(link, []).append(_shaded(urdf.scene.geometry[geometry]).apply_transform(transform))
    return parts


def _shaded(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a copy with vertices doubled along creases, so that normals are smooth on wheels and sharp on boxes."""
    copy = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=_vertex_colors(mesh), process=False)
    return trimesh.graph.smooth_shade(copy, angle=_CREASE_RAD)


def _vertex_colors(mesh: trimesh.Trimesh) -> NDArray[np.uint8]:
    visual = mesh.visual
    if isinstance(visual, ColorVisuals):
        return visual.vertex_colors
    assert isinstance(visual, TextureVisuals)
    if visual.uv is not None:
        return visual.to_color().vertex_colors
    return np.tile(visual.material.main_color, (len(mesh.vertices), 1))
