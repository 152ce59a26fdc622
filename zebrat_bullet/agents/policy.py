"""A trained policy from a safetensors file, run with numpy: no torch, no unpickling, no simulator."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from zebrat_bullet.assets import find_asset
from zebrat_bullet.config_text import from_json
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.files import parse_json, read_safetensors, refusing, shown, write_safetensors
from zebrat_bullet.task.observation import DISCRETE_COMMANDS, ObservationSpec, Observer
from zebrat_bullet.types import Command, Reading

FORMAT = "zebrat-policy-1"
HEADS = ("tanh", "clip", "argmax", "grid")
ACTIVATIONS: dict[str, Callable[[NDArray[np.float32]], NDArray[np.float32]]] = {
    "relu": lambda values: np.maximum(values, 0.0),
    "tanh": np.tanh,
    "elu": lambda values: np.where(values > 0.0, values, np.expm1(np.minimum(values, 0.0))),
    "clip": lambda values: np.clip(values, -1.0, 1.0),
}
Grid = tuple[tuple[float, ...], tuple[float, ...]]


class PolicyAgent:
    """A multilayer perceptron: observation in, (speed, steering) out.

    Args:
        name: what tables call it.
        layers: (weight (out, in), bias (out,)) of each layer, float32.
        observation: how readings are encoded.
        provenance: how it was trained (config, seed, versions); `load_agent` looks there for the car.
        head: what makes an action of the last layer: "tanh" (DDPG, SAC), "clip" to [-1, 1] (PPO), or "argmax", the
            index of the largest output in `DISCRETE_COMMANDS` (DQN, discrete PPO), or "grid", which chooses a speed
            and a steering, each the one with the largest output (PPO on a grid).
        activation: of the hidden layers, "relu", "tanh", "elu" or "clip" (to [-1, 1]); or one for each of them, with
            blanks between: "clip tanh tanh".
        grid: of a "grid" head, the speeds and the steerings to choose from, as fractions of the limits.

    Raises:
        PolicyError: there is no such head or activation, or there are several activations and not one a hidden layer,
            or the last layer has another number of outputs than the head needs.
    """

    def __init__(
        self,
        name: str,
        layers: list[tuple[NDArray[np.float32], NDArray[np.float32]]],
        observation: ObservationSpec,
        provenance: Mapping[str, Any],
        head: str = "tanh",
        activation: str = "relu",
        grid: Grid = ((), ()),
    ) -> None:
        _check_head(name, len(layers[-1][1]), head, grid)
        _check_activation(name, len(layers) - 1, activation)
        self.name, self.layers, self.observation, self.provenance = name, layers, observation, provenance
        self.head, self.activation, self.grid = head, activation, grid
        self._choices = tuple(np.array(values, dtype=np.float32) for values in grid)
        self.privileged = frozenset({"waypoint"} if observation.waypoint else ())
        self._observer = Observer(observation)

    @property
    def digest(self) -> str:
        """First digits of the SHA-256 of its weights: a policy that learned on is another."""
        arrays = (array for layer in self.layers for array in layer)
        return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()[:8]

    @property
    def activations(self) -> list[str]:
        """The activation of each hidden layer."""
        names = self.activation.split()
        return names * (len(self.layers) - 1) if len(names) == 1 else names

    def reset(self, seed: int) -> None:
        """Begin an episode: forget where the car was. The policy is deterministic."""
        self._observer.begin()

    def act(self, reading: Reading) -> Command:
        """Return the policy's command, at a reading of each control step.

        Raises:
            PolicyError: the reading has another number of bearings than the policy was trained with.
        """
        if len(reading.clearance.obs_m) != self.observation.n_rays:
            raise PolicyError(
                f"policy {self.name!r} expects {self.observation.n_rays} bearings, the reading has "
                f"{len(reading.clearance.obs_m)}; use the robot and safety region it was trained with"
            )
        observation = self._observer.observe(reading)
        if self.head == "argmax":
            return self.observation.decode_discrete(int(self.output(observation).argmax()))
        return self.observation.decode(self.action(observation))

    def action(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the (2,) float32 action in [-1, 1] for an encoded observation, or (N, 2) for (N, size) of them."""
        output = self.output(observation)
        if self.head == "argmax":
            return np.array(DISCRETE_COMMANDS, dtype=np.float32)[output.argmax(axis=-1)]
        if self.head == "grid":
            speeds, steerings = self._choices
            speed, steering = output[..., : len(speeds)], output[..., len(speeds) :]
            return np.stack([speeds[speed.argmax(axis=-1)], steerings[steering.argmax(axis=-1)]], axis=-1)
        return np.tanh(output) if self.head == "tanh" else np.clip(output, -1.0, 1.0)

    def output(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return what the last layer gives, before the head, float32: (2,), or a number for each choice of the head.

        Many observations, (N, size), may be given at once; then N rows of outputs come back.
        """
        hidden = observation
        for (weight, bias), activation in zip(self.layers[:-1], self.activations, strict=True):
            hidden = ACTIVATIONS[activation](hidden @ weight.T + bias)
        weight, bias = self.layers[-1]
        return hidden @ weight.T + bias


def _check_activation(name: str, n_hidden: int, activation: str) -> None:
    names = activation.split()
    if unknown := set(names) - set(ACTIVATIONS):
        raise PolicyError(f"policy {name!r} has the activation {min(unknown)!r}; there are {', '.join(ACTIVATIONS)}")
    if len(names) not in (1, n_hidden):
        raise PolicyError(
            f"policy {name!r} has {n_hidden} hidden layers and the activations {activation!r}; name one, or one for "
            "each"
        )


def _check_head(name: str, n_outputs: int, head: str, grid: Grid) -> None:
    if head not in HEADS:
        raise PolicyError(f"policy {name!r} has the head {head!r}; there are {', '.join(HEADS)}")
    needed = {"argmax": len(DISCRETE_COMMANDS), "grid": sum(map(len, grid))}.get(head, 2)
    if head == "grid" and not (all(grid) and np.abs([*grid[0], *grid[1]]).max() <= 1.0):
        raise PolicyError(f"policy {name!r} chooses from {grid}; speeds and steerings are fractions of -1 to 1")
    if n_outputs != needed:
        raise PolicyError(f"policy {name!r} has {n_outputs} outputs, its head {head!r} needs {needed}; export it again")


def save_policy(agent: PolicyAgent, path: Path) -> None:
    """Write a policy as safetensors; the observation and the provenance travel as JSON in its header.

    Every command takes the file: `--agent PATH`, `zebrat export PATH`.

    Args:
        agent: the policy; of one that you trained yourself, `policy_of` and `policy_of_layers` make it.
        path: the file, which ends in .safetensors.
    """
    tensors = {}
    for i, (weight, bias) in enumerate(agent.layers):
        tensors[f"{i}.weight"], tensors[f"{i}.bias"] = np.ascontiguousarray(weight), np.ascontiguousarray(bias)
    header = {
        "format": FORMAT,
        "observation": json.dumps(asdict(agent.observation)),
        "provenance": json.dumps(agent.provenance),
        "head": agent.head,
        "activation": agent.activation,
        "grid": json.dumps(agent.grid),
    }
    write_safetensors(path, tensors, header)


def load_policy(name_or_path: str) -> PolicyAgent:
    """Load a shipped policy by name or a policy file by path.

    Raises:
        AssetError: there is no such policy.
        PolicyError: the file is not a policy of this package.
    """
    path = find_asset("policies", name_or_path, ".safetensors")
    if path.suffix == ".zip":
        raise PolicyError(
            f"{path} is a model of Stable-Baselines3, which does not say what it observes; name the best.safetensors "
            "beside it, or its run folder; one that you trained yourself becomes a policy by "
            "zebrat_bullet.training.own_policy.policy_of (docs/your_own_policy.md)"
        )
    header, tensors = read_safetensors(path, PolicyError)
    if header.get("format") != FORMAT:
        raise PolicyError(f"{path} has format {header.get('format')!r}, expected {FORMAT!r}; was it exported by us?")
    with refusing(path, PolicyError, "is no policy of this package", "export it again with `zebrat train`"):
        layers = _layers(tensors)
        observation = from_json(ObservationSpec, header["observation"])
        provenance = parse_json(header["provenance"], path, PolicyError)
        if not isinstance(provenance, dict):
            raise ValueError("its provenance is no mapping")
        if observation.size != layers[0][0].shape[1]:
            raise ValueError(f"it observes {observation.size} numbers, its first layer takes {layers[0][0].shape[1]}")
        # Files from before there was a choice name neither.
        head, activation = header.get("head", "tanh"), header.get("activation", "relu")
        grid = TypeAdapter(Grid).validate_json(header.get("grid", "[[], []]"))
        return PolicyAgent(Path(path).stem, layers, observation, provenance, head, activation, grid)


def _layers(tensors: Mapping[str, NDArray]) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Return the layers, each fitting to the one before it."""
    n = len(tensors) // 2
    names = [f"{i}.{part}" for i in range(n) for part in ("weight", "bias")]
    if n == 0 or tensors.keys() != set(names):
        raise ValueError(f"its tensors are {shown(sorted(tensors))}, not weight and bias of each layer, 0.weight on")
    for name, array in tensors.items():
        if array.dtype != np.float32 or not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite float32 numbers, it is {array.dtype}")
    layers = [(tensors[f"{i}.weight"], tensors[f"{i}.bias"]) for i in range(n)]
    for i, (weight, bias) in enumerate(layers):
        n_in = len(layers[i - 1][1]) if i else weight.shape[-1]
        if bias.ndim != 1 or weight.shape != (len(bias), n_in) or not weight.size:
            raise ValueError(f"layer {i} has weights of shape {weight.shape} and biases of shape {bias.shape}")
    return layers
