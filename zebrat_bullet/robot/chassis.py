"""Where the axles of a car stand: from four wheels and two hinges to a base frame and a symmetric pair of axles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.robot.model import STEERING_JOINTS, WHEEL_JOINTS
from zebrat_bullet.robot.parts import Parts, called
from zebrat_bullet.robot.setup import RobotSetup
from zebrat_bullet.robot.shapes import Round, rolling_shape

LEAST_WHEELBASE_M, MOST_WHEELBASE_M = 0.03, 10.0
_ASKEW = 0.06
"""Sine of the angle by which an axis may stand askew; beyond, it is another axis."""
_SNAP = 0.02
_SIDES = np.array([1.0, -1.0, 1.0, -1.0])
_LOOSE = 0.02
"""Part of the wheelbase by which what should be alike may differ: exported models are rounded, and not of one piece."""


@dataclass
class Chassis:
    """Axles in the base frame, in m: on the floor, x forward, y = 0 midway between the wheels.

    Attributes:
        base_from_root: (4, 4) pose of the URDF's root link.
        wheels: (4, 3) their centres, in the order of `WHEEL_JOINTS`.
        radii: (4,).
        widths: (4,) along the axles.
        hinges: (2, 3).
        signs: of each hinge and wheel joint: 1 where it turns left-positive and rolls forward-positive.
        notes: what was straightened.
    """

    base_from_root: NDArray[np.float64]
    wheels: NDArray[np.float64]
    radii: NDArray[np.float64]
    widths: NDArray[np.float64]
    hinges: NDArray[np.float64]
    signs: dict[str, float]
    notes: list[str]

    @property
    def wheelbase_m(self) -> float:
        return float(self.wheels[2:, 0].mean() - self.wheels[:2, 0].mean())


def find_chassis(parts: Parts, setup: RobotSetup) -> tuple[Chassis | None, list[str]]:
    """Return the chassis, and all that is wrong with it, each with its mend; None where wheels are not understood."""
    problems: list[str] = []
    axles = {role: _axle(parts, setup, role, problems) for role in WHEEL_JOINTS}
    if any(axle is None for axle in axles.values()):
        return None, problems
    centres = np.array([axle[0] for axle in axles.values() if axle])
    spins = np.array([axle[1] for axle in axles.values() if axle])
    rolling = [axle[2] for axle in axles.values() if axle]
    radii = np.array([one.radius_m for one in rolling])
    along = np.array([one.along_m for one in rolling])
    turn = _base_axes(centres + along[:, None] * spins, problems)
    if turn is None:
        return None, problems
    hinges = np.array([parts.pose(parts.child(role))[:3, 3] for role in STEERING_JOINTS])
    hinge_axes = np.array([parts.pose(parts.child(r))[:3, :3] @ parts.axis(r) for r in STEERING_JOINTS])
    centres, spins, hinges, hinge_axes = (rows @ turn.T for rows in (centres, spins, hinges, hinge_axes))
    outside, apart = _outside_of_joints(along * spins[:, 1])
    centres[:, 1] += outside * _SIDES
    shift = np.array([0.0, -float(centres[:, 1].mean()), -float((centres[:, 2] - radii).mean())])
    base_from_root = np.eye(4)
    base_from_root[:3, :3], base_from_root[:3, 3] = turn, shift
    signs = dict(zip(STEERING_JOINTS, np.where(hinge_axes[:, 2] >= 0, 1.0, -1.0).tolist(), strict=True))
    signs |= dict(zip(WHEEL_JOINTS, np.where(spins[:, 1] >= 0, 1.0, -1.0).tolist(), strict=True))
    chassis = Chassis(
        base_from_root=base_from_root,
        wheels=centres + shift,
        radii=radii,
        widths=np.array([one.width_m for one in rolling]),
        hinges=hinges + shift,
        signs=signs,
        notes=_frame_notes(base_from_root)
        + ([f"wheels with shapes {apart:.4f} m to one side of their joints were centred"] if apart > 1e-3 else []),
    )
    problems += _axis_problems(parts, spins, hinge_axes)
    problems += _size_problems(chassis, rolling)
    return chassis, problems


def _outside_of_joints(left_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return (4,) how far outside of its joint each wheel stands, and by how much left and right differed.

    Args:
        left_m: (4,) how far to the left of its joint the shape of each wheel stands.
    """
    outside = left_m * _SIDES
    means = np.repeat((outside[::2] + outside[1::2]) / 2.0, 2)
    return means, float(np.abs(outside - means).max())


