"""Checkpoints of a training run, replaced as a whole: networks, optimizers, replay buffer and every random state.

They hold tensors (safetensors), arrays (.npz) and JSON; nothing is unpickled, so one from elsewhere runs no code.
"""

import json
import random
import shutil
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.files import MB, read_json, read_npz, read_safetensors, refusing, write_safetensors
from zebrat_bullet.training.ddpg import PaperDDPG
from zebrat_bullet.training.tensors import put_tensors, tensors_of

NETWORKS, ARRAYS, STATE = "networks.safetensors", "arrays.npz", "state.json"
_COUNTERS = (
    *("num_timesteps", "_episode_num", "_n_updates", "_n_calls"),
    *("_current_progress_remaining", "exploration_rate", "share_done"),
)
_REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_LAST = ("_last_obs", "_last_episode_starts")
_MOST_COUNT = 2**53
_MT19937_WORDS = 624


def save_checkpoint(
    folder: Path, model: BaseAlgorithm, state: dict[str, Any], arrays: Mapping[str, NDArray] | None = None
) -> None:
    """Write a checkpoint beside the last one and put it in its place only when it is complete.

    Args:
        folder: the checkpoint.
        model: the learner.
        state: what else to keep, as JSON.
        arrays: and what of it are arrays.
    """
    part, old = folder.with_suffix(".part"), folder.with_suffix(".old")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    write_safetensors(part / NETWORKS, {name: tensor.detach().numpy() for name, tensor in tensors_of(model).items()})
    kept = {"torch_rng": torch.get_rng_state().numpy()} | {
        f"env/{name}": array for name, array in (arrays or {}).items()
    }
    kept |= {f"learner/{name}": getattr(model, name) for name in _LAST if getattr(model, name) is not None}
    learner: dict[str, Any] = {name: getattr(model, name) for name in _COUNTERS if hasattr(model, name)}
    learner["episodes"] = list(model.ep_info_buffer or ())
    if isinstance(model, OffPolicyAlgorithm):
        buffer = _replay(model)
        learner["replay"] = {"pos": buffer.pos, "full": buffer.full}
        kept |= {f"replay/{name}": getattr(buffer, name)[: buffer.size()] for name in _REPLAY}
    np.savez(part / ARRAYS, **kept)  # type: ignore[arg-type]
    (part / STATE).write_text(
        json.dumps(state | {"learner": learner, "randomness": _randomness(model)}), encoding="utf-8"
    )
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    part.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def load_checkpoint(folder: Path, model: BaseAlgorithm) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Put an untrained learner where that of the last complete checkpoint stood, and restore the random states.

    The learner goes on from its last observation; the environments must be put back there.

    Args:
        folder: the checkpoint.
        model: a learner of the same settings.

    Returns:
        The state and the arrays that were saved with it.

    Raises:
        ZebratError: there is none, or it is damaged, or not of such a learner.
    """
    if not folder.exists():
        folder = folder.with_suffix(".old")  # killed between the two renames
    if not folder.exists():
        raise ZebratError(
            f"nothing to resume in {folder.parent}: no checkpoint was written yet; begin it anew in another folder"
        )
    if (folder / "model.zip").exists():
        raise ZebratError(
            f"{folder} holds pickles, as earlier versions wrote them, which could run code; begin anew in another "
            "folder, from its best networks with init=.../best.zip"
        )
    most = 256 * MB
    if isinstance(model, OffPolicyAlgorithm):
        most += sum(getattr(_replay(model), name).nbytes for name in _REPLAY)
    with refusing(folder, ZebratError, "is no whole checkpoint of this run", "begin the run anew in another folder"):
        for name in (STATE, ARRAYS, NETWORKS):
            (folder / name).stat()  # says itself that there is none
        state = read_json(folder / STATE, ZebratError)
        arrays = read_npz(folder / ARRAYS, ZebratError, most)
        learner, randomness = state.pop("learner"), state.pop("randomness")
        networks = read_safetensors(folder / NETWORKS, ZebratError, 4000 * MB)[1]
        put_tensors(model, {name: torch.from_numpy(array.copy()) for name, array in networks.items()})
        _restore_learner(model, learner, arrays)
        _restore_randomness(model, randomness, arrays["torch_rng"])
        return state, {name.removeprefix("env/"): array for name, array in arrays.items() if name.startswith("env/")}


def _replay(model: OffPolicyAlgorithm) -> ReplayBuffer:
    assert model.replay_buffer is not None  # SB3 makes it with the learner
    return model.replay_buffer


def _restore_learner(model: BaseAlgorithm, learner: dict[str, Any], arrays: dict[str, NDArray]) -> None:
    for name in _COUNTERS:
        if hasattr(model, name):
            value = learner[name]
            if not isinstance(value, int | float) or not 0 <= value < _MOST_COUNT:
                raise ValueError(f"{name} is {value!r}")
            setattr(model, name, type(getattr(model, name))(value))
    model.ep_info_buffer = deque(
        ({"r": float(of["r"]), "l": int(of["l"]), "t": float(of.get("t", 0.0))} for of in learner["episodes"]),
        maxlen=model._stats_window_size,
    )
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)
    shape = (model.n_envs, *(model.observation_space.shape or ()))
    for name, expected in zip(_LAST, (shape, shape[:1]), strict=True):
        if f"learner/{name}" in arrays:
            setattr(model, name, _fitting(arrays, f"learner/{name}", expected))
    if isinstance(model, OffPolicyAlgorithm):
        buffer, pos, full = _replay(model), int(learner["replay"]["pos"]), bool(learner["replay"]["full"])
        if not 0 <= pos < buffer.buffer_size:
            raise ValueError(f"the replay buffer's place is {pos}")
        buffer.pos, buffer.full = pos, full
        for name in _REPLAY:
            target = getattr(buffer, name)[: buffer.size()]
            target[:] = _fitting(arrays, f"replay/{name}", target.shape)


def _fitting(arrays: dict[str, NDArray], name: str, shape: tuple[int, ...]) -> NDArray:
    array = arrays[name]
    if array.shape != shape or array.dtype.kind not in "biuf" or not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite numbers of shape {shape}, got {array.dtype} of shape {array.shape}")
    return array


def _randomness(model: BaseAlgorithm) -> dict[str, Any]:
    name, keys, *rest = np.random.get_state(legacy=True)
    return {
        "python": random.getstate(),
        "numpy": [name, np.asarray(keys).tolist(), *rest],
        "actions": model.action_space.np_random.bit_generator.state,
        "exploration": model.rng.bit_generator.state if isinstance(model, PaperDDPG) else None,
    }


def _restore_randomness(model: BaseAlgorithm, randomness: dict[str, Any], torch_rng: NDArray) -> None:
    version, internal, gauss = randomness["python"]
    random.setstate((version, tuple(internal), gauss))
    if not 0 <= randomness["numpy"][2] <= _MT19937_WORDS:  # NumPy would read beyond its state
        raise ValueError("the state of NumPy's generator is none")
    np.random.set_state(tuple(randomness["numpy"]))
    model.action_space.np_random.bit_generator.state = randomness["actions"]
    if isinstance(model, PaperDDPG):
        model.rng.bit_generator.state = randomness["exploration"]
    torch.set_rng_state(torch.from_numpy(torch_rng))
