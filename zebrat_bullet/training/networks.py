"""The layers of a learner's network, in Stable-Baselines3 or in PyTorch, as a policy that runs without torch."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.dqn.policies import DQNPolicy
from stable_baselines3.sac.policies import SACPolicy
from stable_baselines3.td3.policies import TD3Policy
from torch import nn

from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.files import shown
from zebrat_bullet.task.observation import ObservationSpec
from zebrat_bullet.training.ppo import RunPPO

ELSE = "let a driver of your own ask it, FILE.py:NAME (docs/your_own_policy.md)"
Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]
_ACTIVATIONS = {nn.ReLU: "relu", nn.Tanh: "tanh", nn.ELU: "elu"}


def to_agent(
    model: BaseAlgorithm,
    name: str,
    observation: ObservationSpec,
    provenance: dict[str, object],
    normalise: VecNormalize | None = None,
) -> PolicyAgent:
    """Return the noise-free policy of a learner, to run without torch.

    Raises:
        PolicyError: the format cannot express its network.
    """
    networks, head = _networks(model)
    layers, activations, squashed = layers_of(networks)
    if normalise is not None and normalise.norm_obs:
        layers, activations = _normalised(layers, normalise), ["clip", *activations]
    grid = (model.settings.speeds, model.settings.steerings) if isinstance(model, RunPPO) else ((), ())
    return agent_of(name, layers, activations, squashed, head, observation, provenance, grid)


def agent_of(
    name: str,
    layers: Layers,
    activations: list[str],
    squashed: bool,
    head: str,
    observation: ObservationSpec,
    provenance: dict[str, object],
    grid: Any = ((), ()),
) -> PolicyAgent:
    if squashed and head != "tanh":
        raise PolicyError(f"its last layer is squashed by nn.Tanh, which does not go with the head {head!r}; {ELSE}")
    activation = " ".join(activations if len(set(activations)) > 1 else activations[:1]) or "relu"
    return PolicyAgent(name, layers, observation, provenance, head, activation, grid)


def _networks(model: BaseAlgorithm) -> tuple[list[nn.Module], str]:
    """Return the networks that make an action of an observation, one after the other, and the head."""
    policy: Any = model.policy
    if type(policy) is ActorCriticPolicy:
        heads = {spaces.Discrete: "argmax", spaces.MultiDiscrete: "grid"}
        head = heads.get(type(model.action_space), "tanh" if policy.squash_output else "clip")
        extractor, networks = policy.pi_features_extractor, [policy.mlp_extractor.policy_net, policy.action_net]
    elif type(policy) is TD3Policy:
        extractor, networks, head = policy.actor.features_extractor, [policy.actor.mu], "tanh"
    elif type(policy) is SACPolicy:
        extractor, networks, head = policy.actor.features_extractor, [policy.actor.latent_pi, policy.actor.mu], "tanh"
    elif type(policy) is DQNPolicy:
        extractor, networks, head = policy.q_net.features_extractor, [policy.q_net.q_net], "argmax"
    else:
        raise PolicyError(
            f"{type(model).__name__} has a {type(policy).__name__}, whose network this format cannot express; it takes "
            f'the "MlpPolicy" of PPO, A2C, SAC, TD3, DDPG and DQN: {ELSE}'
        )
    if type(extractor) is not FlattenExtractor:
        raise PolicyError(
            f"the policy looks at its observation through a {type(extractor).__name__}, which this format cannot "
            f"express; {ELSE}"
        )
    return networks, head


def layers_of(modules: Iterable[nn.Module]) -> tuple[Layers, list[str], bool]:
    """Return the layers, the activations between them, and whether an nn.Tanh stands behind the last."""
    layers: Layers = []
    activations: list[str] = []
    for module in _flat(modules):
        if type(module) is nn.Linear and len(activations) == len(layers):
            layers.append(_weights(module))
            if len(layers) > 1 and module.in_features != len(layers[-2][1]):
                raise PolicyError(f"{module} stands behind a layer of {len(layers[-2][1])} outputs; mend the layers")
        elif (
            type(module) in _ACTIVATIONS
            and len(activations) == len(layers) - 1
            and getattr(module, "alpha", 1.0) == 1.0
        ):
            activations.append(_ACTIVATIONS[type(module)])
        else:
            raise PolicyError(
                f"this format cannot express {shown(module)} as part {len(layers) + len(activations) + 1} of the "
                "network; it takes nn.Linear with one of nn.ReLU, nn.Tanh, nn.ELU (alpha 1) between two of them: "
                f"{ELSE}"
            )
    if not layers:
        raise PolicyError("the network has no nn.Linear; give the layers from the observation to the action")
    squashed = len(activations) == len(layers)
    if squashed and activations.pop() != "tanh":
        raise PolicyError(
            f"the last layer is followed by {shown(list(_flat(modules))[-1])}; an action is the last layer's output "
            f"itself, or behind nn.Tanh: {ELSE}"
        )
    return layers, activations, squashed


def _flat(modules: Iterable[nn.Module]) -> list[nn.Module]:
    return [part for module in modules for part in (_flat(module) if type(module) is nn.Sequential else [module])]


def _weights(layer: nn.Linear) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (out, in) weights and (out,) biases."""
    weight = layer.weight.detach().cpu().numpy().astype(np.float32)
    bias = np.zeros(len(weight), np.float32) if layer.bias is None else layer.bias.detach().cpu().numpy()
    if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
        raise PolicyError(f"{layer} has weights that are not finite: its training went wrong; take an earlier model")
    return weight, bias.astype(np.float32)


def _normalised(layers: Layers, normalise: VecNormalize) -> Layers:
    """Return the layers behind one whose output, clipped to [-1, 1], is the normalised observation by its bound."""
    seen: Any = normalise.obs_rms
    bound = normalise.clip_obs
    scale = 1.0 / (np.sqrt(seen.var + normalise.epsilon) * bound)
    first = np.diag(scale).astype(np.float32), (-seen.mean * scale).astype(np.float32)
    (weight, bias), *others = layers
    return [first, (weight * np.float32(bound), bias), *others]
