"""Policy files: what each head makes of the last layer, and that a file gives back what was saved."""

import json
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import save_file

from zebrat_bullet.agents.policy import PolicyAgent, load_policy, save_policy
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.files import read_safetensors, write_safetensors
from zebrat_bullet.task.observation import ObservationSpec
from zebrat_bullet.types import Clearance, Command, FlatScan, Reading

SPEC = ObservationSpec(n_rays=32, range_max_m=6.0, max_speed_mps=0.6, max_steering_rad=0.6)
FAR = Reading(
    FlatScan(np.full(360, 6.0, np.float32), 6.0),
    Clearance(np.full(32, 6.0, np.float32), np.zeros(32, np.float32), False),
    Command(0.0, 0.0),
    0.0,
    0.0,
)


GRID = ((-1.0, 0.5), (-1.0, 0.0, 0.25, 1.0))


def policy(outputs: list[float], head: str = "tanh", activation: str = "relu") -> PolicyAgent:
    """Return a policy whose hidden units are -0.5 and 0.5 and whose outputs are (second unit / 0.5) * `outputs`."""
    hidden = np.zeros((2, 34), np.float32), np.array([-0.5, 0.5], np.float32)
    last = np.zeros((len(outputs), 2), np.float32)
    last[:, 1] = 2.0 * np.array(outputs, np.float32)
    layers, grid = [hidden, (last, np.zeros(len(outputs), np.float32))], GRID if head == "grid" else ((), ())
    return PolicyAgent("made", layers, SPEC, {"seed": 3}, head, activation, grid)


def test_a_tanh_head_squashes_and_a_clip_head_cuts_off():
    assert policy([0.5, -2.0]).act(FAR) == Command(
        pytest.approx(0.6 * np.tanh(0.5)), pytest.approx(0.6 * np.tanh(-2.0))
    )
    assert policy([0.5, -2.0], "clip").act(FAR) == Command(pytest.approx(0.3), pytest.approx(-0.6))


def test_an_argmax_head_names_one_of_the_six_commands():
    agent = policy([0.0, 0.1, 0.2, 0.3, 0.4, 0.5], "argmax")
    assert agent.act(FAR) == Command(0.6, 0.6)
    assert agent.action(SPEC.encode(FAR)).tolist() == [1.0, 1.0]
    assert policy([9.0, 0.1, 0.2, 0.3, 0.4, 0.5], "argmax").act(FAR) == Command(-0.6, -0.6)


def test_a_grid_head_chooses_speed_and_steering_each_by_itself():
    agent = policy([0.1, 0.3, 0.2, 0.1, 0.5, 0.4], "grid")
    assert agent.act(FAR) == Command(pytest.approx(0.3), pytest.approx(0.15))
    assert policy([0.3, 0.1, 0.2, 0.1, 0.3, 0.4], "grid").act(FAR) == Command(pytest.approx(-0.6), pytest.approx(0.6))
    many = agent.action(np.stack([SPEC.encode(FAR)] * 3))
    assert many.tolist() == [[0.5, 0.25]] * 3


def test_hidden_layers_are_rectified_squashed_or_cut_off():
    observation = SPEC.encode(FAR)
    agent = policy([1.0, 1.0], "clip")
    agent.layers[1][0][:] = np.eye(2)
    assert agent.output(observation).tolist() == [0.0, 0.5]
    agent.activation = "tanh"
    assert agent.output(observation) == pytest.approx(np.tanh([-0.5, 0.5]))
    agent.activation = "elu"
    assert agent.output(observation) == pytest.approx([np.exp(-0.5) - 1.0, 0.5])
    agent.activation = "clip"
    agent.layers[0][1][:] = [-0.5, 3.0]
    assert agent.output(observation).tolist() == [-0.5, 1.0]


@pytest.mark.parametrize("head", ["tanh", "clip", "argmax", "grid"])
@pytest.mark.parametrize("activation", ["relu", "tanh", "elu", "clip"])
def test_a_file_gives_back_the_policy(tmp_path, head, activation):
    agent = policy(list(np.linspace(0.1, 0.6, 6 if head in ("argmax", "grid") else 2)), head, activation)
    save_policy(agent, tmp_path / "p.safetensors")
    loaded = load_policy(str(tmp_path / "p.safetensors"))
    assert (loaded.head, loaded.activation, loaded.observation) == (head, activation, SPEC)
    assert loaded.grid == agent.grid
    assert loaded.act(FAR) == agent.act(FAR) and loaded.provenance == {"seed": 3}


def test_a_file_that_names_no_head_has_a_tanh_head_and_rectified_layers(tmp_path):
    agent = policy([0.5, -2.0])
    (w0, b0), (w1, b1) = agent.layers
    tensors = {"0.weight": w0, "0.bias": b0, "1.weight": w1, "1.bias": b1}
    spec = {"n_rays": 32, "range_max_m": 6.0, "max_speed_mps": 0.6, "max_steering_rad": 0.6, "raw": False}
    header = {"format": "zebrat-policy-1", "observation": json.dumps(spec), "provenance": "{}"}
    save_file(tensors, tmp_path / "old.safetensors", metadata=header)
    loaded = load_policy(str(tmp_path / "old.safetensors"))
    assert (loaded.head, loaded.activation) == ("tanh", "relu")
    assert loaded.act(FAR) == agent.act(FAR)


@pytest.mark.parametrize("name", ["shipped", "fomt"])
def test_a_shipped_policy_is_unguided_and_acts_as_its_layers_say(name):
    agent = load_policy(name)
    ranges = agent.observation.gap_ranges_m
    assert agent.observation == replace(SPEC, gap_ranges_m=ranges) and agent.privileged == frozenset()
    assert (agent.head, agent.activation) == ("clip", "tanh")
    hidden = observation = np.random.default_rng(0).uniform(-1.0, 1.0, agent.observation.size).astype(np.float32)
    for weight, bias in agent.layers[:-1]:
        hidden = np.tanh(weight @ hidden + bias)
    weight, bias = agent.layers[-1]
    np.testing.assert_allclose(agent.action(observation), np.clip(weight @ hidden + bias, -1.0, 1.0), atol=1e-6)


@pytest.mark.parametrize(
    ("outputs", "head", "activation", "message"),
    [
        (2, "softmax", "relu", "head 'softmax'; there are tanh, clip, argmax"),
        (2, "tanh", "gelu", "activation 'gelu'; there are relu, tanh, elu, clip"),
        (2, "tanh", "clip tanh", "1 hidden layers and the activations 'clip tanh'; name one, or one for each"),
        (2, "argmax", "relu", "2 outputs, its head 'argmax' needs 6"),
        (5, "grid", "relu", "5 outputs, its head 'grid' needs 6"),
        (6, "tanh", "relu", "6 outputs, its head 'tanh' needs 2"),
    ],
)
def test_a_policy_of_another_kind_is_refused(outputs, head, activation, message):
    with pytest.raises(PolicyError, match=message):
        policy([0.0] * outputs, head, activation)


def test_arrays_are_written_as_they_are_however_they_lie_in_memory(tmp_path):
    lying = {"turned": np.arange(6.0, dtype=np.float32).reshape(2, 3).T, "number": np.array(3.0, np.float32)}
    write_safetensors(tmp_path / "x.safetensors", lying, {"a": "b"})
    texts, read = read_safetensors(tmp_path / "x.safetensors", PolicyError)
    assert texts == {"a": "b"} and read["number"].shape == ()
    assert np.array_equal(read["turned"], lying["turned"]) and float(read["number"]) == 3.0
