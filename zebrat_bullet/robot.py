"""What a car-like URDF says of itself, read with yourdfpy; the only source of the robot's numbers."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
import trimesh
import yourdfpy
from numpy.typing import NDArray
from yourdfpy.urdf import Collision, Joint, Link

from zebrat_bullet.assets import find_asset
from zebrat_bullet.errors import RobotError

STEERING_JOINTS = ("left_steering_hinge_joint", "right_steering_hinge_joint")
WHEEL_JOINTS = (
    "left_rear_wheel_joint",
    "right_rear_wheel_joint",
    "left_front_wheel_joint",
    "right_front_wheel_joint",
)
LIDAR_JOINT = "lidar_mount"
GRAVITY_MPS2 = 9.81

_ROLE_TYPES = (
    dict.fromkeys(STEERING_JOINTS, "revolute") | dict.fromkeys(WHEEL_JOINTS, "continuous") | {LIDAR_JOINT: "fixed"}
)
_TOLERANCE_M = 1e-3
_OUTLINE_TOLERANCE_M = 1e-6


@dataclass(frozen=True)
class RobotModel:
    """The facts of a car-like robot, in m and rad, base frame (body centre on the floor, x forward).

    Attributes:
        urdf_path: where they were read from.
        wheelbase_m: rear to front axle.
        track_m: left to right wheel centre.
        wheel_radius_m: of all four wheels.
        rear_axle_x_m: x of the rear axle in the base frame (negative).
        footprint_base: (K, 2) float64, convex outline of all collision shapes of the body together, counter-clockwise;
            a hollow in the body belongs to it. Physics takes a mesh as its convex hull too.
        lidar_xyz_base: (3,) float64, position of the lidar.
        lidar_rpy: (3,) float64, its fixed-axis orientation.
        body_top_m: height of the highest collision shape.
        knuckle_limit_rad: smallest limit of the two steering hinges.
        rolling_mass_kg: mass of all links, and of the wheels' spin as seen by who pushes the car.
        yaw_inertia_kgm2: moment of inertia of all links about the vertical through the rear axle's centre.
        weight_n: of all links.
        wheel_effort_nm: smallest torque limit of the four wheel motors.
        hinge_speed_radps: smallest speed limit of the two steering hinges.
    """

    urdf_path: Path
    wheelbase_m: float
    track_m: float
    wheel_radius_m: float
    rear_axle_x_m: float
    footprint_base: NDArray[np.float64]
    lidar_xyz_base: NDArray[np.float64]
    lidar_rpy: NDArray[np.float64]
    body_top_m: float
    knuckle_limit_rad: float
    rolling_mass_kg: float
    yaw_inertia_kgm2: float
    weight_n: float
    wheel_effort_nm: float
    hinge_speed_radps: float


def load_robot(name_or_path: str | Path = "zebrat") -> RobotModel:
    """Read a shipped robot by name, or a user's car-like URDF by path.

    A car-like URDF has its root link's frame on the floor (x forward, z up), a collision shape on the body, and these
    joints: two revolute steering hinges about z, four continuous wheel axles about y (the front ones on the hinges'
    knuckles) whose links have one collision cylinder each, and the fixed mount of the lidar.

    Raises:
        AssetError: there is no such URDF.
        RobotError: a role is missing, or the numbers are not those of a symmetric four-wheeled car.
    """
    path = find_asset("urdf", str(name_or_path), ".urdf")
    try:
        urdf = yourdfpy.URDF.load(str(path), load_meshes=False)
    except Exception as error:  # yourdfpy lets through whatever its XML parser and NumPy raise
        raise RobotError(f"{path}: cannot be read as a URDF ({error}); check it with check_urdf") from error
    _check_roles(path, urdf)
    hinges, wheels = _check_steering_and_wheels(path, urdf)
    body_points = _body_points(path, urdf)
    mount = urdf.get_transform(urdf.joint_map[LIDAR_JOINT].child, urdf.base_link)
    limits = [urdf.joint_map[name].limit for name in STEERING_JOINTS]
    radius = _wheel_radius(path, urdf, WHEEL_JOINTS[0])
    mass = sum(link.inertial.mass for link in _massive(urdf))
    spin = sum(_spin_inertia(urdf, name) for name in WHEEL_JOINTS)
    return RobotModel(
        urdf_path=path.resolve(),
        wheelbase_m=float(hinges[0, 0] - wheels[0, 0]),
        track_m=float(wheels[0, 1] - wheels[1, 1]),
        wheel_radius_m=radius,
        rear_axle_x_m=float(wheels[0, 0]),
        footprint_base=_convex_outline(body_points[:, :2]),
        lidar_xyz_base=mount[:3, 3].copy(),
        lidar_rpy=np.array(trimesh.transformations.euler_from_matrix(mount, "sxyz")),
        body_top_m=float(body_points[:, 2].max()),
        knuckle_limit_rad=float(min(min(limit.upper, -limit.lower) for limit in limits)),
        rolling_mass_kg=mass + spin / radius**2,
        yaw_inertia_kgm2=_yaw_inertia(urdf, float(wheels[0, 0])),
        weight_n=mass * GRAVITY_MPS2,
        wheel_effort_nm=float(min(urdf.joint_map[name].limit.effort for name in WHEEL_JOINTS)),
        hinge_speed_radps=float(min(limit.velocity for limit in limits)),
    )


def _check_roles(path: Path, urdf: yourdfpy.URDF) -> None:
    """Raise where a joint is missing, has another type, or lacks what the simulation reads from it."""
    missing = [name for name in _ROLE_TYPES if name not in urdf.joint_map]
    if missing:
        needed = ", ".join(f"{name} ({kind})" for name, kind in _ROLE_TYPES.items())
        raise RobotError(f"{path}: lacks the joints {', '.join(missing)}; a car-like robot needs {needed}")
    for name, kind in _ROLE_TYPES.items():
        joint = urdf.joint_map[name]
        if joint.type != kind:
            raise RobotError(f"{path}: joint {name} is {joint.type}; make it {kind}")
        if kind != "fixed" and (joint.limit is None or not joint.limit.effort or not joint.limit.velocity):
            raise RobotError(f"{path}: joint {name} needs <limit> with effort and velocity above 0")
    for hinge, axle in zip(STEERING_JOINTS, WHEEL_JOINTS[2:], strict=True):
        if urdf.joint_map[axle].parent != urdf.joint_map[hinge].child:
            raise RobotError(f"{path}: {axle} must have the child link of {hinge} as its parent, or it cannot steer")


def _check_steering_and_wheels(path: Path, urdf: yourdfpy.URDF) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (2, 3) hinge and (4, 3) wheel centres in the base frame, refusing what is no symmetric car."""

    def centres(names: tuple[str, ...], axis: tuple[int, int, int]) -> NDArray[np.float64]:
        joints: list[Joint] = [urdf.joint_map[name] for name in names]
        poses = [urdf.get_transform(joint.child, urdf.base_link) for joint in joints]
        for joint, pose in zip(joints, poses, strict=True):
            if not np.allclose(pose[:3, :3] @ joint.axis, axis, atol=1e-3):
                raise RobotError(f"{path}: the axis of {joint.name} must point along {axis} of the base frame")
        return np.array([pose[:3, 3] for pose in poses])

    def refuse_unless(same: bool, what: str) -> None:
        if not same:
            raise RobotError(f"{path}: {what} (within {_TOLERANCE_M} m)")

    hinges, wheels = centres(STEERING_JOINTS, (0, 0, 1)), centres(WHEEL_JOINTS, (0, 1, 0))
    radii = [_wheel_radius(path, urdf, name) for name in WHEEL_JOINTS]
    mirrored = wheels[1::2] * (1, -1, 1)
    refuse_unless(np.allclose(wheels[::2], mirrored, atol=_TOLERANCE_M), "left and right wheels must mirror each other")
    refuse_unless(np.ptp(np.abs(wheels[:, 1])) < _TOLERANCE_M, "front and rear track must be equal")
    refuse_unless(np.allclose(hinges, wheels[2:], atol=_TOLERANCE_M), "front wheels must be centred on their hinges")
    refuse_unless(np.ptp(radii) < 1e-6, f"the four wheels must have one radius, got {radii}")
    refuse_unless(
        np.allclose(wheels[:, 2], radii[0], atol=_TOLERANCE_M),
        f"the base frame must lie on the floor, so wheel centres must be {radii[0]} m high, got {wheels[:, 2]}",
    )
    refuse_unless(wheels[2, 0] > wheels[0, 0] and wheels[0, 1] > 0, "front axle must be ahead, left wheels at y > 0")
    return hinges, wheels


