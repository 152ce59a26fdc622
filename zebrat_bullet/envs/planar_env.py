"""A gymnasium VectorEnv of planar cars: wiring only. The task itself is `zebrat_bullet.planar.drive.PlanarDrive`."""

from collections.abc import Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from zebrat_bullet.arrays import like, on_host
from zebrat_bullet.config import NoiseConfig, RewardConfig, TaskConfig
from zebrat_bullet.envs.reset_options import seed_of
from zebrat_bullet.envs.zebrat_env import spaces_of, varied
from zebrat_bullet.errors import ActionError, ConfigError, EpisodeError
from zebrat_bullet.files import shown
from zebrat_bullet.planar.drive import PlanarDrive, PlanarStep
from zebrat_bullet.planar.margins import Margins
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.task.rewards import TERMS, terminal_codes
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, load_worlds

_INSTEAD = {
    "discrete": "their actions are continuous, (N, 2); PyBullet's ZebraT/BigTrackDiscrete-v0 has the six actions",
    "max_episode_steps": "say it in the task: task={'episode': {'max_steps': N}}",
    "world": "name worlds, one or several",
}


class PlanarVectorEnv(VectorEnv):
    """Thousands of planar cars, each in a world of its own, under the task of `ZebratEnv`.

    Observations, actions, rewards and ends are those of `ZebratEnv`, with a leading axis of cars. A car whose episode
    ends begins its next one in the same step (`AutoresetMode.SAME_STEP`): `info["final_obs"]` then holds the last
    observation. The same seed gives the same numbers on the same device, bit for bit.

    Args:
        num_envs: cars.
        worlds: names, files or `World` objects, one or several; each episode draws one.
        start, goal, exit, robot, reward, noise, raw, task: as for `ZebratEnv`.
        margin_m: as for `PlanarDrive`.
        device: "cpu" or "cuda". Observations, rewards and actions are NumPy arrays either way;
            `PlanarDrive` itself keeps them on the device.

    Attributes:
        task, spec_observation: as of `ZebratEnv`.

    Raises:
        ConfigError, WorldError, AssetError: see the message.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 (gymnasium's contract)

    def __init__(
        self,
        num_envs: int = 1,
        worlds: str | Path | World | Sequence[str | Path | World] = "big_track",
        *,
        start: Pose2 | Sequence[float] | None = None,
        goal: Pose2 | Sequence[float] | None = None,
        exit: Sequence[Sequence[float]] | None = None,
        robot: str | Path | None = None,
        reward: str | RewardConfig | Mapping[str, Any] | None = None,
        noise: NoiseConfig | Mapping[str, Any] | None = None,
        raw: bool = False,
        task: TaskConfig | Mapping[str, Any] | None = None,
        device: str = "cpu",
        margin_m: Margins = 0.0,
    ) -> None:
        config = varied(task, robot, reward, None, noise)
        loaded = load_worlds(worlds, start=start, goal=goal, exit=exit, robot=load_robot(config.robot))
        seed = int(np.random.default_rng().integers(2**31))  # until a reset names one
        self.drive = PlanarDrive(config, loaded, num_envs, device=device, seed=seed, raw=raw, margin_m=margin_m)
        self.task, self.spec_observation = self.drive.task, self.drive.spec
        self.terminal = terminal_codes(config.reward)
        self.num_envs = num_envs = self.drive.n_cars
        self.single_observation_space, self.single_action_space = spaces_of(self.drive.spec, discrete=False)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode of every car.

        Args:
            seed: fixes all that follows; None goes on with the last one's numbers, and at first with any.
            options: none: every car is begun with.

        Returns:
            (N, size) observations, and an info with `terms`, all 0.

        Raises:
            ConfigError: the seed is none, or there are options.
            EpisodeError: the cars are closed.
        """
        self._refuse_closed("reset")
        refuse_options(options)
        seed = seed_of(seed)
        super().reset(seed=seed)
        observation = on_host(self.drive.reset(seed))
        return observation, {"terms": {name: np.zeros(self.num_envs, np.float32) for name in TERMS}}

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, ...]:
        """Drive every car one control step of 0.2 s.

        Returns:
            (N, size) observations, (N,) rewards, terminated, truncated, and an info with `terms`, the weighted reward
            terms by name, and, where episodes ended (mask `_outcome`), `outcome`, `is_success`, `final_obs`.

        Raises:
            ActionError: an action is not finite; the message names car and step, and nothing was simulated.
            EpisodeError: nothing was begun yet, or the cars are closed.
        """
        step = self.drive_step(actions)
        outcome = on_host(step.outcome)
        ended = outcome > 0
        terminated = self.terminal[outcome]
        return (
            on_host(step.observation),
            on_host(step.reward),
            terminated,
            ended & ~terminated,
            self._info(step, outcome),
        )

    def __reduce_ex__(self, protocol: object) -> str:
        """Refuse to be copied or pickled: its cars live in memory of the device.

        Raises:
            EpisodeError: always; says what to do instead.
        """
        raise EpisodeError("planar cars cannot be copied or pickled; make another env, or use drive.state() and load()")

    def _refuse_closed(self, what: str) -> None:
        if self.closed:
            raise EpisodeError(f"{what}: this environment is closed; make a new one")

    def drive_step(self, actions: NDArray[np.float32]) -> PlanarStep:
        """Drive every car one control step and return all that came of it, on the device of the cars.

        Raises:
            ActionError, EpisodeError: as `step`.
        """
        self._refuse_closed("step")
        if not self.drive.begun:
            raise EpisodeError("step: no episode was begun yet; call reset first")
        try:
            values = np.asarray(actions, dtype=np.float32)
        except (TypeError, ValueError):  # a text, a ragged list
            raise ActionError(f"actions must be ({self.num_envs}, 2) numbers, got {shown(repr(actions))}") from None
        return self.drive.step(like(values, self.drive.sim.pose))

    def _info(self, step: PlanarStep, outcome: NDArray[np.int8]) -> dict[str, Any]:
        info: dict[str, Any] = {"terms": {name: on_host(term) for name, term in step.terms.items()}}
        if len(step.ended):
            ended = outcome > 0
            names = np.full(self.num_envs, None, dtype=object)
            last = np.full(self.num_envs, None, dtype=object)
            for car, observation in zip(step.ended, on_host(step.last_observation), strict=True):
                names[car], last[car] = str(Outcome.of(int(outcome[car]))), observation
            info |= {"outcome": names, "is_success": outcome == Outcome.SUCCESS.code, "final_obs": last}
            info |= {"_outcome": ended, "_is_success": ended, "_final_obs": ended}
        return info


