"""Checkpoints of a training run: networks, optimizers, replay buffer and every random state, replaced as a whole."""

import json
import random
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.training.learners import LEARNERS

ARRAYS = "arrays.npz"


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
    model.save(part / "model.zip")
    if isinstance(model, OffPolicyAlgorithm):
        model.save_replay_buffer(part / "replay.pkl")
    torch.save(torch.get_rng_state(), part / "torch_rng.pt")
    if arrays is not None:
        np.savez(part / ARRAYS, **arrays)  # type: ignore[arg-type]
    randomness = {
        "python": random.getstate(),
        "numpy": _numpy_state(),
        "actions": model.action_space.np_random.bit_generator.state,
    }
    (part / "state.json").write_text(json.dumps(state | {"randomness": randomness}))
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    part.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def load_checkpoint(folder: Path, algo: str, env: Any) -> tuple[BaseAlgorithm, dict[str, Any]]:
    """Return the learner and the state of the last complete checkpoint, and restore the random states.

    The learner goes on from its last observation; the environments must be put back there.

    Raises:
        ZebratError: there is none.
    """
    if not folder.exists():
        folder = folder.with_suffix(".old")  # killed between the two renames
    if not folder.exists():
        raise ZebratError(
            f"nothing to resume in {folder.parent}: no checkpoint was written yet; begin it anew in another folder"
        )
    model = LEARNERS[algo].load(folder / "model.zip", env=env, device="cpu", force_reset=False)
    if isinstance(model, OffPolicyAlgorithm):
        model.load_replay_buffer(folder / "replay.pkl", truncate_last_traj=False)
    state = json.loads((folder / "state.json").read_text())
    randomness = state.pop("randomness")
    version, internal, gauss = randomness["python"]
    random.setstate((version, tuple(internal), gauss))
    np.random.set_state(tuple(randomness["numpy"]))
    model.action_space.np_random.bit_generator.state = randomness["actions"]
    torch.set_rng_state(torch.load(folder / "torch_rng.pt", weights_only=True))
    return model, state


def load_arrays(folder: Path) -> dict[str, NDArray]:
    """Return the arrays of a checkpoint that `load_checkpoint` has found."""
    folder = folder if folder.exists() else folder.with_suffix(".old")
    with np.load(folder / ARRAYS, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _numpy_state() -> list[Any]:
    name, keys, *rest = np.random.get_state(legacy=True)
    return [name, np.asarray(keys).tolist(), *rest]
