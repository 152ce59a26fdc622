"""All that learning changes in a learner, as tensors by name: out of it, and back into an untrained one."""

import io
import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import recursive_getattr
from torch import Tensor, nn
from torch.nn.functional import pad

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import open_zip, refusing

_MOMENTS = {"step", "exp_avg", "exp_avg_sq"}


def tensors_of(model: BaseAlgorithm) -> dict[str, Tensor]:
    """Return weights, moments of the optimizers and lone variables; learning rates follow the run's schedules."""
    found = {name: recursive_getattr(model, name).data for name in _names(model)[1]}
    for part, state in model.get_parameters().items():
        found |= {f"{part}/{name}": tensor for name, tensor in _flat(state).items()}
    return found


def put_tensors(model: BaseAlgorithm, tensors: Mapping[str, Tensor]) -> None:
    """Put the tensors of a like learner into this one; lone variables that are not among them stay.

    Raises:
        ValueError, KeyError, RuntimeError: they are not those of such a learner.
    """
    if not all(tensor.is_floating_point() and tensor.isfinite().all() for tensor in tensors.values()):
        raise ValueError("a weight is not a finite number")
    parts, alone = _names(model)
    for name in alone:
        if name in tensors:
            variable = recursive_getattr(model, name)
            variable.data.copy_(tensors[name].reshape(variable.shape))
    for part in parts:
        inside = {name.removeprefix(f"{part}/"): at for name, at in tensors.items() if name.startswith(f"{part}/")}
        target = recursive_getattr(model, part)
        if isinstance(target, torch.optim.Optimizer):
            _put_moments(target, inside)
        else:
            target.load_state_dict(inside)


def begin_with(model: BaseAlgorithm, path: Path, n_new: int = 0) -> None:
    """Give a learner the networks and optimizers in an SB3 zip; what is pickled in there stays shut.

    Args:
        model: the learner.
        path: the zip.
        n_new: so many numbers at the end of an observation the networks in the zip may not have known: their weights
            begin at 0, so the policy does at first as it did.

    Raises:
        ConfigError: the file is no such zip, or holds other networks; the message names it.
    """
    what = "holds other networks than the settings of this run name"
    with open_zip(path, ConfigError) as archive, refusing(path, ConfigError, what, "name a zip of such a run"):
        tensors: dict[str, Tensor] = {}
        for part in _names(model)[0]:
            data = archive.read(f"{part}.pth")
            with refusing(path, ConfigError, f"its {part}.pth cannot be read", "copy it again, or name another zip"):
                state = _flat(_load_weights(data))
            target = recursive_getattr(model, part)
            state = _widened(state, target, n_new)
            _check_networks(path, part, target, state)
            tensors |= {f"{part}/{name}": tensor for name, tensor in state.items()}
        put_tensors(model, tensors)


def _widened(state: Mapping[str, Tensor], target: Any, n_new: int) -> dict[str, Tensor]:
    """Return the tensors of a part, with `n_new` columns of 0 behind those that lack as many."""
    if isinstance(target, torch.optim.Optimizer):
        shapes = {f"{i}/{moment}": at.shape for i, at in enumerate(_parameters(target)) for moment in _MOMENTS}
    else:
        shapes = {name: at.shape for name, at in target.state_dict().items()}
    wider = {
        name: pad(at, (0, n_new))
        for name, at in state.items()
        if at.ndim == 2 and shapes.get(name) == (at.shape[0], at.shape[1] + n_new)
    }
    return {**state, **wider}


def _check_networks(path: Path, part: str, target: Any, state: Mapping[str, Any]) -> None:
    """Refuse weights of other networks: of a car with other bearings, an other observation, or other layers."""
    if isinstance(target, torch.optim.Optimizer):
        return
    ours = {name: tuple(tensor.shape) for name, tensor in target.state_dict().items()}
    theirs = {name: tuple(getattr(tensor, "shape", ())) for name, tensor in state.items()}
    differing = [name for name in ours if ours[name] != theirs.get(name)] or sorted(theirs.keys() - ours.keys())
    if differing:
        name = differing[0]
        raise ConfigError(
            f"{path}: holds other networks than the settings of this run name: {part}.{name} is "
            f"{theirs.get(name, 'absent')}, here {ours.get(name, 'absent')}; begin with a run of the same car, "
            "safety region, observation and `hidden`"
        )


def _names(model: BaseAlgorithm) -> tuple[list[str], list[str]]:
    return model._get_torch_save_params()


def _flat(state: Mapping[str, Any]) -> dict[str, Tensor]:
    """Return the tensors in the state of a module, or of an optimizer as PARAMETER/MOMENT."""
    if "param_groups" not in state:
        return dict(state)
    return {f"{i}/{name}": tensor for i, moments in state["state"].items() for name, tensor in moments.items()}


def _parameters(optimizer: torch.optim.Optimizer) -> list[nn.Parameter]:
    return [parameter for group in optimizer.param_groups for parameter in group["params"]]


def _put_moments(optimizer: torch.optim.Optimizer, tensors: Mapping[str, Tensor]) -> None:
    parameters = _parameters(optimizer)
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        i, _, moment = name.partition("/")
        # The fused step trusts its moments to be as large as the weights.
        if tensor.shape != (() if moment == "step" else parameters[int(i)].shape) or tensor.dtype != torch.float32:
            raise ValueError(f"the moment {name} of an optimizer has another shape than its weights")
        state.setdefault(int(i), {})[moment] = tensor
    if state and (state.keys() != set(range(len(parameters))) or any(m.keys() != _MOMENTS for m in state.values())):
        raise ValueError("moments of an optimizer are missing")
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _load_weights(data: bytes) -> Mapping[str, Any]:
    with zipfile.ZipFile(io.BytesIO(data)) as inner:  # torch stores its tensors as they are
        if sum(member.file_size for member in inner.infolist()) > len(data):
            raise ValueError("its weights unpack to more than they take")
    try:
        return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:  # torch would advise to let it run
        raise ValueError("it holds more than weights, which could run as a program and is not read") from error
