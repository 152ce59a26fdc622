"""What you trained yourself, with Stable-Baselines3 or in PyTorch, as a policy of this package."""

import json
from collections.abc import Iterable
from typing import Any

import numpy as np
import stable_baselines3
import torch
from gymnasium import ActionWrapper, Env, ObservationWrapper, spaces
from gymnasium.vector import VectorActionWrapper, VectorEnv, VectorObservationWrapper
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecNormalize, unwrap_vec_normalize
from torch import nn

from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import to_json
from zebrat_bullet.envs.zebrat_env import spaces_of
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.files import shown
from zebrat_bullet.task.observation import DISCRETE_COMMANDS, ObservationSpec
from zebrat_bullet.training.networks import ELSE, agent_of, layers_of, to_agent
from zebrat_bullet.training.ppo import RunPPO

_CHANGING = (ObservationWrapper, ActionWrapper, VectorObservationWrapper, VectorActionWrapper)
_CLOSE = 1e-5
_N_COMPARED = 512


def policy_of(
    model: BaseAlgorithm, env: Env | VectorEnv | VecEnv, normalise: VecNormalize | None = None
) -> PolicyAgent:
    """Return what a model of Stable-Baselines3 has learned as a policy of this package; `save_policy` writes it.

    Before it returns, it compares the policy's actions with those of `model.predict(..., deterministic=True)` on random
    observations.

    Args:
        model: PPO, A2C, SAC, TD3, DDPG or DQN with an "MlpPolicy" of nn.ReLU, nn.Tanh or nn.ELU.
        env: an environment like that of the training, also within wrappers: what the policy observes, and the task
            under which the judge drives it.
        normalise: the VecNormalize of the training. A model that was loaded does not know it.

    Raises:
        PolicyError: the format cannot express the model, or the policy acts otherwise than it, by over 1e-5.
    """
    if not isinstance(model, BaseAlgorithm):
        raise PolicyError(
            f"policy_of takes a model of Stable-Baselines3, got {type(model).__name__}; policy_of_layers takes "
            "nn.Linear and activations"
        )
    observation, task = _observed(env)
    _check_spaces(model, observation)
    _check_normalised(model, env, normalise, observation.size)
    learner = f"{type(model).__name__} of Stable-Baselines3 {stable_baselines3.__version__}"
    agent = to_agent(model, "own", observation, _provenance(task, learner), normalise)
    seen = _random_observations(observation, normalise)
    actions, _ = model.predict(seen if normalise is None else normalise.normalize_obs(seen), deterministic=True)
    _check_same(agent, seen, actions)
    return agent


def policy_of_layers(layers: Iterable[nn.Module], env: Env | VectorEnv | VecEnv, head: str = "clip") -> PolicyAgent:
    """Return a network of PyTorch as a policy of this package; `save_policy` writes it.

    Before it returns, it compares the policy's actions with those of the layers on random observations.

    Args:
        layers: an nn.Sequential or a list: nn.Linear with nn.ReLU, nn.Tanh or nn.ELU between them, from (N, size)
            observations on.
        env: as for `policy_of`.
        head: what makes an action of the last layer: "clip" to [-1, 1], "tanh" (also where nn.Tanh is the last of the
            layers), or "argmax", the largest of six outputs, in the order of `DISCRETE_COMMANDS`.

    Raises:
        PolicyError: the format cannot express the layers, or the policy acts otherwise than they, by over 1e-5.
    """
    if isinstance(layers, nn.Module) and type(layers).forward is not nn.Sequential.forward:
        raise PolicyError(
            f"{type(layers).__name__} does not say in which order its layers act; give them as a list: nn.Linear with "
            "nn.ReLU, nn.Tanh or nn.ELU between them"
        )
    if head not in ("clip", "tanh", "argmax"):
        raise PolicyError(f'head is "clip", "tanh" or "argmax", got {shown(repr(head))}')
    network = nn.Sequential(*layers)
    observation, task = _observed(env)
    weights, activations, squashed = layers_of([network])
    if len(weights[0][0].T) != observation.size:
        raise PolicyError(
            f"its first layer takes {len(weights[0][0].T)} numbers, the environment's observation has "
            f"{observation.size}; of stacked frames or an observation of your own, {ELSE}"
        )
    head = "tanh" if squashed and head == "clip" else head
    agent = agent_of("own", weights, activations, squashed, head, observation, _provenance(task, "PyTorch"))
    seen = _random_observations(observation, None)
    with torch.no_grad():
        first = next(network.parameters())
        output = network(torch.from_numpy(seen).to(first)).float().cpu().numpy()
    if head == "argmax":
        actions = output.argmax(axis=1)
    else:
        actions = output if squashed else np.tanh(output) if head == "tanh" else np.clip(output, -1.0, 1.0)
    _check_same(agent, seen, actions)
    return agent


