"""The same commands driven in PyBullet and by planar cars, and what both see from the poses of the one in PyBullet."""

import zlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.agents import Agent, load_agent
from zebrat_bullet.agents.agent import RandomAgent, SmoothRandomAgent
from zebrat_bullet.arrays import on_host
from zebrat_bullet.config import DynamicsConfig, EpisodeConfig, TaskConfig
from zebrat_bullet.planar.simulation import PlanarSimulation
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.dynamics import draw_dynamics
from zebrat_bullet.task.episode import draw_pose
from zebrat_bullet.types import RobotState
from zebrat_bullet.world import World, load_world

DRIVERS = ("random", "smooth", "policy")
DRIVE_S = 5.0


@dataclass(frozen=True, kw_only=True)
class DriveJob:
    """Some drives of one driver in one world, each from rest at a pose along the centre line.

    Attributes:
        world: name or file.
        driver: one of `DRIVERS`.
        agent: who drives as "policy", unguided.
        n: drives.
        seed: with world and driver it fixes their poses and commands.
        task: the task driven.
    """

    world: str
    driver: str
    agent: str
    n: int
    seed: int
    task: TaskConfig


@dataclass(frozen=True, kw_only=True)
class Drives:
    """D drives in PyBullet, of S control steps each.

    Attributes:
        pose: (D, S + 1, 3) float64, x, y in m and yaw in rad of the base frame, world frame.
        command: (D, S, 2) float64, m/s and rad.
        touched: (D, S + 1) bool, from the first contact on.
        level_m: (D, S + 1, R) float32, V_obs in m of a car that stands level at these poses.
        rolling_m: (D, S + 1, R) float32, V_obs in m as the car had it, with the tilt of its body.
    """

    pose: NDArray[np.float64]
    command: NDArray[np.float64]
    touched: NDArray[np.bool_]
    level_m: NDArray[np.float32]
    rolling_m: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What planar cars made of the same drives.

    Attributes:
        apart_m: (D, S + 1) float64, distance between the two base frames; nan from the first contact of either on.
        sight_m: (D, S + 1, R) float64, V_obs of a planar car less that of a level one in PyBullet, at the same poses;
            nan from the contact in PyBullet on.
        rolling_m: (D, S + 1, R) float64, the same against what the car in PyBullet saw while it drove.
    """

    apart_m: NDArray[np.float64]
    sight_m: NDArray[np.float64]
    rolling_m: NDArray[np.float64]


def drive_in_bullet(job: DriveJob) -> Drives:
    """Drive a job."""
    world = load_world(job.world, robot=load_robot(job.task.robot))
    drive, agent = Drive(job.task, world), _agent(job)
    n_steps = round(DRIVE_S / job.task.physics.control_step_s)
    key = zlib.crc32(f"{job.world}/{job.driver}".encode())
    drives = [_drive(drive, agent, np.random.default_rng([job.seed, key, k]), n_steps) for k in range(job.n)]
    drive.close()
    pose, command, touched, level, rolling = (np.array(values) for values in zip(*drives, strict=True))
    return Drives(
        pose=pose,
        command=command,
        touched=np.logical_or.accumulate(touched, axis=1),
        level_m=level,
        rolling_m=rolling,
    )


def _agent(job: DriveJob) -> Agent:
    limits = job.task.physics.max_speed_mps, job.task.physics.max_steering_rad
    if job.driver == "policy":
        return load_agent(job.agent, job.task)
    return RandomAgent(*limits) if job.driver == "random" else SmoothRandomAgent(*limits)


def _drive(drive: Drive, agent: Agent, rng: np.random.Generator, n_steps: int) -> tuple[list, ...]:
    """Return what one drive adds to the fields of `Drives`, in their order."""
    agent.reset(int(rng.integers(2**31)))
    reading = drive.reset(rng, pose=draw_pose(drive.world, drive.robot, EpisodeConfig(start="anywhere"), rng))
    commands, states, level, rolling = [], [drive.state], [_look(drive, rng)], [reading.clearance.obs_m]
    for _ in range(n_steps):
        reading = drive.step(agent.act(reading)).reading
        commands.append((reading.last_command.speed_mps, reading.last_command.steering_rad))
        states.append(drive.state)
        level.append(_look(drive, rng))
        rolling.append(reading.clearance.obs_m)
    return [_pose(state) for state in states], commands, [state.contact for state in states], level, rolling


def _look(drive: Drive, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return V_obs from where the car is, as if it stood level there."""
    level = replace(drive.state, roll=0.0, pitch=0.0, height_m=0.0)
    return drive.region.measure(drive.lidar.scan(level, rng)).obs_m


def _pose(state: RobotState) -> tuple[float, float, float]:
    return state.pose.x, state.pose.y, state.pose.yaw


def compare(drives: Drives, world: World, task: TaskConfig) -> Comparison:
    """Drive the commands with a planar car for each drive, and look from the poses of PyBullet's car."""
    pose, touched = _follow(drives, world, task)
    apart = np.hypot(*np.moveaxis(pose - drives.pose, -1, 0)[:2])
    sight = _sight(drives.pose.reshape(-1, 3), world, task).reshape(drives.level_m.shape)
    hidden = drives.touched[..., None]
    return Comparison(
        apart_m=np.where(touched | drives.touched, np.nan, apart),
        sight_m=np.where(hidden, np.nan, sight - drives.level_m),
        rolling_m=np.where(hidden, np.nan, sight - drives.rolling_m),
    )


def _follow(drives: Drives, world: World, task: TaskConfig) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the (D, S + 1, 3) poses of planar cars, and whether each has touched a wall until then."""
    sim = planar_cars(drives.pose[:, 0], world, task)
    poses, touched = [on_host(sim.pose).copy()], [np.zeros(len(drives.pose), bool)]
    for command in np.moveaxis(drives.command, 1, 0):
        sim.command[:] = command
        sim.step()
        poses.append(on_host(sim.pose).copy())
        touched.append(on_host(sim.contact).copy())
    placed = np.stack(poses, axis=1).astype(np.float64)
    placed[..., :2] += sim.origin[0]
    return placed, np.logical_or.accumulate(np.stack(touched, axis=1), axis=1)


def _sight(poses: NDArray[np.float64], world: World, task: TaskConfig) -> NDArray[np.float64]:
    """Return the (P, R) V_obs in m of planar cars at (P, 3) poses."""
    sim = planar_cars(poses, world, task)
    sim.look()
    region = make_region(load_robot(task.robot), task.region, task.lidar.n_bearings)
    return on_host(sim.ranges)[:, np.unique(region.indices, return_inverse=True)[1]].astype(np.float64)


def planar_cars(poses: NDArray[np.float64], world: World, task: TaskConfig) -> PlanarSimulation:
    """Return planar cars at rest at (N, 3) poses, world frame, that look along the bearings of the safety region."""
    robot, n = load_robot(task.robot), len(poses)
    region = make_region(robot, task.region, task.lidar.n_bearings)
    sim = PlanarSimulation(robot, task, np.unique(region.indices), [world], n)
    local = poses - np.append(sim.origin[0], 0.0)
    dynamics = draw_dynamics(DynamicsConfig(), np.random.default_rng(0), n)
    sim.place(np.arange(n), np.zeros(n, np.int32), local.astype(np.float32), dynamics.astype(np.float32))
    return sim
