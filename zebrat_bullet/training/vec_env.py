"""Training environments side by side: stepped while the learner updates, and put back where a killed run left them."""

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.types import Pose2

RETRY_STEPS = (5, 26)
"""A retry begins so many control steps before the failure, drawn from [first, last): 1 to 5 s."""


class ReplayableEnv(gymnasium.Wrapper):
    """Remembers the actions of the episode under way: an episode is a pure function of how it began and these.

    Args:
        env: a ZebratEnv, wrapped or not.
        retries: so many times an episode that ended in a collision or a stall is tried again, each time from a pose
            that the car itself had some steps before (`RETRY_STEPS`). It leads to the places that are hard, unguided.
    """

    def __init__(self, env: gymnasium.Env, retries: int = 0) -> None:
        super().__init__(env)
        assert isinstance(env.unwrapped, ZebratEnv)
        self._inner, self._retries = env.unwrapped, retries
        self._tries, self._failed = 0, False
        self._actions: list[Any] = []
        self._path: list[Pose2] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode: the next one, or the last one again from some steps before its end."""
        if seed is None and options is None and self._failed and self._tries < self._retries:
            rng = np.random.default_rng([*self._inner.episode, self._tries])
            back = int(rng.integers(*RETRY_STEPS))
            return self._begin(self._inner.episode, self._path[:-back] or self._path[:1], self._tries + 1)
        self._tries, self._failed = 0, False
        self._actions.clear()
        result = self.env.reset(seed=seed, options=options)
        self._path = [self._inner.drive.state.pose]
        return result

    def step(self, action: Any) -> Any:
        """Step and remember."""
        self._actions.append(np.asarray(action).tolist())
        result = self.env.step(action)
        self._path.append(self._inner.drive.state.pose)
        self._failed = result[4].get("outcome") in ("collision", "stall")
        return result

    def place(self) -> dict[str, Any]:
        """Return where the environment is: seed, number and try of the episode, its poses and its actions (JSON)."""
        path = [(pose.x, pose.y, pose.yaw) for pose in self._path[: len(self._path) - len(self._actions)]]
        return {"episode": self._inner.episode, "tries": self._tries, "path": path, "actions": list(self._actions)}

    def go_to(self, place: dict[str, Any]) -> None:
        """Drive the episode of a place again, up to there."""
        seed, episode = place["episode"]
        if place["tries"]:
            self._inner.reset(seed=seed)
            self._begin((seed, episode), [Pose2(*pose) for pose in place["path"]], place["tries"])
        else:
            self.reset(seed=seed, options={"episode": episode})
        for action in place["actions"]:
            self.step(np.asarray(action, dtype=self.action_space.dtype))

    def _begin(self, episode: tuple[int, int], path: list[Pose2], tries: int) -> tuple[Any, dict[str, Any]]:
        self._path, self._tries, self._failed = path, tries, False
        self._actions.clear()
        return self.env.reset(options={"episode": episode[1], "pose": path[-1]})


class OverlappedVecEnv(VecEnvWrapper):
    """Calls `meanwhile` between handing the actions to the environments and waiting for what came of them.

    With environments in processes of their own, learner and physics work at the same time; within this process the
    order is the same, and so is every number.
    """

    meanwhile: Callable[[], None] | None = None

    def reset(self) -> VecEnvObs:
        """Reset all environments."""
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        """Let the learner work, then return what the environments did."""
        if self.meanwhile is not None:
            self.meanwhile()
        return self.venv.step_wait()


def make_vec_env(n_envs: int, in_processes: bool, retries: int = 0, **env: Any) -> OverlappedVecEnv:
    """Return environments for a learner.

    Args:
        n_envs: how many.
        in_processes: each in a process of its own, with one thread.
        retries: of failed episodes, see ReplayableEnv.
        env: arguments of ZebratEnv.
    """
    make: list[Callable[[], gymnasium.Env]] = [partial(_make_env, retries, **env)] * n_envs
    return OverlappedVecEnv(SubprocVecEnv(make, start_method="spawn") if in_processes else DummyVecEnv(make))


def learn_meanwhile(model: OffPolicyAlgorithm, vec_env: OverlappedVecEnv) -> None:
    """Let a learner do as many gradient steps as there are environments, while these step."""

    def learn() -> None:
        if model.num_timesteps > model.learning_starts:
            model.train(gradient_steps=model.n_envs, batch_size=model.batch_size)

    vec_env.meanwhile = learn


def _make_env(retries: int, **env: Any) -> gymnasium.Env:
    return ReplayableEnv(Monitor(ZebratEnv(**env)), retries)