def _observed(env: Env | VectorEnv | VecEnv) -> tuple[ObservationSpec, TaskConfig]:
    """Return what an environment of this package observes, and its task."""
    try:
        if isinstance(env, VecEnv):
            observation, task = (env.get_attr(name)[0] for name in ("spec_observation", "task"))
        else:
            bare: Any = env.unwrapped
            observation, task = bare.spec_observation, bare.task
    except AttributeError:
        raise PolicyError(
            f'env is {shown(env)}, none of this package; give one, say gymnasium.make("ZebraT/Track2-v0", ...) with '
            "the settings of the training"
        ) from None
    if observation.raw:
        raise PolicyError(
            "a policy observes and acts in [-1, 1], and this environment is raw, in SI units; train with raw=False, or "
            f"{ELSE}"
        )
    if changed := _changed_by(env):
        raise PolicyError(f"{changed} changes what is observed or done, which this format cannot express; {ELSE}")
    return observation, task


def _changed_by(env: Any) -> str:
    """Return the kind of wrapper about an environment that changes observations or actions, "" for none."""
    if isinstance(env, VecEnv):
        return next((f"an {kind.__name__}" for kind in _CHANGING[:2] if any(env.env_is_wrapped(kind))), "")
    while env is not env.unwrapped:
        if isinstance(env, _CHANGING):
            return type(env).__name__
        env = env.env
    return ""


def _check_spaces(model: BaseAlgorithm, observation: ObservationSpec) -> None:
    """Refuse a model that observes or does something else than the environment."""
    seen, box = spaces_of(observation, discrete=False)
    if model.observation_space != seen:
        raise PolicyError(
            f"the model observes {shown(model.observation_space)}, the environment gives {shown(seen)}; give the "
            f"environment of its training. Of stacked frames or an observation of your own, {ELSE}"
        )
    its = model.action_space
    if not (its in (box, spaces.Discrete(len(DISCRETE_COMMANDS))) or isinstance(model, RunPPO)):
        raise PolicyError(
            f"the model acts in {shown(its)}, a policy in {shown(box)} or by one of the {len(DISCRETE_COMMANDS)} "
            f"discrete actions; {ELSE}"
        )


def _check_normalised(model: BaseAlgorithm, env: Any, normalise: VecNormalize | None, size: int) -> None:
    """Refuse to leave out a VecNormalize that is known, and what is none over this observation."""
    known = model.get_vec_normalize_env() or (unwrap_vec_normalize(env) if isinstance(env, VecEnv) else None)
    if normalise is None:
        if known is not None and known.norm_obs:
            raise PolicyError("the model has learned behind a VecNormalize; give it too, as normalise=...")
        return
    if not isinstance(normalise, VecNormalize):
        raise PolicyError(
            f"normalise is a VecNormalize of Stable-Baselines3, got {type(normalise).__name__}; what else normalises "
            f"this format cannot express: {ELSE}"
        )
    shape = np.shape(getattr(normalise.obs_rms, "mean", ())) if normalise.norm_obs else (size,)
    if shape != (size,):
        raise PolicyError(f"the VecNormalize is over observations of shape {shape}, the environment's is ({size},)")


def _provenance(task: TaskConfig, learner: str) -> dict[str, object]:
    return {"config": {"task": json.loads(to_json(task))}, "learner": learner}


def _random_observations(observation: ObservationSpec, normalise: VecNormalize | None) -> NDArray[np.float32]:
    """Return (N, size) float32 observations from anywhere, and where some were seen, as many like those."""
    rng = np.random.default_rng(0)
    seen = rng.uniform(-1.0, 1.0, (_N_COMPARED, observation.size))
    if normalise is not None and normalise.norm_obs:
        rms: Any = normalise.obs_rms
        seen = np.concatenate([seen, np.clip(rng.normal(rms.mean, np.sqrt(rms.var), seen.shape), -1.0, 1.0)])
    return seen.astype(np.float32)


def _check_same(agent: PolicyAgent, seen: NDArray[np.float32], actions: NDArray) -> None:
    """Refuse a policy whose actions for (N, size) observations are not these; of a tie either choice will do."""
    if agent.head in ("argmax", "grid"):
        output = agent.output(seen)
        parts = [output] if agent.head == "argmax" else np.split(output, [len(agent.grid[0])], axis=1)
        rows, choices = np.arange(len(seen)), actions.reshape(len(seen), -1).T
        lost = [part.max(axis=1) - part[rows, choice] for part, choice in zip(parts, choices, strict=True)]
        apart = float(np.max(lost) / max(1.0, np.abs(output).max()))
    else:
        apart = float(np.abs(agent.action(seen) - actions).max())
    if not apart <= _CLOSE:
        raise PolicyError(
            f"the policy acts otherwise than the model, by up to {apart:.2g} on {len(seen)} random observations "
            f"(allowed {_CLOSE:g}): it does something that its layers do not show; {ELSE}"
        )
