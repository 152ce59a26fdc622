"""The plain car: a body, two knuckles and four wheels, as physics takes any car that is not written so already."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.robot.body import Body
from zebrat_bullet.robot.chassis import Chassis
from zebrat_bullet.robot.model import GRAVITY_MPS2, STEERING_JOINTS, TYRE_GRIP, WHEEL_JOINTS
from zebrat_bullet.robot.motors import Motors

BODY_FILE = "body.obj"
"""Mesh that the plain URDF names; its hull is that of `PlainCar.body`."""
_LEAST_SHARE = 0.005
_WHEEL_WIDTH = 1.0 / 15.0
_SINK = 0.002
_DAMPING = 0.01
_GRIP_G = 1.0


@dataclass(frozen=True)
class PlainCar:
    """A car as physics takes it.

    Attributes:
        urdf: its text; link and joint names are the roles.
        body: (P, 3) points of the body in m, base frame.
        rolling_mass_kg, yaw_inertia_kgm2, weight_n, wheel_effort_nm: as `RobotModel` says.
    """

    urdf: str
    body: NDArray[np.float64]
    rolling_mass_kg: float
    yaw_inertia_kgm2: float
    weight_n: float
    wheel_effort_nm: float


def plain_car(chassis: Chassis, body: Body, motors: Motors, hinge_speed_radps: float) -> PlainCar:
    """Return a symmetric car on the floor, with the axles, outline, masses and motors that were found.

    The body is its outline, extruded: nothing but that touches walls. Moments of inertia are those of the shapes, as
    Bullet takes them. A wheel rolls on the crown of its tyre, and gives a little, so that all four share the weight.
    """
    assert body.outline is not None
    wheels, radii = mirrored(chassis.wheels), axle_means(chassis.radii)
    hinges = mirrored(chassis.hinges)
    hinges[:, 0], hinges[:, 2] = wheels[2:, 0], wheels[2:, 2]
    least = _LEAST_SHARE * (body.mass_kg + body.wheel_kg.sum() + body.knuckle_kg.sum())
    wheel_kg = np.maximum(axle_means(body.wheel_kg), least)
    knuckle_kg = float(max(body.knuckle_kg.mean(), least))
    mass = float(body.mass_kg + wheel_kg.sum() + 2.0 * knuckle_kg)
    rear_x = float(wheels[0, 0])
    top = float(max(body.points[:, 2].max(), radii.max()))
    bottom = min(max(float(body.points[:, 2].min()), 0.2 * float(radii.min())), 0.5 * top)
    length, width = np.ptp(body.outline, axis=0)
    centre = body.centre
    if centre is None:
        centre = np.array([float(wheels[:, 0].mean()), 0.0, (bottom + top) / 2.0])
    effort = min(motors.wheel_effort_nm, _GRIP_G * mass * GRAVITY_MPS2 * float(radii.min()) / 4.0)
    izz = body.mass_kg / 12.0 * (length**2 + width**2)
    yaw = izz + body.mass_kg * ((centre[0] - rear_x) ** 2 + centre[1] ** 2)
    yaw += knuckle_kg * sum((x - rear_x) ** 2 + y**2 for x, y, _ in hinges)
    stiffness = float(mass * GRAVITY_MPS2 / 4.0 / (_SINK * float(radii.min())))
    parts = [_body_link(body.mass_kg, centre, (length, width, top - bottom))]
    spin = 0.0
    for k, (role, at, radius, kg) in enumerate(zip(WHEEL_JOINTS, wheels, radii, wheel_kg, strict=True)):
        about, across = _wheel_inertia(kg, radius)
        spin += about / radius**2
        yaw += across + kg * ((at[0] - rear_x) ** 2 + at[1] ** 2)
        parent, place = ("base_link", at) if k < 2 else (f"{STEERING_JOINTS[k - 2]}_knuckle", at - hinges[k - 2])
        parts += [_wheel_link(role, kg, radius, stiffness), _joint(role, "continuous", parent, f"{role}_wheel", place,
                  "0 1 0", f'effort="{effort!r}" velocity="{min(motors.wheel_speed_radps, 1e6)!r}"')]  # fmt: skip
    for role, at in zip(STEERING_JOINTS, hinges, strict=True):
        limit = f'lower="{-motors.knuckle_rad!r}" upper="{motors.knuckle_rad!r}" '
        limit += f'effort="{motors.hinge_effort_nm!r}" velocity="{hinge_speed_radps!r}"'
        parts += [_knuckle_link(role, knuckle_kg, float(radii[2])), _joint(role, "revolute", "base_link",
                  f"{role}_knuckle", at, "0 0 1", limit)]  # fmt: skip
    return PlainCar(
        urdf='<?xml version="1.0"?>\n<robot name="car">\n' + "\n".join(parts) + "\n</robot>\n",
        body=np.array([(x, y, z) for z in (bottom, top) for x, y in body.outline]),
        rolling_mass_kg=mass + spin,
        yaw_inertia_kgm2=float(yaw),
        weight_n=mass * GRAVITY_MPS2,
        wheel_effort_nm=effort,
    )


def mirrored(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (2n, 3) points, left and right in turn, made mirror images of each other."""
    flip = np.array([1.0, -1.0, 1.0])
    left = (points[::2] + points[1::2] * flip) / 2.0
    return np.stack([left, left * flip], axis=1).reshape(points.shape)


