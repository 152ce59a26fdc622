"""One episode at a time: where the car, its senses, the reward and the rules meet. Readings out, commands in."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.robot import fitted, load_robot
from zebrat_bullet.sensing.beams import side_bearings
from zebrat_bullet.sensing.lidar import Lidar, Sweep
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.sim.ackermann import clip_command
from zebrat_bullet.sim.engine import make_simulation
from zebrat_bullet.task.disturbances import Disturbances
from zebrat_bullet.task.episode import EpisodeRules, Outcome, draw_pose, gates_of, open_lines
from zebrat_bullet.task.rewards import RewardInput, check_weights, rewards, weighted_terms
from zebrat_bullet.task.waypoints import WaypointGuide, check_waypoints
from zebrat_bullet.types import Command, Commands, Pose2, Reading, RobotState
from zebrat_bullet.world import World


@dataclass(frozen=True, slots=True)
class DriveStep:
    """What came of one control step.

    Attributes:
        reading: what the car senses now.
        reward: R of the paper; on the terminal step R_c or R_r alone.
        terms: each weighted reward term by name, also on the terminal step, where they are not paid.
        outcome: how the episode ended, None while it goes on.
    """

    reading: Reading
    reward: float
    terms: dict[str, float]
    outcome: Outcome | None


class Drive:
    """The car in a world under a task: whatever drives it (a policy, a planner, a person) gets the same readings.

    Args:
        config: the task.
        world: where the first episode takes place; `reset` may name another.

    Attributes:
        config: the task, with the limits of the car where they are lower, and the car named for any folder.
        sweep: the revolution of the lidar that the last reading was made from.
        state: the true state now.
        believed: the same as the car's localisation knows it.

    Raises:
        ConfigError: the reward names an unknown term, or looks at waypoints and the world has none; or the engine is
            not installed, or the ray caster is another engine's.
        RobotError: the URDF is none of a car, or its lidar sees no walls.
    """

    def __init__(self, config: TaskConfig, world: World) -> None:
        check_weights(config.reward)
        if config.guided:
            check_waypoints(world)
        config = fitted(config)
        self.config = config
        self.world = world
        self.robot = load_robot(config.robot)
        self.sim = make_simulation(self.robot, config.physics)
        n = config.lidar.n_bearings
        self.region = make_region(self.robot, config.region, n)
        self._sides = list(side_bearings(n))
        watched = np.union1d(self.region.indices, self._sides) if config.lidar.bearings == "region" else None
        self.lidar = Lidar(self.robot, config.lidar, config.noise, config.flatten, self.sim.client, watched)
        self._rules = EpisodeRules(config.episode, self.robot, np.zeros((1, 3)))
        self.state: RobotState
        self.sweep: Sweep
        self.believed: RobotState

    def reset(
        self,
        rng: np.random.Generator,
        world: World | None = None,
        pose: Pose2 | None = None,
        *,
        guided: bool = False,
        whole_scans: bool = False,
    ) -> Reading:
        """Begin an episode and return the first reading.

        Args:
            rng: draws start pose, noise, dynamics and disturbances; the same generator state gives the same episode.
            world: a new world, or None for the last one.
            pose: an exact start pose, or None to draw one as the task says.
            guided: readings name the next waypoint, also where neither reward nor observation of the task need it.
            whole_scans: readings hold whole scans, for whoever records or draws them, also where `LidarConfig.bearings`
                confines the lidar to the bearings that the task itself looks at.

        Raises:
            ConfigError: the episode is guided and the world has no waypoints.
        """
        self.world = world or self.world
        self.sim.set_world(self.world)
        self.lidar.set_world(self.world)
        self._noise_rng, dynamics_rng, disturbance_rng = rng.spawn(3)
        disturbances = self._disturbances = Disturbances(self.config, dynamics_rng, disturbance_rng)
        self.lidar.disturb(disturbances.noise, disturbances.dark_walls)
        pose = pose or draw_pose(self.world, self.robot, self.config.episode, rng)
        self.state = self.sim.reset(pose, disturbances.dynamics)
        max_steps = np.array([self.world.max_steps or self.config.episode.max_steps])
        self._rules.begin(np.array([0]), self._poses(), open_lines([self.world]), max_steps, gates_of([self.world]))
        self._guide = WaypointGuide(self.world, self.state.pose) if guided or self.config.guided else None
        self._n_steps = 0
        self._whole_scans = whole_scans
        return self._read(Command(0.0, 0.0))

    def step(self, command: Command) -> DriveStep:
        """Drive one control step: command, physics, senses, end of episode, reward.

        What disturbs the command on its way to the motors, neither reading nor reward learn of.

        Raises:
            ActionError: the command is not finite; nothing was simulated.
        """
        command = clip_command(command, self.config.physics)
        self.state = self.sim.step(self._disturbances.at_motors(command))
        self._n_steps += 1
        nearer_m = self._guide.step(self.state.pose) if self._guide else 0.0
        reading = self._read(command)
        code, terms, reward = self._judge(command, reading, nearer_m)
        return DriveStep(reading, reward, terms, Outcome.of(code))

    def close(self) -> None:
        """Release the physics server; a second call does nothing."""
        self.sim.close()

    def _read(self, command: Command) -> Reading:
        self.believed = self._disturbances.localised(self.state)
        self.sweep = self.lidar.sweep(self.state, self._noise_rng, watched_only=not self._whole_scans)
        scan = self.lidar.flat(self.sweep)
        clearance = self.region.measure(scan)
        time_s = self._n_steps * self.config.physics.control_step_s
        waypoint = self._guide.waypoint(self.state.pose) if self._guide else None
        return Reading(scan, clearance, command, self.state.speed_mps, time_s, waypoint=waypoint)

    def _judge(self, command: Command, reading: Reading, nearer_m: float) -> tuple[int, dict[str, float], float]:
        """Return code of the outcome, terms and reward: the rules of many cars, for one."""
        clearance = self.region.clearances(reading.clearance.obs_m[None])
        open_width = reading.scan.ranges_m[self._sides].sum(keepdims=True)
        outcome = self._rules.judge(self._poses(), np.array([self.state.contact]), clearance.collision, open_width)
        commands = Commands(np.array([command.speed_mps]), np.array([command.steering_rad]))
        speed, nearer = np.array([self.state.speed_mps]), np.array([nearer_m])
        step = RewardInput(clearance, self.region, speed, commands, self.config.reward, nearer)
        terms = weighted_terms(step)
        reward = rewards(terms, outcome, self.config.reward)
        return int(outcome[0]), {name: float(term[0]) for name, term in terms.items()}, float(reward[0])

    def _poses(self) -> NDArray[np.float64]:
        pose = self.state.pose
        return np.array([[pose.x, pose.y, pose.yaw]])
