"""The body of a car: its outline, its height and its mass."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from yourdfpy.urdf import Link

from zebrat_bullet.errors import RobotError
from zebrat_bullet.robot.chassis import Chassis
from zebrat_bullet.robot.model import STEERING_JOINTS, WHEEL_JOINTS
from zebrat_bullet.robot.motors import steering_limit
from zebrat_bullet.robot.parts import Parts
from zebrat_bullet.robot.setup import RobotSetup
from zebrat_bullet.robot.shapes import convex_outline, shape_points

_STANDS_OUT_M = 0.01
_LIDAR_M = 0.02
_N_STEERED = 7
"""Steering angles at which what is steered is looked at: each corner of the footprint costs a bearing."""
_MOST_MASS_KG = 1e5
_MOST_WHEELBASES = 20.0
"""So many times as long as its wheelbase no car is."""


@dataclass
class Body:
    """All of a car that is neither steered nor rolls, in m and kg, base frame.

    Attributes:
        points: (P, 3), whose convex outline is the footprint; empty where nothing has a shape.
        outline: (K, 2) the footprint, None where there is none.
        as_collision: whether the collision shapes alone give the outline.
        mass_kg, centre: of the body, (3,); centre is None where no link has a mass.
        knuckle_kg, wheel_kg: (2,) and (4,).
        notes: what was taken.
    """

    points: NDArray[np.float64]
    outline: NDArray[np.float64] | None
    as_collision: bool
    mass_kg: float
    centre: NDArray[np.float64] | None
    knuckle_kg: NDArray[np.float64]
    wheel_kg: NDArray[np.float64]
    notes: list[str]


def find_body(parts: Parts, chassis: Chassis, setup: RobotSetup) -> tuple[Body, list[str]]:
    """Return the body, and all that is wrong with it, each with its mend."""
    problems: list[str] = []
    notes: list[str] = []
    points, outline, as_collision = _outline(parts, chassis, setup, problems, notes)
    if outline is not None:
        _check_length(outline, chassis, problems)
    mass, centre = _mass(parts, chassis, parts.body)
    if "body_mass_kg" in setup.numbers:
        mass = setup.numbers["body_mass_kg"]
    if not 0 < mass < _MOST_MASS_KG:
        problems.append(
            f"the body ({', '.join(parts.body[:3])}...) has a mass of {mass:g} kg, needed is one above 0 and below "
            f"{_MOST_MASS_KG:g}; give one of its links <inertial> with <mass>, or say body_mass_kg=..."
        )
    if centre is not None:
        _check_centre(centre, chassis, problems)
    weightless = [link for link in parts.document.links if _shaped(parts.urdf.link_map[link]) and not _kg(parts, link)]
    if weightless:
        notes.append(f"without <inertial>, so without a mass of their own: {', '.join(weightless)}")
    knuckles = np.array([_mass(parts, chassis, _steered_links(parts, role))[0] for role in STEERING_JOINTS])
    wheels = np.array([_mass(parts, chassis, parts.below((role,)))[0] for role in WHEEL_JOINTS])
    return Body(points, outline, as_collision, mass, centre, knuckles, wheels, notes), problems


def _check_length(outline: NDArray[np.float64], chassis: Chassis, problems: list[str]) -> None:
    length = float(np.ptp(outline, axis=0).max())
    wheelbase = float(chassis.wheels[2:, 0].mean() - chassis.wheels[:2, 0].mean())
    if length > _MOST_WHEELBASES * wheelbase:
        problems.append(
            f"the body is {length:.3g} m long with the axles {wheelbase:.3g} m apart, which is more than "
            f"{_MOST_WHEELBASES:g} times that; sizes are in m: a mesh that is written in mm takes "
            'scale="0.001 0.001 0.001" in its <mesh>'
        )


def _shaped(link: Link) -> bool:
    return bool(link.collisions or link.visuals)


def _kg(parts: Parts, link: str) -> float:
    inertial = parts.urdf.link_map[link].inertial
    return 0.0 if inertial is None or inertial.mass is None else float(inertial.mass)


def _mass(parts: Parts, chassis: Chassis, links: Iterable[str]) -> tuple[float, NDArray[np.float64] | None]:
    total, moment = 0.0, np.zeros(3)
    for name in links:
        if kg := _kg(parts, name):
            origin = parts.urdf.link_map[name].inertial.origin
            placed = chassis.base_from_root @ parts.pose(name) @ (np.eye(4) if origin is None else origin)
            total, moment = total + kg, moment + kg * placed[:3, 3]
    return total, moment / total if total > 0 else None


def _check_centre(centre: NDArray[np.float64], chassis: Chassis, problems: list[str]) -> None:
    rear, front = chassis.wheels[:2, 0].mean(), chassis.wheels[2:, 0].mean()
    side = np.abs(chassis.wheels[:, 1]).min()
    if not (rear < centre[0] < front and abs(centre[1]) < side):
        problems.append(
            f"the body's centre of mass is at {centre.round(3).tolist()} m, not between the axles (x {rear:.3f} to "
            f"{front:.3f}) and the wheels (y within {side:.3f}): the car would tip over; mend <inertial><origin>"
        )


def _outline(
    parts: Parts, chassis: Chassis, setup: RobotSetup, problems: list[str], notes: list[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, bool]:
    """Return the points of the body, their outline, and whether collision shapes alone made it."""
    solid = {name: _points(parts, chassis, name, "collisions", problems) for name in parts.body}
    solid = {name: points for name, points in solid.items() if len(points)}
    collision = np.vstack([np.empty((0, 3)), *solid.values()])
    _check_floor(solid, chassis, problems)
    if setup.footprint == "collision":
        outline = convex_outline(collision[:, :2]) if len(collision) else None
        if outline is None:
            problems.append("the body has no collision shape with an area; give it one, or say footprint=hull")
        return collision, outline, True
    others = _others(parts, chassis, setup, solid, notes)
    outline = convex_outline(collision[:, :2]) if len(collision) else None
    out = {
        name: points for name, points in others.items() if outline is None or _outside(outline, points) > _STANDS_OUT_M
    }
    if not out:
        return collision, outline, True
    points = np.vstack([collision, *(out if setup.footprint == "auto" else others).values()])
    hull = convex_outline(points[:, :2])
    if hull is None:
        problems.append("no link has a shape with an area, so there is no footprint; give the body a <collision>")
    elif setup.footprint == "auto":
        farthest = max((_outside(outline, at) for at in out.values()), default=0.0) if outline is not None else 0.0
        said = f"up to {farthest:.3f} m outside of the collision shapes" if outline is not None else "without one"
        notes.append(
            f"{', '.join(out)} stand {said}; the footprint is the hull of all "
            "(footprint=collision keeps to the collision shapes)"
        )
    return points, hull, False


def _check_floor(solid: dict[str, NDArray[np.float64]], chassis: Chassis, problems: list[str]) -> None:
    deep = {name: float(points[:, 2].min()) for name, points in solid.items()}
    for name, lowest in deep.items():
        if lowest < -max(0.005, 0.05 * float(chassis.radii.min())):
            problems.append(
                f"the collision shape of {name} reaches {-lowest:.3f} m below the floor that the wheels stand on; move "
                "or shrink it, or mend the wheels' radius"
            )


def _others(
    parts: Parts, chassis: Chassis, setup: RobotSetup, solid: dict[str, NDArray[np.float64]], notes: list[str]
) -> dict[str, NDArray[np.float64]]:
    """Return what may stand outside of the body's collision shapes.

    Wheels, collision shapes that roll or are steered with them, the lidar, and bodies that are only painted.
    """
    everything = setup.footprint == "hull" or not solid
    found: dict[str, NDArray[np.float64]] = {}
    unread: list[str] = []
    for role, centre, radius, width in zip(WHEEL_JOINTS, chassis.wheels, chassis.radii, chassis.widths, strict=True):
        reach = np.array([radius, width / 2.0, radius])
        corners = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        found[role] = centre + corners * reach
        found[role] = np.vstack([found[role], _fixed_to_wheel(parts, chassis, role, unread)])
    for role in STEERING_JOINTS:
        found |= _steered(parts, chassis, role, steering_limit(parts, setup)[0], unread)
    for name in parts.body:
        if everything or name not in solid:
            points = _points(parts, chassis, name, "visuals", unread)
            if len(points):
                found[name] = points
    notes += [f"{said}; it is left out of the footprint" for said in unread]
    if parts.lidar is not None:
        at = (chassis.base_from_root @ parts.pose(parts.lidar))[:3, 3]
        corners = np.array([(x, y, 0.0) for x in (-_LIDAR_M, _LIDAR_M) for y in (-_LIDAR_M, _LIDAR_M)])
        found.setdefault(parts.lidar, np.empty((0, 3)))
        found[parts.lidar] = np.vstack([found[parts.lidar], at + corners])
    return found


def _fixed_to_wheel(parts: Parts, chassis: Chassis, role: str, unread: list[str]) -> NDArray[np.float64]:
    """Return (P, 3) corners about the collision shapes of the links fixed to a wheel, wherever it has rolled to."""
    wheel, corners = parts.child(role), [np.empty((0, 3))]
    centre = (chassis.base_from_root @ parts.pose(wheel))[:3, 3]
    for name in parts.below((role,)):
        if name == wheel:
            continue
        offsets = _points(parts, chassis, name, "collisions", unread) - centre
        if len(offsets):
            radius = float(np.hypot(offsets[:, 0], offsets[:, 2]).max())
            ends = (offsets[:, 1].min(), offsets[:, 1].max())
            corners.append(centre + [(x, y, z) for x in (-radius, radius) for y in ends for z in (-radius, radius)])
    return np.vstack(corners)


def _steered_links(parts: Parts, role: str) -> list[str]:
    """Return a knuckle and the links fixed to it."""
    rolling = parts.below(WHEEL_JOINTS)
    return [link for link in parts.below((role,)) if link not in rolling]


def _steered(
    parts: Parts, chassis: Chassis, role: str, limit_rad: float, unread: list[str]
) -> dict[str, NDArray[np.float64]]:
    """Return the collision shapes of a knuckle and of the links fixed to it, all the way from lock to lock."""
    found, knuckle = {}, parts.child(role)
    placed = chassis.base_from_root @ parts.pose(knuckle)
    axis = placed[:3, :3] @ parts.axis(role)
    turns = [
        trimesh.transformations.rotation_matrix(angle, axis, placed[:3, 3])
        for angle in np.linspace(-limit_rad, limit_rad, _N_STEERED)
    ]
    for name in _steered_links(parts, role):
        points = _points(parts, chassis, name, "collisions", unread)
        if len(points):
            found[name] = np.vstack([trimesh.transform_points(points, turn) for turn in turns])
    return found


def _points(parts: Parts, chassis: Chassis, name: str, kind: str, problems: list[str]) -> NDArray[np.float64]:
    """Return (P, 3) points of a link's shapes in the base frame; a mesh that cannot be read is noted."""
    placed = chassis.base_from_root @ parts.pose(name)
    found = [np.empty((0, 3))]
    for shape in getattr(parts.urdf.link_map[name], kind):
        try:
            found.append(trimesh.transform_points(shape_points(shape), placed))
        except RobotError as error:
            problems.append(f"link {name}: {error}")
    return np.vstack(found)


def _outside(outline: NDArray[np.float64], points: NDArray[np.float64]) -> float:
    """Return how far in m the farthest point stands outside of a convex, counter-clockwise outline."""
    along = np.roll(outline, -1, axis=0) - outline
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    return float((points[:, :2] @ normals.T - (normals * outline).sum(axis=1)).max(axis=1).max(initial=0.0))
