"""Observations as the networks of a learner see them: each number less its mean, over its deviation."""

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor

LEAST_DEVIATION = 0.02


class Standardise(BaseFeaturesExtractor):
    """(x - mean) / deviation; as it begins, nothing is changed. The two are fixed once and never learned."""

    mean: Tensor
    scale: Tensor

    def __init__(self, observation_space: spaces.Box) -> None:
        super().__init__(observation_space, observation_space.shape[0])
        self.register_buffer("mean", torch.zeros(observation_space.shape))
        self.register_buffer("scale", torch.ones(observation_space.shape))

    def fit(self, observations: NDArray[np.float32]) -> None:
        """Take mean and deviation from (n, size) observations."""
        self.mean.copy_(torch.from_numpy(observations.mean(axis=0)))
        self.scale.copy_(torch.from_numpy(1.0 / np.maximum(observations.std(axis=0), LEAST_DEVIATION)))

    def forward(self, observations: Tensor) -> Tensor:
        """Return (..., size) standardised observations."""
        return (observations - self.mean) * self.scale

    def fold(
        self, weight: NDArray[np.float32], bias: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the layer that does with plain observations what (weight, bias) does with standardised ones."""
        folded = weight * self.scale.numpy()
        return folded, bias - folded @ self.mean.numpy()