def _wheel_radius(path: Path, urdf: yourdfpy.URDF, joint_name: str) -> float:
    """Return the radius in m of the one collision cylinder of a wheel."""
    link: Link = urdf.link_map[urdf.joint_map[joint_name].child]
    shapes = link.collisions
    if len(shapes) != 1 or shapes[0].geometry.cylinder is None:
        raise RobotError(f"{path}: link {link.name} must have exactly one collision shape, a cylinder")
    pose = np.eye(4) if shapes[0].origin is None else shapes[0].origin
    if not (np.allclose(np.abs(pose[:3, 2]), (0, 1, 0), atol=1e-3) and np.allclose(pose[:3, 3], 0, atol=1e-6)):
        raise RobotError(f"{path}: the cylinder of {link.name} must be centred on its axle, along y")
    return float(shapes[0].geometry.cylinder.radius)


def _massive(urdf: yourdfpy.URDF) -> list[Link]:
    return [link for link in urdf.link_map.values() if link.inertial is not None and link.inertial.mass]


def _spin_inertia(urdf: yourdfpy.URDF, joint_name: str) -> float:
    """Return the moment of inertia of a wheel about its axle (y), 0 where its link has no mass."""
    inertial = urdf.link_map[urdf.joint_map[joint_name].child].inertial
    return 0.0 if inertial is None else float(inertial.inertia[1, 1])


