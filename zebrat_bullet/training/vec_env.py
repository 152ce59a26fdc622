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


class ReplayableEnv(gymnasium.Wrapper):
    """Remembers the actions of the episode under way: an episode is a pure function of its number and these.

    Args:
        env: a ZebratEnv, wrapped or not.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        assert isinstance(env.unwrapped, ZebratEnv)
        self._inner = env.unwrapped
        self._actions: list[Any] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the next episode."""
        begun = self.env.reset(seed=seed, options=options)
        self._actions.clear()  # only now: one that was refused leaves the episode as it was
        return begun

    def step(self, action: Any) -> Any:
        """Step and remember."""
        self._actions.append(np.asarray(action).tolist())
        return self.env.step(action)

    def place(self) -> dict[str, Any]:
        """Return where the environment is: seed and number of the episode, and its actions so far (JSON)."""
        return {"episode": self._inner.episode, "actions": list(self._actions)}

    def go_to(self, place: dict[str, Any]) -> None:
        """Drive the episode of a place again, up to there."""
        seed, episode = place["episode"]
        self.reset(seed=seed, options={"episode": episode})
        for action in place["actions"]:
            self.step(np.asarray(action, dtype=self.action_space.dtype))


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


def make_vec_env(n_envs: int, in_processes: bool, **env: Any) -> OverlappedVecEnv:
    """Return environments for a learner.

    Args:
        n_envs: how many.
        in_processes: each in a process of its own, with one thread.
        env: arguments of ZebratEnv.
    """
    make: list[Callable[[], gymnasium.Env]] = [partial(_make_env, **env)] * n_envs
    return OverlappedVecEnv(SubprocVecEnv(make, start_method="spawn") if in_processes else DummyVecEnv(make))


def learn_meanwhile(model: OffPolicyAlgorithm, vec_env: OverlappedVecEnv, gradient_steps: int | None = None) -> None:
    """Let a learner do so many gradient steps, None for as many as there are environments, while these step."""
    n_steps = model.n_envs if gradient_steps is None else gradient_steps

    def learn() -> None:
        if model.num_timesteps > model.learning_starts:
            model.train(gradient_steps=n_steps, batch_size=model.batch_size)

    vec_env.meanwhile = learn


def _make_env(**env: Any) -> gymnasium.Env:
    return ReplayableEnv(Monitor(ZebratEnv(**env)))
