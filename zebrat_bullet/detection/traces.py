"""Drives into walls, every physics step of them kept: the ground truth that representations are scored against."""

import zlib
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.agents import Agent, load_agent
from zebrat_bullet.agents.agent import NoisyAgent, RandomAgent, SmoothRandomAgent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.detection.places import free_pose, load_place
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.npz import load_npz, save_npz
from zebrat_bullet.files import refusing
from zebrat_bullet.geometry import footprint_hits, to_world
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import Command, Pose2, Reading, RobotState
from zebrat_bullet.world import World

SCHEMA = "zebrat-trace-1"
DRIVERS = ("random", "random-smooth", "policy")
WALLS = ("solid", "ghost")
POLICY_NOISE = 0.5
"""Sigma of the noise on the policy's commands, as a fraction of the limits: enough to make it err."""
AFTER_S = 1.0
"""A drive goes on for so long after it has met a wall."""
LIMIT_S = 20.0


@dataclass(frozen=True, kw_only=True)
class DriveJob:
    """Some drives of one driver in one world.

    Attributes:
        world: as in `places.load_place`.
        driver: one of `DRIVERS`.
        walls: "solid" (physics) or "ghost" (the car drives through them, as if nothing stopped it).
        seed, chunk: what chance they start from; with the fields above they fix every number of the trace.
        n_drives: how many.
        task: robot, physics and the driver's own senses.
        policy: the agent behind the driver "policy".
    """

    world: str
    driver: str
    walls: str
    seed: int
    chunk: int
    n_drives: int
    task: TaskConfig
    policy: str = "shipped"

    def __post_init__(self) -> None:
        if self.driver not in DRIVERS:
            raise ConfigError(f"no driver {self.driver!r}; there are {', '.join(DRIVERS)}")
        if self.walls not in WALLS:
            raise ConfigError(f"walls are {' or '.join(WALLS)}, got {self.walls!r}")

    @property
    def file_name(self) -> str:
        """Where the trace is kept in a study's folder."""
        return f"{self.walls}-{Path(self.world).stem}-{self.driver}-{self.chunk:03d}.npz"


@dataclass(frozen=True, kw_only=True)
class Trace:
    """D drives, N rows in all: the start of each drive and the state after every physics step.

    Attributes:
        world, driver, walls, chunk: as in `DriveJob`.
        rate_hz: physics steps a second.
        first_row: (D + 1,) int, row at which each drive begins; the last is N.
        pose: (N, 3) x m, y m, yaw rad of the base frame in the world.
        tilt: (N, 3) height m of the base frame, roll rad, pitch rad.
        speed_mps: (N,) measured forward speed.
        contact: (N,) bool, the body touched a wall in that physics step; never, where walls are ghosts.
        distance_m: (N,) exact distance from the footprint polygon to the walls; 0 where they overlap.
    """

    world: str
    driver: str
    walls: str
    chunk: int
    rate_hz: float
    first_row: NDArray[np.int64]
    pose: NDArray[np.float64]
    tilt: NDArray[np.float64]
    speed_mps: NDArray[np.float64]
    contact: NDArray[np.bool_]
    distance_m: NDArray[np.float64]

    @property
    def hits(self) -> NDArray[np.bool_]:
        """(N,) whether the car is in collision: physics contact, or with ghost walls the overlap of the polygons."""
        return self.contact if self.walls == "solid" else self.distance_m <= 0.0

    def state_at(self, row: int) -> RobotState:
        """Return the state of the body at a row; wheels and steering, which no lidar sees, are left at zero."""
        (x, y, yaw), (height, roll, pitch) = self.pose[row], self.tilt[row]
        return RobotState(
            pose=Pose2(x, y, yaw),
            height_m=height,
            roll=roll,
            pitch=pitch,
            speed_mps=float(self.speed_mps[row]),
            yaw_rate_radps=0.0,
            steering_rad=0.0,
            knuckle_rad=np.zeros(2),
            wheel_rad=np.zeros(4),
            contact=bool(self.contact[row]),
            unseen_contact=False,
        )


