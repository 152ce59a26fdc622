"""What kind of vehicle a URDF seems to be, by the axes of its joints, and which of them could play the roles."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.robot.model import LIDAR_JOINT, ROLES, STEERING_JOINTS, WHEEL_JOINTS
from zebrat_bullet.robot.parts import Parts, called

_UPRIGHT = 0.8
_LIDAR_WORDS = ("lidar", "laser", "velodyne", "hokuyo", "rplidar", "scan", "ouster", "livox", "vlp")


def missing_roles(parts: Parts, types: dict[str, str], named: Mapping[str, str]) -> tuple[str, dict[str, str]]:
    """Return what is said of roles that nothing plays, and what could play them.

    It says what they are, what the vehicle seems to be, and what to write.

    Args:
        parts: with at least one role missing.
        types: type of every joint as the file writes it.
        named: the name that was looked for, of each role.
    """
    kinds = {r: "revolute" if r in STEERING_JOINTS else "continuous" for r in ROLES} | {
        LIDAR_JOINT: "fixed, or any link"
    }
    needed = ", ".join(f"{role} ({kind})" for role, kind in kinds.items())
    lacking = ", ".join(called(role, named[role]) for role in parts.missing)
    said = f"lacks the joints {lacking}; a car-like robot needs {needed}"
    hinges, wheels = _by_axis(parts, types)
    steered = {w: h for h in hinges for w in wheels if _child(parts, h) in parts.above(_child(parts, w))[:-1]}
    wheels_missing = [role for role in parts.missing if role != LIDAR_JOINT]
    if wheels_missing and (kind := _other_kind(parts, hinges, wheels, steered)):
        return f"{said}. {kind}", {}
    guess = _lidar_guess(parts) if LIDAR_JOINT in parts.missing else {}
    guess |= _guess(parts, hinges, wheels, steered)
    chosen = {role: guess[role] for role in parts.missing if role in guess}
    if chosen:
        words = " ".join(f"'{role}={name}'" for role, name in chosen.items())
        others = _lidar_links(parts)[1:] if LIDAR_JOINT in chosen else []
        more = f" (the lidar may also be {', '.join(others[:10])})" if others else ""
        return f"{said}. Name them; by their axes these could be meant: --joints {words}{more}", chosen
    there = ", ".join(list(parts.document.joints)[:30]) or "none"
    return f"{said}. Name them with --joints ROLE=NAME; the joints there are: {there}", chosen


def _child(parts: Parts, joint: str) -> str:
    return parts.document.joints[joint].find("child").get("link")


def _by_axis(parts: Parts, types: dict[str, str]) -> tuple[list[str], list[str]]:
    """Return the joints that could steer, and those that could roll: upright and level axes."""
    hinges, wheels = [], []
    for name, kind in types.items():
        if kind not in ("revolute", "continuous"):
            continue
        joint = parts.urdf.joint_map[name]
        axis = parts.pose(_child(parts, name))[:3, :3] @ np.asarray(joint.axis, dtype=np.float64)
        if abs(axis[2]) > _UPRIGHT:
            hinges.append(name)
        elif abs(axis[2]) < 1.0 - _UPRIGHT:
            wheels.append(name)
    steering = [h for h in hinges if any(_child(parts, h) in parts.above(_child(parts, w))[:-1] for w in wheels)]
    return steering, wheels


def _other_kind(parts: Parts, hinges: list[str], wheels: list[str], steered: dict[str, str]) -> str | None:
    """Return why the vehicle is no car with two steered front wheels, None where it may be one."""
    if not hinges and len(wheels) >= 2:
        upright = [
            n for n, j in parts.urdf.joint_map.items() if j.type != "fixed" or n in parts.moved if _upright(parts, n)
        ]
        if upright:
            return (
                f"It is a vehicle without front wheels that roll: {', '.join(upright[:4])} could steer, but no wheel "
                "with a joint of its own hangs on them; give each a wheel joint"
            )
        return (
            f"It steers with no joint ({len(wheels)} wheels roll): a differential drive or skid steering, which cannot "
            "drive here, only cars with two steered front wheels can; if fixed joints stand for hinges and axles, name "
            "them with --joints ROLE=NAME"
        )
    if len(hinges) == 1:
        return (
            f"It is a bicycle or tricycle model, steered by one joint, {hinges[0]}; only cars with two steered front "
            "wheels can drive here: write left and right hinges and wheels"
        )
    if hinges and not steered:
        return "Its front wheels do not roll: no wheel joint hangs on the hinges; give each hinge a wheel joint"
    return None


def _upright(parts: Parts, name: str) -> bool:
    axis = parts.pose(_child(parts, name))[:3, :3] @ np.asarray(parts.urdf.joint_map[name].axis, dtype=np.float64)
    return bool(abs(axis[2]) > _UPRIGHT)


def _guess(parts: Parts, hinges: list[str], wheels: list[str], steered: dict[str, str]) -> dict[str, str]:
    """Return joints for the steering and wheel roles; none where they do not look like a car's."""
    rear = [wheel for wheel in wheels if wheel not in steered]
    if len(hinges) != 2 or len(steered) != 2 or len(rear) != 2:
        return {}

    def at(name: str) -> NDArray[np.float64]:
        return parts.pose(_child(parts, name))[:2, 3]

    forward = np.sum([at(h) for h in hinges], axis=0) - np.sum([at(w) for w in rear], axis=0)

    def left_first(names: list[str]) -> list[str]:
        return sorted(names, key=lambda name: -float(forward[0] * at(name)[1] - forward[1] * at(name)[0]))

    hinges = left_first(hinges)
    front = [next(w for w, h in steered.items() if h == hinge) for hinge in hinges]
    return dict(zip((*STEERING_JOINTS, *WHEEL_JOINTS), [*hinges, *left_first(rear), *front], strict=True))


def _lidar_guess(parts: Parts) -> dict[str, str]:
    named = _lidar_links(parts)
    return {LIDAR_JOINT: named[0]} if named else {}


def _lidar_links(parts: Parts) -> list[str]:
    """Return the links of the body that may be a lidar, by their names: `laser`, `front_laser_link`, `lidar_cable`."""

    def likeness(link: str) -> int:
        name = link.lower().removesuffix("_link").removesuffix("_frame")
        return 0 if name in _LIDAR_WORDS else 1 if name.endswith(_LIDAR_WORDS) else 2

    named = [link for link in parts.body if any(word in link.lower() for word in _LIDAR_WORDS)]
    return sorted(named, key=likeness)
