"""Planar cars as Stable-Baselines3 wants them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from zebrat_bullet.arrays import on_host
from zebrat_bullet.envs.planar_env import PlanarVectorEnv, refuse_options
from zebrat_bullet.task.episode import Outcome


class PlanarVecEnv(VecEnv):
    """An SB3 VecEnv over a `PlanarVectorEnv`; infos as `Monitor` writes them, with `outcome` and `is_success`."""

    def __init__(self, env: PlanarVectorEnv) -> None:
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)
        self._seed: int | None = None

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset."""
        self._seed = seed
        return [seed] * self.num_envs

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Refuse options of the next reset, as the vector env does.

        Raises:
            ConfigError: there are some.
        """
        refuse_options([each for each in options if each] if isinstance(options, list) else options)

    def reset(self) -> VecEnvObs:
        """Begin an episode of every car."""
        seed, self._seed = self._seed, None
        observation, _ = self.env.reset(seed=seed)
        self._returns[:], self._lengths[:] = 0.0, 0
        return observation

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the actions."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Drive one control step."""
        step = self.env.drive_step(self._actions)
        outcome, reward = on_host(step.outcome), on_host(step.reward).astype(np.float32)
        self._returns += reward
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        last = on_host(step.last_observation)
        for i, car in enumerate(step.ended.tolist()):
            code = int(outcome[car])
            infos[car] = {
                "terminal_observation": last[i],
                "TimeLimit.truncated": not self.env.terminal[code],
                "episode": {"r": float(self._returns[car]), "l": int(self._lengths[car])},
                "outcome": str(Outcome.of(code)),
                "is_success": code == Outcome.SUCCESS.code,
                "world": int(step.world[i]),
            }
        self._returns[step.ended], self._lengths[step.ended] = 0.0, 0
        return on_host(step.observation), reward, outcome > 0, infos

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray]]:
        """Return all that a later `load` needs to go on here: plain values, and arrays."""
        plain, arrays = self.env.drive.state()
        return plain, arrays | {"returns": self._returns.copy(), "lengths": self._lengths.copy()}

    def load(self, plain: Mapping[str, Any], arrays: Mapping[str, NDArray]) -> None:
        """Go on where `state` was taken."""
        self.env.drive.load(plain, arrays)
        self._returns[:], self._lengths[:] = arrays["returns"], arrays["lengths"]

    def close(self) -> None:
        """Drive no more; memory goes with the object."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the vector env, once for each car asked for."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the vector env, which all cars share."""
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the vector env once; every car asked for gets what it returned."""
        result = getattr(self.env, method_name)(*args, **kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Return False for each car: nothing is wrapped one by one."""
        return [False] * len(list(self._get_indices(indices)))
