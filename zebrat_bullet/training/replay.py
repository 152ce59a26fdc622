"""Replay that shows the learner each moment from both sides."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from zebrat_bullet.task.observation import ObservationSpec


class MirrorReplayBuffer(ReplayBuffer):
    """Replay of which half of each batch is seen mirrored left to right; scales the reward too."""

    def __init__(
        self, *args: Any, observation: ObservationSpec, mirror: bool, reward_scale: float, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.observation, self.mirror, self.reward_scale = observation, mirror, reward_scale

    def _get_samples(self, batch_inds: NDArray[np.int64], env: Any = None) -> ReplayBufferSamples:
        samples = super()._get_samples(batch_inds, env)
        half = len(batch_inds) // 2 if self.mirror else 0  # indices are drawn at random, so the first half is random
        if half:
            for observations in (samples.observations, samples.next_observations):
                observations[:half] = torch.from_numpy(self.observation.mirror(observations[:half].numpy()))
            samples.actions[:half, 1] *= -1.0
        return samples._replace(rewards=samples.rewards * self.reward_scale)
