"""Arithmetic on whatever holds the numbers: the array's own library, NumPy or torch, does it.

What is written over these arrays has a leading axis of cars, N of them; one car of PyBullet's is N = 1.
"""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = Any
"""A NumPy array, or a torch tensor on any device."""


def namespace(array: Array) -> ModuleType:
    """Return the library of an array, under the names of the array API standard."""
    if isinstance(array, np.ndarray):
        # NumPy 2 is its own; array_api_compat's wrappers about it would cost a single car half of its time here.
        return np
    import array_api_compat  # only what holds torch's arrays needs it: a car on the road has neither

    module: ModuleType = array_api_compat.array_namespace(array)
    return module


def device_of(array: Array) -> Any:
    """Return where an array is, as its library names it."""
    return "cpu" if isinstance(array, np.ndarray) else array.device


def like(values: NDArray, array: Array) -> Array:
    """Return constants in the library, on the device and, if they are floats, in the precision of an array."""
    if isinstance(array, np.ndarray):
        return values.astype(array.dtype, copy=False) if values.dtype.kind == "f" else values
    kept = {"dtype": array.dtype} if values.dtype.kind == "f" else {}
    # A copy: torch has no arrays that cannot be written to, and some constants are.
    return namespace(array).asarray(values, device=device_of(array), copy=True, **kept)


def clamp(array: Array, least: float | None = None, most: float | None = None) -> Array:
    """Return an array cut off at two bounds."""
    return namespace(array).clip(array, least, most)


def read_only(array: Array) -> Array:
    """Return an array that shows the same numbers and cannot be written to; of torch, which has none, a copy."""
    if not isinstance(array, np.ndarray):
        return array.clone()
    seen = array.view()
    seen.flags.writeable = False
    return seen


def is_refused_write(error: BaseException) -> bool:
    """Return whether an error is NumPy's about a write to an array that cannot be written to."""
    return isinstance(error, ValueError) and "read-only" in str(error)


def on_host(array: Array) -> NDArray:
    """Return an array as NumPy sees it: itself, or a copy of what is on another device."""
    host: NDArray = array if isinstance(array, np.ndarray) else array.cpu().numpy()
    return host