def axle_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (4,) values of wheels, those of an axle made alike."""
    return np.repeat((values[::2] + values[1::2]) / 2.0, 2)


def _text(point: NDArray[np.float64]) -> str:
    return " ".join(repr(float(value)) for value in point)


def _inertial(kg: float, xyz: str, inertia: tuple[float, float, float]) -> str:
    ixx, iyy, izz = (repr(float(value)) for value in inertia)
    return (
        f'<inertial><origin xyz="{xyz}"/><mass value="{float(kg)!r}"/>'
        f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/></inertial>'
    )


def _body_link(kg: float, centre: NDArray[np.float64], size: tuple[float, float, float]) -> str:
    x, y, z = (side**2 * kg / 12.0 for side in size)
    inertial = _inertial(kg, _text(centre), (y + z, x + z, x + y))
    shape = f'<collision><geometry><mesh filename="{BODY_FILE}"/></geometry></collision>'
    return f'<link name="base_link">{inertial}{shape}</link>'


def _wheel_inertia(kg: float, radius: float) -> tuple[float, float]:
    """Return the moments of inertia of a wheel about its axle and across it."""
    return kg * radius**2 / 2.0, kg * (3.0 * radius**2 + (_WHEEL_WIDTH * radius) ** 2) / 12.0


def _wheel_link(role: str, kg: float, radius: float, stiffness: float) -> str:
    about, across = _wheel_inertia(kg, radius)
    return (
        f'<link name="{role}_wheel"><contact><lateral_friction value="{TYRE_GRIP}"/><stiffness value="{stiffness!r}"/>'
        f'<damping value="{_DAMPING * stiffness!r}"/></contact>{_inertial(kg, "0 0 0", (across, about, across))}'
        f'<collision><origin rpy="{math.pi / 2!r} 0 0"/><geometry>'
        f'<cylinder radius="{float(radius)!r}" length="{_WHEEL_WIDTH * float(radius)!r}"/></geometry></collision>'
        "</link>"
    )


def _knuckle_link(role: str, kg: float, radius: float) -> str:
    inertia = 0.1 * kg * radius**2
    return f'<link name="{role}_knuckle">{_inertial(kg, "0 0 0", (inertia, inertia, inertia))}</link>'


def _joint(name: str, kind: str, parent: str, child: str, at: NDArray[np.float64], axis: str, limit: str) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_text(at)}"/><axis xyz="{axis}"/><limit {limit}/></joint>'
    )
