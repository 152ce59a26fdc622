"""From a URDF to the numbers of a car: everything that is wrong with it is said at once, each with its mend."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from zebrat_bullet.errors import RobotError
from zebrat_bullet.files import shown
from zebrat_bullet.robot.body import Body, find_body
from zebrat_bullet.robot.chassis import Chassis, find_chassis
from zebrat_bullet.robot.document import Document
from zebrat_bullet.robot.model import LIDAR_JOINT, ROLES, STEERING_JOINTS, WHEEL_JOINTS, RobotModel
from zebrat_bullet.robot.motors import MOST_HINGE_SPEED_RADPS, Motors, find_motors
from zebrat_bullet.robot.parts import Parts, find_parts
from zebrat_bullet.robot.plain import axle_means, mirrored, plain_car
from zebrat_bullet.robot.setup import RobotSetup, robot_setup
from zebrat_bullet.robot.suggest import missing_roles
from zebrat_bullet.robot.written import as_physics_needs, written_inertia
from zebrat_bullet.values import of_kind


@dataclass
class Inspection:
    """What was understood of a URDF, as far as it was.

    Attributes:
        setup: file and roles.
        problems: what forbids to drive it, each with its mend; none of a car that loads.
        notes: what was taken otherwise than it is written.
        robot: the car, None where there are problems.
        chassis, body: axles and outline, None where they are not understood.
        lidar_base: (3,) where the lidar stands in the base frame, None where it is not known.
    """

    setup: RobotSetup
    problems: list[str]
    notes: list[str]
    robot: RobotModel | None = None
    chassis: Chassis | None = None
    body: Body | None = None
    lidar_base: NDArray[np.float64] | None = None


def load_robot(name_or_path: str | Path = "zebrat") -> RobotModel:
    """Read a shipped robot by name, or a user's car-like URDF by path, with settings if need be.

    `docs/your_own_car.md` says what a URDF must hold and how its joints are named: "my_car.urdf:lidar_mount=laser".

    Raises:
        AssetError: there is no such URDF.
        RobotError: it is no car, or not whole; the message lists all that is wrong, each with its mend.
    """
    seen = inspect_robot(name_or_path)
    if seen.robot is None:
        raise RobotError(refusal(seen))
    return seen.robot


def robot_of(robot: RobotModel | str | Path) -> RobotModel:
    """Return a robot that is one already, or is named as for `load_robot`.

    Raises:
        ConfigError: it is neither.
        AssetError, RobotError: as `load_robot`.
    """
    if isinstance(robot, str | Path):
        return load_robot(robot)
    return of_kind(robot, RobotModel, "a robot", 'name one, "zebrat", or give load_robot(...)')


def refusal(seen: Inspection) -> str:
    """Return what is said of a car that is refused."""
    path = shown(seen.setup.path, 300)
    if len(seen.problems) == 1:
        return f"{path}: {seen.problems[0]}"
    lines = "\n".join(f"  {n}. {problem}" for n, problem in enumerate(seen.problems, start=1))
    return f"{path}: {len(seen.problems)} things forbid to drive this car:\n{lines}"


def inspect_robot(name_or_path: str | Path) -> Inspection:
    """Return what can be understood of a URDF, also where it is refused.

    Raises:
        AssetError: there is no such URDF.
        RobotError: it is no URDF at all.
    """
    return _inspect(robot_setup(name_or_path))


def _inspect(setup: RobotSetup) -> Inspection:
    document = Document(setup)
    types = {name: joint.get("type", "") for name, joint in document.joints.items()}
    parts = find_parts(document, setup)
    seen = Inspection(setup, [*document.problems, *parts.problems], list(document.notes))
    parts.urdf  # noqa: B018 (what cannot be read at all is refused here)
    if parts.missing:
        said, guess = missing_roles(parts, types, setup.roles)
        seen.problems.insert(0, said)
        if guess.keys() - {LIDAR_JOINT} and guess.keys() >= set(parts.missing) - {LIDAR_JOINT}:
            _look_further(seen, guess)
            return seen
    if any(role in parts.missing for role in ROLES[:-1]) or parts.problems:
        return seen
    seen.chassis, problems = find_chassis(parts, setup)
    seen.problems += problems
    if seen.chassis is None:
        return seen
    seen.notes += seen.chassis.notes
    if parts.lidar is not None:
        seen.lidar_base = (seen.chassis.base_from_root @ parts.pose(parts.lidar))[:3, 3]
    seen.body, problems = find_body(parts, seen.chassis, setup)
    seen.problems += problems
    seen.notes += seen.body.notes
    mass = seen.body.mass_kg + float(seen.body.wheel_kg.sum() + seen.body.knuckle_kg.sum())
    motors, problems, notes = find_motors(parts, setup, mass, float(seen.chassis.radii.min()))
    seen.problems += problems
    seen.notes += notes
    if parts.moved:
        seen.notes.append(f"joints that neither steer nor roll are held still: {', '.join(parts.moved)}")
    if not seen.problems and seen.body.outline is not None:
        seen.robot = _model(parts, seen, seen.chassis, seen.body, motors)
    return seen


def _look_further(seen: Inspection, guess: dict[str, str]) -> None:
    """Note what else there is to say of a car, if what could play the missing roles does."""
    further = _inspect(replace(seen.setup, roles={**seen.setup.roles, **guess}))
    lacking = (problem for problem in further.problems if not problem.startswith("lacks the joints"))
    seen.problems += [problem for problem in lacking if problem not in seen.problems]
    seen.notes, seen.chassis, seen.body, seen.lidar_base = (
        further.notes, further.chassis, further.body, further.lidar_base
    )  # fmt: skip


def _model(parts: Parts, seen: Inspection, chassis: Chassis, body: Body, motors: Motors) -> RobotModel:
    assert body.outline is not None and parts.lidar is not None
    setup, hinge_speed = seen.setup, min(motors.hinge_speed_radps, MOST_HINGE_SPEED_RADPS)
    as_it_is = as_physics_needs(parts, setup, chassis, body, motors)
    wheels, hinges, radii = chassis.wheels, chassis.hinges, chassis.radii
    mount = parts.pose(parts.lidar)
    if as_it_is:
        plain, effort = None, motors.wheel_effort_nm
        rolling, yaw, weight = written_inertia(parts, float(radii[0]), float(wheels[0, 0]))
    else:
        mount = chassis.base_from_root @ mount
        wheels, hinges, radii = mirrored(wheels), mirrored(hinges), axle_means(radii)
        plain = plain_car(chassis, body, motors, hinge_speed)
        effort, weight = plain.wheel_effort_nm, plain.weight_n
        rolling, yaw = plain.rolling_mass_kg, plain.yaw_inertia_kgm2
    return RobotModel(
        source=setup.source,
        urdf_path=setup.path,
        wheelbase_m=float(wheels[2, 0] - wheels[0, 0]),
        track_m=float(wheels[0, 1] - wheels[1, 1]),
        hinge_track_m=float(wheels[0, 1] - wheels[1, 1]) if as_it_is else float(hinges[0, 1] - hinges[1, 1]),
        hinge_offset_m=0.0 if as_it_is else float(wheels[2, 1] - hinges[0, 1]),
        wheel_radius_m=float(radii[0]),
        front_radius_m=float(radii[0]) if as_it_is else float(radii[2]),
        rear_axle_x_m=float(wheels[0, 0]),
        footprint_base=body.outline,
        lidar_xyz_base=mount[:3, 3].copy(),
        lidar_rpy=np.array(trimesh.transformations.euler_from_matrix(mount, "sxyz")),
        body_top_m=float(body.points[:, 2].max()),
        body_bottom_m=float((body.points if plain is None else plain.body)[:, 2].min()),
        knuckle_limit_rad=motors.knuckle_rad,
        rolling_mass_kg=rolling,
        yaw_inertia_kgm2=yaw,
        weight_n=weight,
        wheel_effort_nm=effort,
        wheel_speed_radps=motors.wheel_speed_radps,
        hinge_speed_radps=hinge_speed,
        joints={role: setup.roles[role] if as_it_is else role for role in ROLES},
        plain_urdf=None if plain is None else plain.urdf,
        plain_body=None if plain is None else plain.body,
        drawn_urdf=parts.document.text(),
        drawn_signs={
            role: (parts.joints[role].get("name"), chassis.signs[role]) for role in (*STEERING_JOINTS, *WHEEL_JOINTS)
        },
        base_from_root=np.eye(4) if as_it_is else chassis.base_from_root,
        notes=tuple(seen.notes),
    )
