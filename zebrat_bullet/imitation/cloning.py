"""Behaviour cloning: a network learns by mean squared error to command what a demonstrator commanded."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.config import within
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.imitation.demonstrations import Pairs
from zebrat_bullet.task.observation import ObservationSpec


@dataclass(frozen=True, kw_only=True)
class CloneConfig:
    """How a network is fitted to demonstrations; network and input are the paper's imitation learning.

    Attributes:
        hidden: units of each hidden layer.
        last_command: also see the last command, not the ranges alone. Off, as in the paper: what a driver does next is
            mostly what it did last, and a network that sees this learns to repeat itself.
        log_gaps: also see the logarithms of the gaps, as the policies of this package do. Off, as in the paper.
        epochs: passes over the training pairs.
        batch_size, lr: of Adam.
        held_out: share of the episodes kept from training; the epoch that does best on them is returned.
        threads: torch threads; another number may round differently.
    """

    hidden: tuple[int, ...] = (512, 512)
    last_command: bool = False
    log_gaps: bool = False
    epochs: int = 20
    batch_size: int = 64
    lr: float = 3e-4
    held_out: float = 0.1
    threads: int = 1

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch_size < 1 or self.threads < 1:
            raise ConfigError("epochs, batch_size and threads must be at least 1")
        if self.lr <= 0:
            raise ConfigError(f"lr must be above 0, got {self.lr}")
        if not 0 < self.held_out < 1:
            raise ConfigError(f"held_out is a share of the episodes in (0, 1), got {self.held_out}")
        within(self, hidden=(1, 8192), epochs=(1, 10**6), batch_size=(1, 10**7), lr=(0.0, 1000.0), threads=(1, 256))


@dataclass(frozen=True, slots=True)
class Clone:
    """A fitted policy, with the (epochs, 2) mean squared errors on training and held-out pairs after each epoch."""

    agent: PolicyAgent
    losses: NDArray[np.float64]

    @property
    def best_epoch(self) -> int:
        """The epoch, from 0, whose weights the policy has."""
        return int(self.losses[:, 1].argmin())


def clone(
    pairs: Pairs, observation: ObservationSpec, config: CloneConfig, seed: int, provenance: dict[str, object]
) -> Clone:
    """Fit a policy to pairs; the same pairs, settings and seed give the same weights.

    Args:
        pairs: what was seen and done.
        observation: how it was encoded.
        config: the fit.
        seed: of the weights, the held-out episodes and the batches.
        provenance: what the policy says of its origin.

    Raises:
        ConfigError: there are fewer than two episodes, so none can be held out.
    """
    torch.set_num_threads(config.threads)
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    held_out = _held_out(pairs, config.held_out, rng)
    n_inputs = observation.size if config.last_command else observation.size - 2  # it comes last
    inputs, targets = torch.from_numpy(pairs.observations[:, :n_inputs]), torch.from_numpy(pairs.actions)
    train, test = np.flatnonzero(~held_out), np.flatnonzero(held_out)
    network = _network(n_inputs, config.hidden)
    optimizer = torch.optim.Adam(network.parameters(), lr=config.lr)
    losses: list[tuple[float, float]] = []
    for _ in range(config.epochs):
        total = 0.0
        for batch in np.array_split(rng.permutation(train), -(-len(train) // config.batch_size)):
            loss = nn.functional.mse_loss(network(inputs[batch]), targets[batch])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += loss.item() * len(batch)
        with torch.no_grad():
            test_loss = nn.functional.mse_loss(network(inputs[test]), targets[test]).item()
        losses.append((total / len(train), test_loss))
        if test_loss <= min(loss for _, loss in losses):
            layers = _layers(network, observation.size)
    return Clone(PolicyAgent("clone", layers, observation, provenance), np.array(losses))


def _held_out(pairs: Pairs, share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which pairs are held out: whole episodes, for neighbours in one episode are near copies."""
    episodes = np.unique(pairs.episode)
    if len(episodes) < 2:
        raise ConfigError(f"imitation holds out whole episodes and got {len(episodes)}; record at least two")
    n = min(max(1, round(share * len(episodes))), len(episodes) - 1)
    return np.isin(pairs.episode, rng.permutation(episodes)[:n])


def _network(n_inputs: int, hidden: tuple[int, ...]) -> nn.Sequential:
    sizes = (n_inputs, *hidden)
    modules: list[nn.Module] = []
    for n_in, n_out in pairwise(sizes):
        modules += [nn.Linear(n_in, n_out), nn.ReLU()]
    return nn.Sequential(*modules, nn.Linear(sizes[-1], 2), nn.Tanh())


def _layers(network: nn.Sequential, size: int) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Return copies of the layers; weights of inputs that the network does not have, the last command's, are zero."""
    linear = [module for module in network if isinstance(module, nn.Linear)]
    layers = [(layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in linear]
    weight, bias = layers[0]
    return [(np.pad(weight, ((0, 0), (0, size - weight.shape[1]))), bias), *layers[1:]]
