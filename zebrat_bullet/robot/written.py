"""Whether a URDF is already written as physics needs it, so that the file itself is driven."""

from pathlib import Path

import numpy as np

from zebrat_bullet.robot.body import Body
from zebrat_bullet.robot.chassis import Chassis
from zebrat_bullet.robot.model import GRAVITY_MPS2, LIDAR_JOINT, STEERING_JOINTS, WHEEL_JOINTS
from zebrat_bullet.robot.motors import MOST_HINGE_SPEED_RADPS, Motors
from zebrat_bullet.robot.parts import Parts
from zebrat_bullet.robot.setup import RobotSetup

_CLOSE_M = 1e-3
_EXACT_M = 1e-6
_THIN = 0.1
"""The width of a wheel over its radius, at most."""


def as_physics_needs(parts: Parts, setup: RobotSetup, chassis: Chassis, body: Body, motors: Motors) -> bool:
    """Return whether PyBullet can load the file as it is, and then drives the car that was understood.

    Every link has inertia and the root link mass; it stands on the floor and looks ahead; every joint has its type and
    axis; the wheels are thin cylinders centred on their axles and hinges, all of one radius and track, with the grip
    that every simulator gives them; the footprint is that of the collision shapes.
    """
    return (
        setup.path.suffix == ".urdf"
        and b"xacro" not in setup.path.read_bytes()
        and b"://" not in _mesh_names(setup.path)
        and motors.as_written
        and motors.hinge_speed_radps <= MOST_HINGE_SPEED_RADPS
        and body.as_collision
        and not parts.moved
        and not parts.document.notes
        and setup.roles[LIDAR_JOINT] in parts.document.joints
        and _types_right(parts)
        and _masses_right(parts)
        and _geometry_right(parts, chassis)
        and all(_wheel_right(parts, role) for role in WHEEL_JOINTS)
    )


def _mesh_names(path: Path) -> bytes:
    return b" ".join(line for line in path.read_bytes().splitlines() if b"filename" in line)


def _types_right(parts: Parts) -> bool:
    return all(parts.types[r] == "revolute" for r in STEERING_JOINTS) and all(
        parts.types[r] == "continuous" for r in WHEEL_JOINTS
    )


def _masses_right(parts: Parts) -> bool:
    # Bullet gives a link without inertia 1 kg of its own accord.
    if any(link.inertial is None for link in parts.urdf.link_map.values()):
        return False
    inertial = parts.urdf.link_map[parts.document.root].inertial
    if not inertial.mass:
        return False
    return inertial.origin is None or np.allclose(inertial.origin[:3, :3], np.eye(3), atol=1e-6)


def _geometry_right(parts: Parts, chassis: Chassis) -> bool:
    def close(a: object, b: object) -> bool:
        return np.allclose(a, b, rtol=0.0, atol=_CLOSE_M)  # type: ignore[arg-type]

    axes = [parts.pose(parts.child(role))[:3, :3] @ parts.axis(role) for role in (*STEERING_JOINTS, *WHEEL_JOINTS)]
    wheels = chassis.wheels
    return bool(
        close(chassis.base_from_root, np.eye(4))
        and close(axes, [(0, 0, 1)] * 2 + [(0, 1, 0)] * 4)
        and close(wheels[::2], wheels[1::2] * (1, -1, 1))
        and np.ptp(np.abs(wheels[:, 1])) < _CLOSE_M
        and close(chassis.hinges, wheels[2:])
        and np.ptp(chassis.radii) < _EXACT_M
    )


def _wheel_right(parts: Parts, role: str) -> bool:
    shapes = parts.rolling(role)
    if (
        parts.urdf.link_map[parts.child(role)].collisions != shapes
        or len(shapes) != 1
        or shapes[0].geometry.cylinder is None
        # A wide one rubs over its edges, and the car turns wider than its steering says.
        or shapes[0].geometry.cylinder.length > _THIN * shapes[0].geometry.cylinder.radius + _EXACT_M
    ):
        return False
    pose = np.eye(4) if shapes[0].origin is None else shapes[0].origin
    return bool(np.allclose(np.abs(pose[:3, 2]), (0, 1, 0), atol=1e-3) and np.allclose(pose[:3, 3], 0.0, atol=_EXACT_M))


def written_inertia(parts: Parts, radius_m: float, axle_x_m: float) -> tuple[float, float, float]:
    """Return mass with the wheels' spin in kg, moment of inertia about the rear axle in kg m^2, and weight in N."""
    links = [link for link in parts.urdf.link_map.values() if link.inertial is not None and link.inertial.mass]
    mass = sum(link.inertial.mass for link in links)
    spin = 0.0
    for role in WHEEL_JOINTS:
        inertial = parts.urdf.link_map[parts.child(role)].inertial
        spin += 0.0 if inertial is None else float(inertial.inertia[1, 1])
    total = 0.0
    for link in links:
        placed = parts.pose(link.name)
        if link.inertial.origin is not None:
            placed = placed @ link.inertial.origin
        turned = placed[:3, :3] @ link.inertial.inertia @ placed[:3, :3].T
        x, y = placed[:2, 3]
        total += turned[2, 2] + link.inertial.mass * ((x - axle_x_m) ** 2 + y**2)
    return mass + spin / radius_m**2, float(total), mass * GRAVITY_MPS2
