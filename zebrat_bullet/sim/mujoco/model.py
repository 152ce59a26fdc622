"""What MuJoCo simulates: floor, walls that are felt, walls that are seen, and the car of a URDF."""

from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from yourdfpy.urdf import Link

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import RobotError, WorldError
from zebrat_bullet.robot import GRAVITY_MPS2, STEERING_JOINTS, WHEEL_JOINTS, RobotModel
from zebrat_bullet.robot.document import parse_urdf
from zebrat_bullet.robot.plain import BODY_FILE
from zebrat_bullet.robot.shapes import shape_points
from zebrat_bullet.sim.mujoco.walls import convex_prisms
from zebrat_bullet.world.world import World

TIMESTEP_S = 0.002
"""Longest step of MuJoCo; a physics step of the task is cut into as many equal ones as it takes.

At 2 ms five seconds of driving end 9 mm from where steps of 0.25 ms end, PyBullet's 15 mm.
"""
SEEN_GROUP, FELT_GROUP = 1, 2
"""Geom groups: rays look at the first alone."""
FIRST_HINGE, FIRST_WHEEL = 0, 2
"""Indices of the actuators: two hinges and four wheels, as in STEERING_JOINTS and WHEEL_JOINTS."""

# Two geoms meet where the one's type has a bit of the other's affinity. Wheels meet the floor alone, the body floor and
# walls; wheels and body never meet, or the front wheels would jam in it.
_FLOOR, _WALL = 1, 2
_SURFACE = {"friction": [1.0, 0.0, 0.0], "solref": [0.004, 1.0], "condim": 3}


@dataclass
class Scene:
    """A model with its state, and where the felt walls are among its geoms.

    Attributes:
        model, data: MuJoCo's.
        walls: geom ids of the felt walls.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    walls: range


class SceneHolder:
    """What a ray caster looks at: the scene as it is now, which a new world replaces.

    Attributes:
        scene: None once the simulation is closed.
    """

    def __init__(self) -> None:
        self.scene: Scene | None = None


def n_steps(physics: PhysicsConfig) -> int:
    """Return how many steps of MuJoCo make one physics step of the task."""
    return max(1, int(np.ceil(1.0 / physics.rate_hz / TIMESTEP_S - 1e-9)))


def _say_nothing(message: str) -> None:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT where one stands: `MujocoCar.read` raises for what it warns of."""


def build_scene(robot: RobotModel, physics: PhysicsConfig, world: World | None) -> Scene:
    """Compile floor, car, and the walls of a world, if any.

    Raises:
        RobotError, WorldError: MuJoCo takes the car, or the walls, not.
    """
    mujoco.set_mju_user_warning(_say_nothing)
    spec = _empty_spec(physics)
    add_car(spec, robot)
    try:
        spec.compile()
    except ValueError as error:
        raise RobotError(f"{robot.urdf_path}: MuJoCo cannot build it ({error}); see `zebrat robots FILE`") from error
    walls = range(1, 1)
    if world is not None and len(world.mesh.faces):
        walls = _add_walls(spec, world)
    try:
        model = spec.compile()
    except ValueError as error:
        name = world.name if world is not None else ""
        raise WorldError(f"{name}: MuJoCo cannot build its walls ({error}); drive it with --sim bullet") from error
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)  # rays hit nothing before everything has its place
    return Scene(model, data, walls)


def _empty_spec(physics: PhysicsConfig) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.discardvisual = False  # the walls that are seen collide with nothing
    spec.compiler.balanceinertia = True
    spec.option.timestep = 1.0 / physics.rate_hz / n_steps(physics)
    spec.option.gravity = [0.0, 0.0, -GRAVITY_MPS2]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], group=SEEN_GROUP, contype=_FLOOR, conaffinity=0, **_SURFACE
    )
    return spec


def _add_walls(spec: mujoco.MjSpec, world: World) -> range:
    """Add the walls twice, as convex prisms that are felt and as the world's own triangles, which are seen."""
    first = len(spec.worldbody.geoms)
    n = 0
    for n, (corners, bottom_m, top_m) in enumerate(convex_prisms(world), start=1):
        x, y = corners.mean(axis=0)
        points = np.array([(*(corner - (x, y)), z) for z in (bottom_m, top_m) for corner in corners])
        _add_hull(spec, spec.worldbody, f"wall_{n}", points, [x, y, 0.0], group=FELT_GROUP, contype=_WALL)
    mesh = spec.add_mesh(name="seen", inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    mesh.uservert, mesh.userface = world.mesh.vertices.ravel(), world.mesh.faces.ravel()
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="seen", group=SEEN_GROUP, contype=0, conaffinity=0
    )
    return range(first, first + n)


