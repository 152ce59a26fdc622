"""The shapes of a URDF as points, and what rolls among them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from yourdfpy.urdf import Collision

from zebrat_bullet.errors import RobotError
from zebrat_bullet.files import MB, refusing, require_file

_OUTLINE_TOLERANCE_M = 1e-6
_MOST_MESH_BYTES = 64 * MB
_MOST_MESH_POINTS = 2_000_000
_LEAST_ROUND = 0.85
_ACROSS = 0.05
"""Sine of the angle by which a wheel may stand askew on its axle."""


@dataclass(frozen=True)
class Round:
    """What rolls: radius, and centre and width along the axle, in m.

    Attributes:
        off_axle_m: how far the centre is from the axle.
    """

    radius_m: float
    along_m: float
    width_m: float
    off_axle_m: float


def shape_points(shape: Collision) -> NDArray[np.float64]:
    """Return (P, 3) points in m of a collision or visual shape in its link's frame, whose hull is that of the shape.

    Raises:
        RobotError: its mesh cannot be read.
    """
    geometry = shape.geometry
    if geometry.box is not None:
        mesh = trimesh.creation.box(geometry.box.size)
    elif geometry.cylinder is not None:
        mesh = trimesh.creation.cylinder(geometry.cylinder.radius, geometry.cylinder.length)
    elif geometry.sphere is not None:
        mesh = trimesh.creation.icosphere(radius=geometry.sphere.radius)
    elif geometry.mesh is not None:
        mesh = _mesh(Path(geometry.mesh.filename))
        mesh.apply_scale(1.0 if geometry.mesh.scale is None else geometry.mesh.scale)
    else:
        return np.empty((0, 3))
    return np.asarray(mesh.vertices if shape.origin is None else trimesh.transform_points(mesh.vertices, shape.origin))


def _mesh(file: Path) -> trimesh.Trimesh:
    require_file(file, RobotError, _MOST_MESH_BYTES)
    with refusing(file, RobotError, "is no mesh that can be read", "export it again as STL or OBJ"):
        mesh: trimesh.Trimesh = trimesh.load(file, force="mesh")  # type: ignore[assignment]
        if not 3 <= len(mesh.vertices) <= _MOST_MESH_POINTS:
            raise ValueError(f"{len(mesh.vertices)} points, between 3 and {_MOST_MESH_POINTS} are read")
        if not np.isfinite(mesh.vertices).all():
            raise ValueError("some of its points are not finite")
        return mesh


def rolling_shape(shapes: list[Collision], axle_link: NDArray[np.float64]) -> Round | str:
    """Return what of a wheel's shapes rolls about its axle, or what is wrong with them and the mend.

    Args:
        shapes: of the wheel, in its link's frame.
        axle_link: (3,) unit vector of the axle, through the origin of the link's frame.
    """
    found = [_round(shape, axle_link) for shape in shapes]
    rolling = [one for one in found if isinstance(one, Round)]
    if rolling:
        return max(rolling, key=lambda one: one.radius_m)
    reasons = [one for one in found if isinstance(one, str)]
    return reasons[0] if reasons else "has no shape; give its <collision> a cylinder"


def _round(shape: Collision, axle: NDArray[np.float64]) -> Round | str:
    pose = np.eye(4) if shape.origin is None else np.asarray(shape.origin)
    geometry, centre = shape.geometry, pose[:3, 3]
    if geometry.cylinder is not None:
        if np.linalg.norm(np.cross(pose[:3, 2], axle)) > _ACROSS:
            return (
                "stands with its cylinder across its axle and cannot roll; turn the cylinder (<origin rpy>) so that "
                "its axis, its own z, lies along the joint's <axis>"
            )
        return _about(axle, centre, float(geometry.cylinder.radius), float(geometry.cylinder.length))
    if geometry.sphere is not None:
        return _about(axle, centre, float(geometry.sphere.radius), 0.0)
    if geometry.mesh is None:
        return "is a box, which does not roll; give its <collision> a cylinder"
    points = shape_points(shape)
    along = points @ axle
    side = np.cross(axle, np.eye(3)[np.argmin(np.abs(axle))])
    side /= np.linalg.norm(side)
    across = points @ np.stack([side, np.cross(axle, side)], axis=1)
    sizes = np.ptp(across, axis=0)
    if sizes.min() < _LEAST_ROUND * sizes.max():
        return (
            f"is a mesh of {sizes[0]:.3f} x {sizes[1]:.3f} m across its axle, which is not round; give its <collision> "
            "a cylinder, or turn the joint's <axis>"
        )
    middle = (across.min(axis=0) + across.max(axis=0)) / 2.0
    return Round(
        radius_m=float(sizes.max() / 2.0),
        along_m=float((along.min() + along.max()) / 2.0),
        width_m=float(np.ptp(along)),
        off_axle_m=float(np.hypot(*middle)),
    )


def _about(axle: NDArray[np.float64], centre: NDArray[np.float64], radius_m: float, width_m: float) -> Round:
    along = float(centre @ axle)
    return Round(radius_m, along, width_m, float(np.linalg.norm(centre - along * axle)))


def convex_outline(points: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the (K, 2) convex outline of (P, 2) points, counter-clockwise from the rear right corner.

    None where they hold no area.
    """
    hull = shapely.MultiPoint(points).convex_hull
    if hull.geom_type != "Polygon" or hull.area < _OUTLINE_TOLERANCE_M:
        return None
    corners = np.array(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1]
    corners = np.roll(corners, -int(np.argmin(corners @ (1.0, 1e-3))), axis=0)
    # Vertices along the straight side of a mesh are no corners, though rounding puts some of them a hair outside.
    straightened = shapely.LinearRing(corners).simplify(_OUTLINE_TOLERANCE_M)
    return np.array(straightened.coords)[:-1].round(9)