def _axle(
    parts: Parts, setup: RobotSetup, role: str, problems: list[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64], Round] | None:
    """Return joint and axle of a wheel in the root frame and its shape, or note why there is none."""
    name, link = called(role, parts.joints[role].get("name")), parts.child(role)
    pose, axis = parts.pose(link), parts.axis(role)
    if not np.linalg.norm(axis):
        problems.append(f"{name}: <axis> must not be zero; write the axle, as 0 1 0")
        return None
    shapes = parts.rolling(role)
    shape = rolling_shape(shapes, axis)
    unwritten = parts.joints[role].find("axis") is None or parts.types[role] == "fixed"
    if isinstance(shape, str) and unwritten:
        # What is only painted needs no axis; its cylinder says where the axle is.
        for guess in np.eye(3)[[1, 2]]:
            other = rolling_shape(shapes, guess)
            if isinstance(other, Round):
                axis, shape = guess, other
                parts.joints[role].append(parts.joints[role].makeelement("axis", {"xyz": " ".join(map(str, guess))}))
                break
    radius = setup.numbers.get("wheel_radius_m")
    if isinstance(shape, str):
        if radius is None:
            problems.append(f"the wheel of {name}, link {link}, {shape}; or say wheel_radius_m=...")
            return None
        shape = Round(radius, 0.0, radius / 2.0, 0.0)
    if radius is not None:
        shape = Round(radius, shape.along_m, shape.width_m, shape.off_axle_m)
    if not shape.radius_m > 0:
        problems.append(f"the wheel of {name} has the radius {shape.radius_m} m; write one above 0")
        return None
    spin = pose[:3, :3] @ axis
    return pose[:3, 3], spin, shape


def _base_axes(centres: NDArray[np.float64], problems: list[str]) -> NDArray[np.float64] | None:
    """Return the (3, 3) rotation from the root's frame into one with x forward and z up."""
    forward = centres[2:].mean(axis=0) - centres[:2].mean(axis=0)
    if (crossed := _crossed_pair(centres, forward)) is not None:
        problems.append(crossed)
        return None
    left = centres[::2].mean(axis=0) - centres[1::2].mean(axis=0)
    up = np.cross(forward, left)
    if np.linalg.norm(up) < 1e-6:
        problems.append("the wheels stand on one spot or in one line; put left and right, rear and front apart")
        return None
    up /= np.linalg.norm(up)
    axis = int(np.argmax(np.abs(up)))
    upright = np.zeros(3)
    upright[axis] = np.sign(up[axis])
    if up @ upright < 0.95:
        problems.append(f"the wheels lie in a plane that stands askew to the root link's axes (up is {up.round(2)})")
        return None
    if upright[2] < 0:
        problems.append(
            "seen along the root link's z, the left wheels stand on the right of the right ones (front is where the "
            "steered wheels are); swap the names of left and right, or turn the root link z up"
        )
        return None
    forward -= (forward @ upright) * upright
    forward /= np.linalg.norm(forward)
    nearest = np.zeros(3)
    nearest[np.argmax(np.abs(forward))] = np.sign(forward[np.argmax(np.abs(forward))])
    if np.linalg.norm(forward - nearest) < _SNAP:
        forward = nearest
    turn = np.array([forward, np.cross(upright, forward), upright])
    return turn + 0.0  # no negative zeros


def _crossed_pair(centres: NDArray[np.float64], forward: NDArray[np.float64]) -> str | None:
    """Return what is said where left and right are swapped on one axle alone, seen along the root link's z."""
    lefts = centres[::2] - centres[1::2]
    if lefts[0] @ lefts[1] >= 0:
        return None
    wrong = int(np.argmin(np.cross(forward, lefts)[:, 2]))
    axle, roles = ("rear", WHEEL_JOINTS[:2]) if wrong == 0 else ("front", (*WHEEL_JOINTS[2:], *STEERING_JOINTS))
    pairs = " and of ".join(f"{left} and {right}" for left, right in zip(roles[::2], roles[1::2], strict=True))
    return f"the left {axle} wheel stands on the right of the right one; swap the names of {pairs}"


