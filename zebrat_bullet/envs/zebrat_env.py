"""The gymnasium environment: wiring only. The task itself is `zebrat_bullet.task.drive.Drive`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zebrat_bullet.config import NoiseConfig, RewardConfig, TaskConfig, with_reward
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.observation import DISCRETE_COMMANDS, ObservationSpec, observation_spec
from zebrat_bullet.task.waypoints import check_waypoints
from zebrat_bullet.types import Pose2
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
        reward: a preset name ("fomt", "fot", "ft", "wg", "wg_paper", with the observation that it needs) or a
            RewardConfig; None keeps the task's.
        caster: "bullet" or "embree"; None keeps the task's.
        noise: lidar noise; None keeps the task's.
        discrete: six actions instead of a Box.
        raw: observations and actions in SI units instead of [-1, 1].
        task: every other setting; the arguments above override it.
        render_mode: None or "rgb_array" (drawn by VTK through OSMesa).

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
        reward: str | RewardConfig | None = None,
        caster: str | None = None,
        noise: NoiseConfig | None = None,
        discrete: bool = False,
        raw: bool = False,
        task: TaskConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"render_mode must be None or 'rgb_array', got {render_mode!r}")
        config = varied(task or TaskConfig(), reward, caster, noise)
        self._worlds = load_worlds(world, start=start, goal=goal, exit=exit, robot=load_robot(config.robot))
        if config.guided:
            for each in self._worlds:
                check_waypoints(each)
        self.drive = Drive(config, self._worlds[0])
        self.spec_observation = observation_spec(config, self.drive.region, raw)
        self._discrete = discrete
        self.render_mode = render_mode
        self._renderer: Any = None
        self._seed: int | None = None
        self._n_episodes = 0
        self.observation_space, self.action_space = spaces_of(self.spec_observation, discrete)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin the next episode of the seed.

        Args:
            seed: begin again with this seed; None goes on with the last one.
            options: `episode`, the number of the episode to begin instead of the next; `pose`, an exact start Pose2.
        """
        super().reset(seed=seed)
        if seed is not None or self._seed is None:
            self._seed = seed if seed is not None else int(self.np_random.integers(2**31))
            self._n_episodes = 0
        options = options or {}
        self._n_episodes = options.get("episode", self._n_episodes)
        rng = np.random.default_rng([self._seed, self._n_episodes])
        self._n_episodes += 1
        world = self._worlds[rng.integers(len(self._worlds))] if len(self._worlds) > 1 else self._worlds[0]
        reading = self.drive.reset(rng, world, options.get("pose"), whole_scans=self.render_mode is not None)
        self._reading, self._path, self._terms = reading, [self.drive.state.pose], dict[str, float]()
        return self.spec_observation.encode(reading), {"world": world.name, "pose": self.drive.state.pose}

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drive one control step of 0.2 s; `info` holds every weighted reward term and, at the end, the outcome."""
        spec = self.spec_observation
        step = self.drive.step(spec.decode_discrete(action) if self._discrete else spec.decode(action))
        self._reading, self._terms = step.reading, step.terms
        self._path.append(self.drive.state.pose)
        ended = step.outcome is not None
        terminated = step.outcome is not None and step.outcome.terminal
        info: dict[str, Any] = {"terms": step.terms, "world": self.drive.world.name}
        if ended:
            info["outcome"] = str(step.outcome)
            info["is_success"] = step.outcome == "success"
        return spec.encode(step.reading), step.reward, terminated, ended and not terminated, info

    def render(self) -> NDArray[np.uint8] | None:
        """Return the (480, 640, 3) picture of the car now, or None without a render mode."""
        if self.render_mode is None:
            return None
        from zebrat_bullet.render import Renderer, live_frame  # VTK loads only for those who draw

        if self._renderer is None or self._renderer.world is not self.drive.world:
            self._close_renderer()
            self._renderer = Renderer(self.drive.robot, self.drive.world, *RENDER_SIZE)
        return self._renderer.frame(live_frame(self.drive, self._reading, self._path, self._terms))

    @property
    def episode(self) -> tuple[int, int]:
        """The seed and the number of the episode under way: `reset(seed=..., options={"episode": ...})` begins it."""
        assert self._seed is not None, "no episode was begun yet; call reset"
        return self._seed, self._n_episodes - 1

    def close(self) -> None:
        """Release the physics server and the renderer; a second call does nothing."""
        self._close_renderer()
        self.drive.close()

    def _close_renderer(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def varied(
    task: TaskConfig, reward: str | RewardConfig | None, caster: str | None, noise: NoiseConfig | None
) -> TaskConfig:
    """Return the task with another reward, ray caster and noise, each where it is not None."""
    if isinstance(reward, str):
        task = with_reward(task, reward)
    elif reward is not None:
        task = replace(task, reward=reward)
    return replace(
        task,
        noise=noise or task.noise,
        lidar=replace(task.lidar, caster=caster or task.lidar.caster),
    )


def spaces_of(spec: ObservationSpec, discrete: bool) -> tuple[spaces.Box, spaces.Space]:
    """Return the spaces of observations and actions."""
    low, high = spec.bounds
    limits = spec.limits if spec.raw else np.ones(2, dtype=np.float32)
    action = spaces.Discrete(len(DISCRETE_COMMANDS)) if discrete else spaces.Box(-limits, limits, dtype=np.float32)
    return spaces.Box(low, high, dtype=np.float32), action