def _yaw_inertia(urdf: yourdfpy.URDF, axle_x_m: float) -> float:
    """Return the moment of inertia in kg m^2 of all links about the vertical through the rear axle's centre."""
    total = 0.0
    for link in _massive(urdf):
        placed = urdf.get_transform(link.name, urdf.base_link)
        if link.inertial.origin is not None:
            placed = placed @ link.inertial.origin
        turned = placed[:3, :3] @ link.inertial.inertia @ placed[:3, :3].T
        x, y = placed[:2, 3]
        total += turned[2, 2] + link.inertial.mass * ((x - axle_x_m) ** 2 + y**2)
    return float(total)


def _body_points(path: Path, urdf: yourdfpy.URDF) -> NDArray[np.float64]:
    """Return (P, 3) points in m, base frame, whose hull is that of all shapes rigidly joined to the root link."""
    root: Link = urdf.link_map[urdf.base_link]
    if root.inertial is None or not root.inertial.mass:
        raise RobotError(
            f"{path}: the root link {root.name} needs <inertial> with a mass, or physics would pin it down"
        )
    fixed_to = {joint.child: joint.parent for joint in urdf.joint_map.values() if joint.type == "fixed"}

    def is_rigid(name: str) -> bool:
        return name == root.name or (name in fixed_to and is_rigid(fixed_to[name]))

    points = [
        trimesh.transform_points(_shape_points(path, shape), urdf.get_transform(name, urdf.base_link))
        for name in filter(is_rigid, urdf.link_map)
        for shape in urdf.link_map[name].collisions
    ]
    if not points:
        raise RobotError(f"{path}: the body has no collision shape; give {root.name} one, it is the car's footprint")
    return np.vstack(points)


def _shape_points(path: Path, shape: Collision) -> NDArray[np.float64]:
    """Return (P, 3) surface points of a collision shape in its link's frame."""
    geometry = shape.geometry
    if geometry.box is not None:
        mesh = trimesh.creation.box(geometry.box.size)
    elif geometry.cylinder is not None:
        mesh = trimesh.creation.cylinder(geometry.cylinder.radius, geometry.cylinder.length)
    elif geometry.sphere is not None:
        mesh = trimesh.creation.icosphere(radius=geometry.sphere.radius)
    else:
        file = path.parent / geometry.mesh.filename
        if not file.is_file():
            raise RobotError(f"{path}: no mesh at {file}; give mesh file names relative to the URDF")
        mesh = trimesh.load(file, force="mesh")
        mesh.apply_scale(1.0 if geometry.mesh.scale is None else geometry.mesh.scale)
    return mesh.vertices if shape.origin is None else trimesh.transform_points(mesh.vertices, shape.origin)


def _convex_outline(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (K, 2) convex outline of (P, 2) points, counter-clockwise from the rear right corner."""
    hull = shapely.geometry.polygon.orient(shapely.MultiPoint(points).convex_hull)
    corners = np.array(hull.exterior.coords)[:-1]
    corners = np.roll(corners, -int(np.argmin(corners @ (1.0, 1e-3))), axis=0)
    # Vertices along the straight side of a mesh are no corners, though rounding puts some of them a hair outside.
    straightened = shapely.LinearRing(corners).simplify(_OUTLINE_TOLERANCE_M)
    return np.array(straightened.coords)[:-1].round(9)
