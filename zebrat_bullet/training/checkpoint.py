"""Checkpoints of a training run: networks, optimizers, replay buffer and every random state, replaced as a whole."""

import json
import random
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.training.ddpg import PaperDDPG


def save_checkpoint(folder: Path, model: PaperDDPG, state: dict[str, Any]) -> None:
    """Write a checkpoint beside the last one and put it in its place only when it is complete."""
    part, old = folder.with_suffix(".part"), folder.with_suffix(".old")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    model.save(part / "model.zip")
    model.save_replay_buffer(part / "replay.pkl")
    torch.save(torch.get_rng_state(), part / "torch_rng.pt")
    randomness = {"python": random.getstate(), "numpy": _numpy_state()}
    (part / "state.json").write_text(json.dumps(state | {"randomness": randomness}))
    shutil.rmtree(old, ignore_errors=True)
    if folder.exists():
        folder.rename(old)
    part.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def load_checkpoint(folder: Path, env: Any) -> tuple[PaperDDPG, dict[str, Any]]:
    """Return the learner and the state of the last complete checkpoint, and restore the random states.

    Raises:
        ZebratError: there is none.
    """
    if not folder.exists():
        folder = folder.with_suffix(".old")  # killed between the two renames
    if not folder.exists():
        raise ZebratError(f"nothing to resume in {folder.parent}: no checkpoint was written yet; start it anew")
    model = PaperDDPG.load(folder / "model.zip", env=env, device="cpu")
    model.load_replay_buffer(folder / "replay.pkl", truncate_last_traj=False)
    state = json.loads((folder / "state.json").read_text())
    randomness = state.pop("randomness")
    version, internal, gauss = randomness["python"]
    random.setstate((version, tuple(internal), gauss))
    np.random.set_state(tuple(randomness["numpy"]))
    torch.set_rng_state(torch.load(folder / "torch_rng.pt", weights_only=True))
    return model, state


def _numpy_state() -> list[Any]:
    name, keys, *rest = np.random.get_state(legacy=True)
    return [name, np.asarray(keys).tolist(), *rest]
