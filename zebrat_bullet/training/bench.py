"""Times learning, side by side: Stable-Baselines3's own DDPG on this environment, and a preset of ours."""

import time
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np
import torch
from stable_baselines3 import DDPG
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.training.learners import build_learner
from zebrat_bullet.training.settings import DDPGConfig, TrainConfig
from zebrat_bullet.training.vec_env import learn_meanwhile, make_vec_env

WARMUP_STEPS, RANDOM_STEPS = 300, 100


def bench_learning(config: TrainConfig, n_steps: int, rounds: int) -> dict[str, dict[str, float]]:
    """Return environment steps a second while learning, each way in turn so that other load meets all alike.

    Args:
        config: a DDPG run; its world, task, networks, batch and replay are those of every way.
        n_steps: environment steps, and so gradient steps, of each way in each round, at least.
        rounds: rounds, of which the medians are given.

    Returns:
        By way: `steps_per_s`, `update_ms` (a gradient step, its sampling included), `rest_ms` (the rest of a step:
        environment, action, storing) and `times_plain` (`steps_per_s` as a multiple of the fastest plain way's).

    Raises:
        ConfigError: the run is not DDPG, or there is nothing to time.
    """
    learner = config.learner
    if not isinstance(learner, DDPGConfig):
        raise ConfigError(f"only DDPG can be timed beside Stable-Baselines3's own, got {learner.algo!r}")
    if n_steps < 1 or rounds < 1:
        raise ConfigError(f"steps and rounds must be at least 1, got {n_steps} and {rounds}")
    learner = replace(learner, warmup_steps=RANDOM_STEPS)  # as Stable-Baselines3's own
    config = replace(config, learner=learner)
    n_threads = torch.get_num_threads()
    ways = {
        "Stable-Baselines3, 1 thread": _Way(_plain(config), 1),
        f"Stable-Baselines3, {n_threads} threads": _Way(_plain(config), n_threads),
        "ours, one process": _Way(_ours(replace(config, overlap=False)), 1),
        "ours, float32, overlapped": _Way(
            _ours(replace(config, overlap=True, learner=replace(learner, precision="fp32"))), 1
        ),
        "ours, overlapped": _Way(_ours(replace(config, overlap=True)), 1),
    }
    for way in ways.values():
        way.run(WARMUP_STEPS)
    rows: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            rows[name].append(way.run(n_steps))
    for way in ways.values():
        way.close()
    result = {}
    for name, timed in rows.items():
        step, update = (median(values) for values in zip(*timed, strict=True))
        result[name] = {"steps_per_s": 1.0 / step, "update_ms": 1e3 * update, "rest_ms": 1e3 * (step - update)}
    plain = max(at["steps_per_s"] for name, at in result.items() if name.startswith("Stable"))
    return {name: at | {"times_plain": at["steps_per_s"] / plain} for name, at in result.items()}


class _Way:
    """A learner, timed."""

    def __init__(self, model: OffPolicyAlgorithm, threads: int) -> None:
        self._model, self._threads = model, threads
        self._train, self._in_updates = model.train, 0.0
        model.train = self._timed_train  # type: ignore[method-assign]

    def run(self, n_steps: int) -> tuple[float, float]:
        """Learn for so many steps; return the time of a step and of its update in s."""
        torch.set_num_threads(self._threads)
        self._in_updates, began, first = 0.0, time.perf_counter(), self._model.num_timesteps
        self._model.learn(n_steps, reset_num_timesteps=False)
        n_driven = self._model.num_timesteps - first  # whole rollouts
        return (time.perf_counter() - began) / n_driven, self._in_updates / n_driven

    def close(self) -> None:
        """Release the environments."""
        assert self._model.env is not None
        self._model.env.close()

    def _timed_train(self, gradient_steps: int, batch_size: int = 100) -> None:
        began = time.perf_counter()
        self._train(gradient_steps, batch_size)
        self._in_updates += time.perf_counter() - began


def _plain(config: TrainConfig) -> DDPG:
    settings: Any = config.learner
    return DDPG(
        "MlpPolicy",
        ZebratEnv(config.worlds, task=config.task),
        learning_rate=settings.actor_lr,
        buffer_size=settings.buffer_size,
        batch_size=settings.batch_size,
        gamma=settings.gamma,
        tau=settings.tau,
        action_noise=NormalActionNoise(np.zeros(2), np.full(2, settings.sigma)),
        policy_kwargs={"net_arch": list(settings.hidden)},
        seed=config.seed,
        device="cpu",
    )


def _ours(config: TrainConfig) -> OffPolicyAlgorithm:
    env = make_vec_env(config.n_envs, config.overlap, world=list(config.worlds), task=config.task)
    model = build_learner(config, env)
    assert isinstance(model, OffPolicyAlgorithm)
    learn_meanwhile(model, env)
    return model
