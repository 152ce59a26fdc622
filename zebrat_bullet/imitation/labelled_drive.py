"""The oracle says what it would do at every step of planar cars, whoever drives them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.agents.oracle import OracleAgent
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.arrays import on_host
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.imitation.demonstration import Demonstration
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.sim.ackermann import virtual_steering
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.types import Clearance, Command, Commands, FlatScan, Pose2, Reading, RobotState
from zebrat_bullet.world import World

_WHEELS = np.zeros(4)  # planar cars have none that roll


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Who or what keeps a car off the oracle's path.

    Attributes:
        noise: on the commands, sigma as a fraction of the limits, of which each episode draws its own from 0 to this.
        learner: drives a step with probability 1 - beta; None: nobody but the oracle.
        beta: the oracle drives a step with this probability.
    """

    noise: float = 0.0
    learner: PolicyAgent | None = None
    beta: float = 1.0


def drive_labelled(
    worlds: Sequence[World],
    oracles: Sequence[OracleAgent],
    task: TaskConfig,
    start: int,
    disturbance: Disturbance,
    rng: np.random.Generator,
) -> tuple[list[Demonstration], list[Outcome]]:
    """Drive one episode in each of N worlds to its end.

    Args:
        worlds: N worlds.
        oracles: who labels in each; a step where it knows no way is left out.
        task: the task driven.
        start: which of the starts of each world.
        disturbance: who drives.
        rng: of the disturbance.

    Returns:
        N episodes with the oracle's labels, and how each ended.
    """
    n, limits = len(worlds), np.array([task.physics.max_speed_mps, task.physics.max_steering_rad])
    drive = PlanarDrive(task, worlds, n, raw=True)  # in SI units: ranges, then the last command
    observation = on_host(drive.begin_unchecked(np.arange(n, dtype=np.int32), drive.starts[:, start]))
    for oracle in oracles:
        oracle.reset(0)
    sigma = rng.uniform(0.0, disturbance.noise, (n, 1)) * limits
    seen: list[list[NDArray[np.float32]]] = [[] for _ in worlds]
    outcomes: list[Outcome | None] = [None] * n
    n_steps = 0
    while None in outcomes:
        labels = np.zeros((n, 2))
        poses, motions = on_host(drive.sim.pose), on_host(drive.sim.motion)
        time_s = n_steps * task.physics.control_step_s
        for car in [i for i, outcome in enumerate(outcomes) if outcome is None]:
            command = oracles[car].act(_reading(drive, car, poses[car], motions[car], observation[car], time_s))
            labels[car] = command.speed_mps, command.steering_rad
            if not oracles[car].lost:
                seen[car].append(np.concatenate([observation[car], labels[car]], dtype=np.float32))
        wanted = _driven(labels, observation, disturbance, rng) + sigma * rng.standard_normal((n, 2))
        driven = np.clip(wanted, -limits, limits).astype(np.float32)
        result = drive.follow(Commands(driven[:, 0], driven[:, 1]))
        ended = on_host(result.outcome)
        for car in result.ended.tolist():  # then it goes on with another episode, which nobody looks at
            outcomes[car] = outcomes[car] or Outcome.of(int(ended[car]))
        observation = on_host(result.observation)
        n_steps += 1
    episodes = [_demonstration(drive, world, rows) for world, rows in zip(worlds, seen, strict=True)]
    return episodes, [outcome for outcome in outcomes if outcome is not None]


def _driven(
    labels: NDArray[np.float64], observation: NDArray[np.float32], by: Disturbance, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return (N, 2) commands of whoever drives each car in this step."""
    if by.learner is None:
        return labels
    its = by.learner.observation
    commands = its.decode_cars(by.learner.action(its.encode_cars(observation[:, :-2], observation[:, -2:])))
    own = np.stack([commands.speed_mps, commands.steering_rad], axis=1)
    return np.where(rng.random((len(labels), 1)) < by.beta, labels, own)


def _reading(
    drive: PlanarDrive,
    car: int,
    pose: NDArray[np.floating],
    motion: NDArray[np.floating],
    observation: NDArray[np.float32],
    time_s: float,
) -> Reading:
    """Return what the oracle is given: no scan, but its own pose, the map and the goal."""
    world = drive.worlds[car]
    x, y, yaw = pose.tolist()
    left, right, speed, yaw_rate = motion.tolist()
    origin_x, origin_y = drive.sim.origin[car].tolist()
    state = RobotState(
        pose=Pose2(x + origin_x, y + origin_y, yaw),
        height_m=0.0,
        roll=0.0,
        pitch=0.0,
        speed_mps=speed,
        yaw_rate_radps=yaw_rate,
        steering_rad=virtual_steering(left, right, drive.robot),
        knuckle_rad=np.array([left, right]),
        wheel_rad=_WHEELS,
        contact=False,
        unseen_contact=False,
    )
    obs, last = observation[:-2], Command(*observation[-2:].tolist())
    scan = FlatScan(obs[:0], drive.task.lidar.range_max_m)
    goal = world.waypoints[-1]
    return Reading(scan, Clearance(obs, drive.region.range_m, False), last, speed, time_s, state, world.walls, goal)


def _demonstration(drive: PlanarDrive, world: World, rows: list[NDArray[np.float32]]) -> Demonstration:
    table = np.array(rows, dtype=np.float32).reshape(-1, drive.spec.size + 2)
    obs_m, last_command, labels = np.split(table, [-4, -2], axis=1)
    return Demonstration(world.name, world.family, drive.task, drive.region.range_m, obs_m, last_command, labels)