def record_drives(job: DriveJob) -> Trace:
    """Drive and keep every physics step; each drive ends `AFTER_S` after it met a wall, or after `LIMIT_S`.

    Raises:
        ZebratError: the world, the robot or the policy cannot be loaded.
    """
    world, robot = load_place(job.world, job.task.robot), load_robot(job.task.robot)
    simulation = Simulation(robot, job.task.physics)
    if job.walls == "solid":
        simulation.set_world(world)
    driver = _Driver(job, world, robot)
    key = zlib.crc32(f"{job.world}/{job.driver}".encode())
    states: list[RobotState] = []
    first_row = [0]
    for n in range(job.n_drives):
        rng = np.random.default_rng([job.seed, key, job.chunk, n])
        states += _drive(simulation, driver, free_pose(world, robot, rng), rng, job)
        first_row.append(len(states))
    simulation.close()
    pose = np.array([(s.pose.x, s.pose.y, s.pose.yaw) for s in states])
    return Trace(
        world=job.world,
        driver=job.driver,
        walls=job.walls,
        chunk=job.chunk,
        rate_hz=job.task.physics.rate_hz,
        first_row=np.array(first_row),
        pose=pose,
        tilt=np.array([(s.height_m, s.roll, s.pitch) for s in states]),
        speed_mps=np.array([s.speed_mps for s in states]),
        contact=np.array([s.contact for s in states]),
        distance_m=footprint_distances(pose, robot, world),
    )


class _Driver:
    """An agent with the senses it needs, looking into a world that its simulation may not hold."""

    def __init__(self, job: DriveJob, world: World, robot: RobotModel) -> None:
        task = job.task
        self.world, self.robot = world, robot
        self.agent = _agent(job)
        # Embree: with ghost walls there is nothing in the simulation for the other caster to hit.
        self._lidar = Lidar(robot, replace(task.lidar, caster="embree"), task.noise, task.flatten)
        self._lidar.set_world(world)
        self._region = make_region(robot, task.region, task.lidar.n_bearings)

    def read(self, state: RobotState, last: Command, time_s: float, rng: np.random.Generator) -> Reading:
        scan = self._lidar.scan(state, rng)
        return Reading(scan, self._region.measure(scan), last, state.speed_mps, time_s)


def _agent(job: DriveJob) -> Agent:
    limits = job.task.physics.max_speed_mps, job.task.physics.max_steering_rad
    if job.driver == "policy":
        return NoisyAgent(load_unguided(job.policy, job.task), POLICY_NOISE, *limits)
    return RandomAgent(*limits) if job.driver == "random" else SmoothRandomAgent(*limits)


def load_unguided(policy: str, task: TaskConfig) -> Agent:
    """Return the agent behind the driver "policy".

    Raises:
        ConfigError: it needs to be guided, and no guide rides along here.
        ZebratError: it cannot be loaded.
    """
    agent = load_agent(policy, task)
    if agent.privileged:
        needs = ", ".join(sorted(agent.privileged))
        raise ConfigError(f"the driver 'policy' has its scan alone, {policy} needs {needs}; name an unguided agent")
    return agent


def _drive(
    simulation: Simulation, driver: _Driver, pose: Pose2, rng: np.random.Generator, job: DriveJob
) -> list[RobotState]:
    physics = job.task.physics
    n_after, n_limit = (round(time_s / physics.control_step_s) for time_s in (AFTER_S, LIMIT_S))
    driver.agent.reset(int(rng.integers(2**31)))
    states, last, end = [simulation.reset(pose)], Command(0.0, 0.0), n_limit
    step = 0
    while step < end:
        last = driver.agent.act(driver.read(states[-1], last, step * physics.control_step_s, rng))
        for touches in simulation.substeps(last):
            states.append(simulation.read(touches))
        step += 1
        if end == n_limit and _met_wall(states[-physics.n_substeps :], driver, job.walls):
            end = step + n_after
    return states


def _met_wall(states: list[RobotState], driver: _Driver, walls: str) -> bool:
    if walls == "solid":
        return any(state.contact for state in states)
    return any(footprint_hits(driver.world.walls, driver.robot.footprint_base, state.pose) for state in states)


def footprint_distances(pose: NDArray[np.float64], robot: RobotModel, world: World) -> NDArray[np.float64]:
    """Return the (N,) exact distances in m from the footprint polygon at (N, 3) poses to the walls; 0 in overlap."""
    shapely.prepare(world.walls)
    outlines = np.array([to_world(robot.footprint_base, Pose2(*row)) for row in pose])
    distances: NDArray[np.float64] = shapely.distance(shapely.polygons(outlines), world.walls)
    return distances


def save_trace(trace: Trace, path: Path) -> None:
    """Write a trace as .npz without pickles, whole or not at all."""
    save_npz(path, SCHEMA, {field.name: getattr(trace, field.name) for field in fields(trace)})


def load_trace(path: Path) -> Trace:
    """Read a trace.

    Raises:
        ZebratError: the file is missing, damaged or of another schema.
    """
    with refusing(path, ZebratError, "is not a trace", "delete it, and `zebrat collisions` drives it anew"):
        return Trace(**load_npz(path, SCHEMA))