def refuse_options(options: object) -> None:
    """Refuse options of a reset: nothing of planar cars heeds any.

    Raises:
        ConfigError: there are some; says what to do instead.
    """
    if options:
        raise ConfigError(
            f"reset of planar cars takes no options, got {shown(repr(options))}; drive.begin_at places cars, and "
            "PyBullet's env begins an episode by its number"
        )


def make_planar(num_envs: int = 1, **settings: Any) -> PlanarVectorEnv:
    """Return a `PlanarVectorEnv`; what `gymnasium.make_vec` calls.

    Raises:
        ConfigError: it has no such setting; the message lists those there are.
    """
    known = list(signature(PlanarVectorEnv).parameters)[1:]
    for name in settings.keys() - known:
        instead = _INSTEAD.get(name, f"they take {', '.join(known)}")
        raise ConfigError(f"planar cars take no {name}={shown(repr(settings[name]))}; {instead}")
    return PlanarVectorEnv(num_envs, **settings)


def refuse_single(**settings: Any) -> NoReturn:
    """Refuse to make one car; what `gymnasium.make` calls.

    Raises:
        ConfigError: always; says what to call instead.
    """
    raise ConfigError(
        "planar cars are many at once: call gymnasium.make_vec('ZebraT/Planar-v0', num_envs=N) without "
        "vectorization_mode; one car in PyBullet is gymnasium.make('ZebraT/BigTrack-v0')"
    )