def _frame_notes(base_from_root: NDArray[np.float64]) -> list[str]:
    notes, (_, y, z) = [], base_from_root[:3, 3]
    if not np.allclose(base_from_root[:3, :3], np.eye(3), atol=1e-3):
        angle = np.degrees(np.arctan2(base_from_root[1, 0], base_from_root[0, 0]))
        notes.append(f"the root link does not look ahead with x; it is turned by {angle:.0f} degrees")
    if abs(z) > 1e-3:
        notes.append(f"the root link is not on the floor; it is lifted by {z:.4f} m, so that the wheels stand on it")
    if abs(y) > 1e-3:
        notes.append(f"the root link is not midway between the wheels; it is moved by {y:.4f} m")
    return notes


def _axis_problems(parts: Parts, spins: NDArray[np.float64], hinge_axes: NDArray[np.float64]) -> list[str]:
    problems = []
    for roles, axes, wanted, what in (
        (WHEEL_JOINTS, spins, 1, "along y (0 1 0), the axle"),
        (STEERING_JOINTS, hinge_axes, 2, "along z (0 0 1), upright"),
    ):
        for role, axis in zip(roles, axes, strict=True):
            if not abs(axis[wanted]) > np.sqrt(1.0 - _ASKEW**2) * np.linalg.norm(axis) > 0:
                problems.append(
                    f"the axis of {called(role, parts.joints[role].get('name'))} must point {what}, of the base frame; "
                    f"it points along {axis.round(3).tolist()}: turn <axis>, or the joint's <origin rpy>"
                )
    return problems


def _size_problems(chassis: Chassis, rolling: list[Round]) -> list[str]:
    wheels, radii, base = chassis.wheels, chassis.radii, chassis.wheelbase_m
    if not LEAST_WHEELBASE_M <= base <= MOST_WHEELBASE_M:
        hint = "lengths are in metres: scale it by 0.001" if base > MOST_WHEELBASE_M else "front wheels stand ahead"
        return [
            f"the wheelbase is {base:.3f} m, between {LEAST_WHEELBASE_M} and {MOST_WHEELBASE_M} m can drive; {hint}"
        ]
    problems, loose = [], max(_LOOSE * base, 2e-3)
    mirrored = wheels[1::2] * (1, -1, 1)
    off = np.abs(wheels[::2] - mirrored).max(axis=1)
    for axle, apart in zip(("rear", "front"), off, strict=True):
        if apart > loose:
            problems.append(
                f"left and right {axle} wheels must mirror each other within {loose:.4f} m, they are {apart:.4f} m "
                "off; mend their <origin xyz>"
            )
    for axle, pair in zip(("rear", "front"), (radii[:2], radii[2:]), strict=True):
        if np.ptp(pair) > _LOOSE * pair.max():
            problems.append(f"the two {axle} wheels must have one radius, got {pair.round(4).tolist()} m")
    heights = wheels[:, 2] - radii
    if np.ptp(heights) > max(loose, 0.05 * radii.min()):
        problems.append(
            f"the wheels do not stand on one floor: their lowest points are {heights.round(4).tolist()} m high; mend "
            "their <origin xyz> or radii"
        )
    for role, one in zip(WHEEL_JOINTS, rolling, strict=True):
        if one.off_axle_m > max(0.1 * one.radius_m, 1e-6):
            problems.append(
                f"the shape of {role} must be centred on its axle, it is {one.off_axle_m:.4f} m off; mend its <origin>"
            )
    reach = wheels[2:, 0] - chassis.hinges[:, 0]
    if np.abs(reach).max() > max(0.1 * base, 2e-3):
        problems.append(
            f"front wheels must stand beside their hinges, they are {np.abs(reach).max():.4f} m ahead of or behind "
            "them; mend their <origin xyz>"
        )
    outside = (wheels[2:, 1] - chassis.hinges[:, 1]) * (1, -1)
    if np.ptp(outside) > 2 * loose or np.abs(chassis.hinges[:, 1]).min() < 0.1 * np.abs(wheels[2:, 1]).min():
        problems.append("left and right steering hinges must mirror each other, beside the wheels; mend their <origin>")
    return problems
