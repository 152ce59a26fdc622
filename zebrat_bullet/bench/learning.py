"""Times learning, side by side: Stable-Baselines3's own DDPG on this environment, and a preset of ours."""

import time
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np
import torch
from stable_baselines3 import DDPG, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from zebrat_bullet.config import EpisodeConfig, ObservationConfig, TaskConfig
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.training.learner_settings import DDPGConfig
from zebrat_bullet.training.learners import build_learner
from zebrat_bullet.training.planar_vec_env import PlanarVecEnv
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.vec_env import learn_meanwhile, make_vec_env
from zebrat_bullet.world import generate_tracks

WARMUP_STEPS, RANDOM_STEPS = 300, 100
N_TRACKS = 20
ROLLOUT_STEPS, BATCH_SIZE, N_EPOCHS = 32, 8192, 4
"""Of the PPO that `bench_planar_learning` times; 1,024 cars fill a batch in eight steps."""


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


def bench_planar_learning(n_cars: int, device: str, rounds: int, seed: int) -> dict[str, dict[str, float]]:
    """Return steps a second while Stable-Baselines3's PPO learns on planar cars, with one thread and with all in turn.

    Args:
        n_cars: cars side by side.
        device: of cars and networks.
        rounds: rounds, of which the medians are given; each is a rollout and its update.
        seed: of the run.

    Returns:
        By number of threads: `steps_per_s`, and in us of a step of one car `update_us` and `rest_us` (simulation,
        actions, storing).
    """
    if rounds < 1:
        raise ConfigError(f"rounds must be at least 1, got {rounds}")
    task = TaskConfig(episode=EpisodeConfig(start="anywhere"), observation=ObservationConfig(log_gaps=True))
    worlds = list(generate_tracks(range(N_TRACKS)))
    model = PPO(
        "MlpPolicy",
        PlanarVecEnv(PlanarVectorEnv(n_cars, worlds, task=task, device=device)),
        n_steps=ROLLOUT_STEPS,
        batch_size=BATCH_SIZE,
        n_epochs=N_EPOCHS,
        policy_kwargs={"net_arch": [128, 128], "optimizer_kwargs": {"fused": True}},
        seed=seed,
        device=device,
    )
    n_threads = torch.get_num_threads()
    rows: dict[int, list[tuple[float, float]]] = {1: [], n_threads: []}
    way, n_steps = _Way(model, n_threads), n_cars * ROLLOUT_STEPS
    way.run(n_steps)
    for _ in range(rounds):
        for threads, timed in rows.items():
            way.threads = threads
            timed.append(way.run(n_steps))
    way.close()
    result = {}
    for threads, timed in rows.items():
        step, update = (median(values) for values in zip(*timed, strict=True))
        name = f"{threads} thread" + "s" * (threads > 1)
        result[name] = {"steps_per_s": 1.0 / step, "update_us": 1e6 * update, "rest_us": 1e6 * (step - update)}
    return result


class _Way:
    """A learner, timed."""

    def __init__(self, model: BaseAlgorithm, threads: int) -> None:
        self._model, self.threads = model, threads
        trainable: Any = model
        self._train, self._in_updates = trainable.train, 0.0
        trainable.train = self._timed_train

    def run(self, n_steps: int) -> tuple[float, float]:
        """Learn for so many steps; return the time of a step and of its update in s."""
        torch.set_num_threads(self.threads)
        self._in_updates, began, first = 0.0, time.perf_counter(), self._model.num_timesteps
        self._model.learn(n_steps, reset_num_timesteps=False)
        n_driven = self._model.num_timesteps - first  # whole rollouts
        return (time.perf_counter() - began) / n_driven, self._in_updates / n_driven

    def close(self) -> None:
        """Release the environments."""
        assert self._model.env is not None
        self._model.env.close()

    def _timed_train(self, *arguments: Any, **named: Any) -> None:
        began = time.perf_counter()
        self._train(*arguments, **named)
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
