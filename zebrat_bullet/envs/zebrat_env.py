"""The gymnasium environment: wiring only. The task itself is `zebrat_bullet.task.drive.Drive`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zebrat_bullet.config import NoiseConfig, RewardConfig, TaskConfig, with_reward
from zebrat_bullet.config_text import from_plain
from zebrat_bullet.envs.reset_options import check_pose, options_of, seed_of
from zebrat_bullet.errors import ConfigError, EpisodeError
from zebrat_bullet.files import shown
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.task.observation import DISCRETE_COMMANDS, ObservationSpec, Observer, observation_spec
from zebrat_bullet.task.rewards import TERMS, terminal_codes
from zebrat_bullet.task.waypoints import check_waypoints
from zebrat_bullet.types import Pose2, Reading
from zebrat_bullet.world import World, load_worlds

RENDER_SIZE = (640, 480)


class ZebratEnv(gymnasium.Env):
    """A car-like robot that must find its way out of a narrow place by lidar alone.

    Observation: V_obs in 32 bearings and the last command, under waypoint guidance the next waypoint too, float32,
    scaled to [-1, 1] (`raw=True`: m, m/s, rad).
    Action: (speed, steering) in [-1, 1], times 0.6 m/s and 0.6 rad (`raw=True`: SI); out of range is clipped, a
    non-finite action raises ActionError and is never simulated. `discrete=True`: six actions, DISCRETE_COMMANDS.
    Each episode is a pure function of the seed given to `reset` and the number of resets since.

    Args:
        world: a world's name, path or object, or several of them, of which each episode draws one.
        start: where the car begins in a named world, exactly: a Pose2, or x, y in m and yaw in rad.
        goal: x, y in m, what is to be reached in a named world without an open-space line.
        exit: both ends of the open-space line of a named mesh or map.
        robot: the car, a name or a URDF file; None keeps the task's.
        reward: a preset name ("fomt", "fot", "fmt", "ft", "wg", "wg_paper", with the observation that it needs) or a
            RewardConfig, or a mapping of what differs from the task's; None keeps the task's.
        caster: "bullet", "embree", or "mujoco" with that engine; None keeps the task's.
        noise: lidar noise, or a mapping of what differs from the task's; None keeps the task's.
        discrete: six actions instead of a Box.
        raw: observations and actions in SI units instead of [-1, 1].
        task: every other setting; the arguments above override it.
        render_mode: None or "rgb_array" (drawn by VTK through OSMesa).

    Attributes:
        task: the task, with all arguments in it, as `Drive` drives it.
        spec_observation: how readings are encoded.

    Raises:
        ConfigError, WorldError, AssetError: see the message.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5}  # noqa: RUF012 (gymnasium's own contract)

    def __init__(
        self,
        world: str | Path | World | Sequence[str | Path | World] = "big_track",
        *,
        start: Pose2 | Sequence[float] | None = None,
        goal: Pose2 | Sequence[float] | None = None,
        exit: Sequence[Sequence[float]] | None = None,
        robot: str | Path | None = None,
        reward: str | RewardConfig | Mapping[str, Any] | None = None,
        caster: str | None = None,
        noise: NoiseConfig | Mapping[str, Any] | None = None,
        discrete: bool = False,
        raw: bool = False,
        task: TaskConfig | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        for name, flag in (("discrete", discrete), ("raw", raw)):
            if not isinstance(flag, bool | np.bool_):
                raise ConfigError(f"{name} must be True or False, got {shown(repr(flag))}")
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"render_mode must be None or 'rgb_array', got {render_mode!r}")
        config = varied(task, robot, reward, caster, noise)
        self._worlds = load_worlds(world, start=start, goal=goal, exit=exit, robot=load_robot(config.robot))
        if config.guided:
            for each in self._worlds:
                check_waypoints(each)
        self._closed = False
        self.drive = Drive(config, self._worlds[0])
        self._terminal = terminal_codes(config.reward)
        self.task = self.drive.config
        self.spec_observation = observation_spec(self.drive.config, self.drive.region, self.drive.robot, raw)
        self._observer = Observer(self.spec_observation)
        self._discrete, self._raw = discrete, raw
        self.render_mode = render_mode
        self._renderer: Any = None
        self._seed: int | None = None
        self._n_episodes = 0
        # The episode under way: what it was begun with, and the actions since; None before the first.
        self._begun: dict[str, Any] | None = None
        self._over = False
        self._actions: list[Any] = []
        self.observation_space, self.action_space = spaces_of(self.spec_observation, discrete)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin the next episode of the seed.

        Args:
            seed: begin again with this seed; None goes on with the last one.
            options: `episode`, the number of the episode to begin instead of the next; `pose`, an exact start, a Pose2
                or (x, y, yaw) in m and rad.

        Returns:
            The observation, and an info with the keys of `step`'s.

        Raises:
            EpisodeError: the environment is closed.
            ConfigError: the seed is none; an option is unknown, or none that could be meant; or the car would stand in
                a wall there.
        """
        self._refuse_closed("reset")
        number, pose = options_of(options)
        given = seed = seed_of(seed)
        again = seed is not None or self._seed is None
        seed = self._seed if seed is None else seed
        seed = int(self.np_random.integers(2**31)) if seed is None else seed
        number = (0 if again else self._n_episodes) if number is None else number
        rng = np.random.default_rng([seed, number])
        world = self._worlds[rng.integers(len(self._worlds))] if len(self._worlds) > 1 else self._worlds[0]
        if pose is not None:
            check_pose(pose, world, self.drive.robot.footprint_base)
        reading = self.drive.reset(rng, world, pose, whole_scans=self.render_mode is not None)
        # Only now: one that was refused leaves the episode under way as it was.
        super().reset(seed=given)
        self._seed, self._n_episodes, self._over = seed, number + 1, False
        self._begun, self._actions = {"episode": number, "pose": pose}, []
        self._reading, self._path, self._terms = reading, [self.drive.state.pose], dict.fromkeys(TERMS, 0.0)
        self._observer.begin()
        return self._observer.observe(reading), self._info(None)

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drive one control step of 0.2 s; after the end of an episode with a warning.

        Returns:
            Observation, reward, terminated, truncated, and an info: `terms`, every weighted reward term by name (0 at
            reset); `world`, its name; `pose`, the Pose2 of the car; `outcome`, empty
            until the end; `is_success`.

        Raises:
            EpisodeError: no episode was begun yet, or the environment is closed.
            ActionError: the action is not finite, or none of the six; nothing was simulated.
        """
        self._refuse_closed("step")
        if self._begun is None:
            raise EpisodeError("step: no episode was begun yet; call reset first")
        if self._over:
            gymnasium.logger.warn("step: the episode is over, what comes after its end means nothing; call reset")
        spec = self.spec_observation
        command = spec.decode_discrete(action) if self._discrete else spec.decode(action)
        self._actions.append(np.array(action))
        step = self.drive.step(command)
        self._reading, self._terms = step.reading, step.terms
        self._path.append(self.drive.state.pose)
        self._over = ended = step.outcome is not None
        terminated = step.outcome is not None and bool(self._terminal[step.outcome.code])
        info = self._info(step.outcome)
        return self._observer.observe(step.reading), step.reward, terminated, ended and not terminated, info

    def _info(self, outcome: Outcome | None) -> dict[str, Any]:
        return {
            "terms": dict(self._terms),
            "world": self.drive.world.name,
            "pose": self.drive.state.pose,
            "outcome": "" if outcome is None else str(outcome),
            "is_success": outcome == "success",
        }

    def _refuse_closed(self, what: str) -> None:
        if self._closed:
            raise EpisodeError(f"{what}: this environment is closed; make a new one")

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs to be an environment of its own, at the same place of the same episode."""
        self._refuse_closed("copy")
        return {
            "arguments": {
                **{"world": self._worlds, "task": self.drive.config, "discrete": self._discrete, "raw": self._raw},
                "render_mode": self.render_mode,
            },
            **{"seed": self._seed, "n_episodes": self._n_episodes, "begun": self._begun, "actions": self._actions},
            **{"spec": self.spec, "np_random": (self._np_random, self._np_random_seed)},
            "spaces": (self.observation_space, self.action_space),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Become the environment of which `__getstate__` told: a physics client anew, the same actions driven again."""
        self.__init__(**state["arguments"])  # type: ignore[misc]
        if state["begun"] is not None:
            self.reset(seed=state["seed"], options=state["begun"])
            for action in state["actions"]:
                self.step(action)
        self._seed, self._n_episodes, self.spec = state["seed"], state["n_episodes"], state["spec"]
        # Those of the original: each has a random state.
        (self._np_random, self._np_random_seed), (self.observation_space, self.action_space) = (
            state["np_random"],
            state["spaces"],
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Return the (480, 640, 3) picture of the car now, or None without a render mode.

        Raises:
            EpisodeError: there is no episode to draw.
        """
        self._refuse_closed("render")
        if self.render_mode is None:
            return None
        if self._begun is None:
            raise EpisodeError("render: no episode was begun yet; call reset first")
        from zebrat_bullet.render import Renderer, live_frame  # VTK loads only for those who draw

        if self._renderer is None or self._renderer.world is not self.drive.world:
            self._close_renderer()
            self._renderer = Renderer(self.drive.robot, self.drive.world, *RENDER_SIZE)
        return self._renderer.frame(live_frame(self.drive, self._reading, self._path, self._terms))

    @property
    def reading(self) -> Reading:
        """All that the car senses now, as a driver is given it: the whole scan, what the observation is made of, speed.

        The scan holds nan where the task's `LidarConfig.bearings` confines the lidar.

        Raises:
            EpisodeError: no episode was begun yet.
        """
        if self._begun is None:
            raise EpisodeError("reading: no episode was begun yet; call reset first")
        return self._reading

    @property
    def episode(self) -> tuple[int, int]:
        """The seed and the number of the episode under way: `reset(seed=..., options={"episode": ...})` begins it.

        Raises:
            EpisodeError: there is none yet.
        """
        if self._seed is None:
            raise EpisodeError("episode: no episode was begun yet; call reset first")
        return self._seed, self._n_episodes - 1

    def close(self) -> None:
        """Release the physics server and the renderer; a second call does nothing."""
        self._closed = True
        self._close_renderer()
        self.drive.close()

    def _close_renderer(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def varied(
    task: TaskConfig | Mapping[str, Any] | None,
    robot: str | Path | None,
    reward: str | RewardConfig | Mapping[str, Any] | None,
    caster: str | None,
    noise: NoiseConfig | Mapping[str, Any] | None,
) -> TaskConfig:
    """Return the task, the default one if None, with another car, reward, ray caster and noise, where not None."""
    task = TaskConfig() if task is None else from_plain(TaskConfig, task)
    if isinstance(reward, str):
        task = with_reward(task, reward)
    elif reward is not None:
        task = replace(task, reward=from_plain(RewardConfig, reward, task.reward))
    return replace(
        task,
        robot=task.robot if robot is None else str(robot),
        noise=task.noise if noise is None else from_plain(NoiseConfig, noise, task.noise),
        lidar=task.lidar if caster is None else replace(task.lidar, caster=caster),
    )


def spaces_of(spec: ObservationSpec, discrete: bool) -> tuple[spaces.Box, spaces.Space]:
    """Return the spaces of observations and actions."""
    low, high = spec.bounds
    limits = spec.limits if spec.raw else np.ones(2, dtype=np.float32)
    action = spaces.Discrete(len(DISCRETE_COMMANDS)) if discrete else spaces.Box(-limits, limits, dtype=np.float32)
    return spaces.Box(low, high, dtype=np.float32), action
