"""Which joint and which link of a URDF plays which part in a car; the rest is frozen to the body."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import yourdfpy
from lxml import etree
from numpy.typing import NDArray
from yourdfpy.urdf import Collision

from zebrat_bullet.robot.document import Document
from zebrat_bullet.robot.model import LIDAR_JOINT, STEERING_JOINTS, WHEEL_JOINTS
from zebrat_bullet.robot.setup import RobotSetup

_DROPPED = ("mimic", "dynamics", "safety_controller", "calibration")


@dataclass
class Parts:
    """The parts of a car in a document.

    Attributes:
        document: whose joints are now revolute hinges, continuous wheels, and fixed.
        joints: role to joint element, of those that are there.
        lidar: its link, if it is there.
        types: what each role's joint was called in the file.
        missing: roles that nothing plays.
        problems: what else is wrong with the roles, each with its mend.
        moved: joints that could move and play no role; they are held where 0 puts them.
    """

    document: Document
    joints: dict[str, etree._Element]
    lidar: str | None
    types: dict[str, str]
    missing: list[str]
    problems: list[str]
    moved: list[str]

    @cached_property
    def urdf(self) -> yourdfpy.URDF:
        """The car with everything at 0; raises RobotError where it cannot be read."""
        return self.document.urdf()

    def child(self, role: str) -> str:
        """Return the link that a role's joint moves."""
        return self.joints[role].find("child").get("link")

    def pose(self, link: str) -> NDArray[np.float64]:
        """Return the (4, 4) pose of a link in the root link's frame."""
        return np.asarray(self.urdf.get_transform(link, self.document.root))

    def axis(self, role: str) -> NDArray[np.float64]:
        """Return the (3,) unit axis of a role's joint in its child's frame; zero where none is written of it."""
        axis = np.asarray(self.urdf.joint_map[self.joints[role].get("name")].axis, dtype=np.float64)
        length = np.linalg.norm(axis)
        return axis / length if length > 0 else axis

    def above(self, link: str) -> list[str]:
        """Return the links from the root down to a link, the link included."""
        chain = [link]
        while chain[-1] in self.document.parent_of:
            joint = self.document.joints[self.document.parent_of[chain[-1]]]
            chain.append(joint.find("parent").get("link"))
        return chain[::-1]

    def below(self, roles: tuple[str, ...]) -> list[str]:
        """Return the links that the joints of these roles move."""
        heads = {self.child(role) for role in roles if role in self.joints}
        return [link for link in self.document.links if heads.intersection(self.above(link))]

    def rolling(self, role: str) -> list[Collision]:
        """Return the shapes of a wheel, also those of links fixed to it, placed in its joint's child frame.

        Its collision shapes count, its visual ones where there are none.
        """
        wheel = self.child(role)
        found: dict[str, list[Collision]] = {"collisions": [], "visuals": []}
        for name in self.below((role,)):
            placed = np.linalg.inv(self.pose(wheel)) @ self.pose(name)
            for kind, shapes in found.items():
                own = getattr(self.urdf.link_map[name], kind)
                shapes += own if name == wheel else [_placed(shape, placed) for shape in own]
        return found["collisions"] or found["visuals"]

    @cached_property
    def body(self) -> list[str]:
        """Names of the links that are neither steered nor roll."""
        moving = self.below((*STEERING_JOINTS, *WHEEL_JOINTS))
        return [link for link in self.document.links if link not in moving]


def find_parts(document: Document, setup: RobotSetup) -> Parts:
    """Return the parts that the setup names, and freeze all other joints."""
    joints = {
        role: document.joints[setup.roles[role]]
        for role in (*STEERING_JOINTS, *WHEEL_JOINTS)
        if setup.roles[role] in document.joints
    }
    named = setup.roles[LIDAR_JOINT]
    at = document.joints.get(named)
    lidar = at.find("child").get("link") if at is not None else named if named in document.links else None
    missing = [role for role in (*STEERING_JOINTS, *WHEEL_JOINTS) if role not in joints]
    missing += [LIDAR_JOINT] if lidar is None else []
    parts = Parts(document, joints, lidar, {r: j.get("type", "") for r, j in joints.items()}, missing, [], [])
    parts.problems += _doubled(parts)
    for hinge, wheel in zip(STEERING_JOINTS, WHEEL_JOINTS[2:], strict=True):
        if {hinge, wheel} <= joints.keys() and parts.child(hinge) not in parts.above(parts.child(wheel))[:-1]:
            parts.problems.append(
                f"{_called(parts, wheel)} must hang on the child link of {_called(parts, hinge)}, or it cannot steer; "
                f"make {parts.child(hinge)} its parent, or name the right joints"
            )
    if lidar is not None and lidar not in parts.body:
        above = [role for role, joint in joints.items() if joint.find("child").get("link") in parts.above(lidar)]
        parts.problems.append(
            f"{called(LIDAR_JOINT, named)} hangs on {_called(parts, above[-1])}, which moves; hang it on the body, or "
            "name a lidar that is fixed to it"
        )
    _freeze(parts)
    return parts


def _placed(shape: Collision, pose: NDArray[np.float64]) -> Collision:
    return replace(shape, origin=pose if shape.origin is None else pose @ shape.origin)


def _doubled(parts: Parts) -> list[str]:
    by_joint: dict[str, list[str]] = {}
    for role, joint in parts.joints.items():
        by_joint.setdefault(joint.get("name"), []).append(role)
    return [
        f"{' and '.join(roles)} are one joint, {name}; each role needs its own"
        for name, roles in by_joint.items()
        if len(roles) > 1
    ]


def _called(parts: Parts, role: str) -> str:
    return called(role, parts.joints[role].get("name"))


def called(role: str, name: str) -> str:
    """Return how messages call a joint: by its role, and by its own name where that is another."""
    return role if role == name else f"{role} ({name})"


def _freeze(parts: Parts) -> None:
    roles = {id(joint): role for role, joint in parts.joints.items()}
    for name, joint in parts.document.joints.items():
        for tag in _DROPPED:
            for element in joint.findall(tag):
                joint.remove(element)
        role = roles.get(id(joint))
        if role is None and joint.get("type") != "fixed":
            parts.moved.append(name)
        if role in STEERING_JOINTS and joint.get("type") == "fixed" and joint.find("axis") is None:
            joint.append(joint.makeelement("axis", {"xyz": "0 0 1"}))  # a hinge that is only painted has no axis
        kind = "fixed" if role is None else "revolute" if role in STEERING_JOINTS else "continuous"
        joint.set("type", kind)