def _add_hull(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    points: NDArray[np.float64],
    at: list[float] | None = None,
    *,
    group: int = 0,
    contype: int = 0,
    conaffinity: int = 0,
) -> None:
    """Add the hull of (P, 3) points to a body, without mass: its own is said elsewhere."""
    mesh = spec.add_mesh(name=name)
    mesh.uservert = points.ravel()
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        pos=at or [0.0, 0.0, 0.0],
        mass=0.0,
        group=group,
        contype=contype,
        conaffinity=conaffinity,
        **_SURFACE,
    )


def add_car(spec: mujoco.MjSpec, robot: RobotModel) -> None:
    """Add the links, joints and motors of the URDF that physics loads; its root floats, its body is links[0]."""
    urdf = parse_urdf(robot.plain_urdf or robot.drawn_urdf, load_meshes=False)
    wheels = {urdf.joint_map[robot.joints[role]].child for role in WHEEL_JOINTS}
    bodies = {urdf.base_link: spec.worldbody.add_body(name=urdf.base_link)}
    bodies[urdf.base_link].add_freejoint()
    joints = list(urdf.joint_map.values())
    while joints:  # parents first, in whatever order they are written
        ready = [joint for joint in joints if joint.parent in bodies]
        for joint in ready:
            body = bodies[joint.parent].add_body(name=joint.child)
            if joint.origin is not None:
                body.pos, body.quat = joint.origin[:3, 3], trimesh.transformations.quaternion_from_matrix(joint.origin)
            if joint.type != "fixed":
                body.add_joint(name=joint.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis)
            bodies[joint.child] = body
            joints.remove(joint)
    for name, body in bodies.items():
        _add_link(spec, body, urdf.link_map[name], name in wheels, robot)
    _add_motors(spec, robot, {name: float(joint.limit.effort) for name, joint in urdf.joint_map.items() if joint.limit})


def _add_link(spec: mujoco.MjSpec, body: mujoco.MjsBody, link: Link, is_wheel: bool, robot: RobotModel) -> None:
    inertial = link.inertial
    if inertial is not None and inertial.mass:
        pose = np.eye(4) if inertial.origin is None else inertial.origin
        i = pose[:3, :3] @ inertial.inertia @ pose[:3, :3].T
        body.mass, body.ipos, body.explicitinertial = inertial.mass, pose[:3, 3], True
        body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
    affinity = _FLOOR if is_wheel else _FLOOR | _WALL
    for k, shape in enumerate(link.collisions):
        cylinder = shape.geometry.cylinder
        if is_wheel and cylinder is not None:  # a hull would roll on its edges
            pose = np.eye(4) if shape.origin is None else shape.origin
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                size=[cylinder.radius, cylinder.length / 2.0, 0.0],
                pos=pose[:3, 3],
                quat=trimesh.transformations.quaternion_from_matrix(pose),
                mass=0.0,
                contype=0,
                conaffinity=affinity,
                priority=1,  # the wheel's friction counts, not the larger of wheel and floor
                **_SURFACE,
            )
            continue
        name = shape.geometry.mesh.filename if shape.geometry.mesh is not None else ""
        points = robot.plain_body if name == BODY_FILE else shape_points(shape)
        assert points is not None
        _add_hull(spec, body, f"{link.name}/{k}", points, conaffinity=affinity)


def _add_motors(spec: mujoco.MjSpec, robot: RobotModel, efforts: dict[str, float]) -> None:
    """Add servos whose aims move at a speed to the hinges, motors that keep a speed to the wheels.

    How stiff they are says `MujocoCar`, once inertias are known.
    """
    for role in (*STEERING_JOINTS, *WHEEL_JOINTS):
        name = robot.joints[role]
        motor = spec.add_actuator(name=role, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.forcelimited, motor.forcerange = True, [-efforts[name], efforts[name]]
        if role in WHEEL_JOINTS:
            motor.set_to_velocity(kv=1.0)
        else:
            motor.set_to_intvelocity(kp=1.0, kv=1.0)
            motor.actlimited, motor.actrange = True, [-np.pi, np.pi]
