"""The task of planar cars over torch tensors, as on a GPU: the same numbers as over NumPy arrays."""

import numpy as np
import pytest
import torch
import warp as wp

from zebrat_bullet.arrays import on_host
from zebrat_bullet.config import DynamicsConfig, NoiseConfig, ObservationConfig, RewardConfig, TaskConfig
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.planar.simulation import PlanarSimulation
from zebrat_bullet.world import load_world

N_CARS = 33
TASK = TaskConfig(
    noise=NoiseConfig(range_sigma_m=0.01, dropout=0.01),
    dynamics=DynamicsConfig(acceleration=(0.7, 1.3), delay_s=(0.0, 0.05)),
    observation=ObservationConfig(log_gaps=True, trail_steps=(1, 5, 12)),
    reward=RewardConfig(weights={"F": 1.0, "O": 1.0, "M": 1.0, "T": 1.0}),
)


@pytest.fixture
def drives(monkeypatch):
    worlds = [load_world("track_1"), load_world("track_2")]
    over_numpy = PlanarDrive(TASK, worlds, N_CARS, seed=0)
    monkeypatch.setattr(PlanarSimulation, "_view", lambda _, array: wp.to_torch(array))
    return over_numpy, PlanarDrive(TASK, worlds, N_CARS, seed=0)


def test_torch_tensors_get_the_numbers_of_numpy_arrays(drives):
    over_numpy, over_torch = drives
    rng, n_ended = np.random.default_rng(0), 0
    for _ in range(60):
        actions = rng.uniform(-1.0, 1.0, (N_CARS, 2)).astype(np.float32)
        expected, got = over_numpy.step(actions), over_torch.step(torch.as_tensor(actions))
        for name in ("observation", "reward", "outcome", "last_observation"):
            assert isinstance(getattr(got, name), torch.Tensor)
            np.testing.assert_allclose(on_host(getattr(got, name)), getattr(expected, name), atol=2e-5, err_msg=name)
        for name, term in expected.terms.items():
            np.testing.assert_allclose(on_host(got.terms[name]), term, atol=2e-5, err_msg=name)
        for name in ("ended", "world", "start"):
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
        n_ended += len(expected.ended)
    assert n_ended > 0


def test_a_state_goes_from_numpy_arrays_to_torch_tensors(drives):
    over_numpy, over_torch = drives
    over_numpy.step(np.ones((N_CARS, 2), dtype=np.float32))
    state = over_numpy.state()
    got, expected = over_torch.load(*state), over_numpy.load(*state)
    np.testing.assert_allclose(on_host(got), expected, atol=1e-6)
