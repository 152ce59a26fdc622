"""Compiles a planner's inner loops.

The result is kept on disk, and Numba finds it outdated when the file of the function has changed, not when another file
has from which that one takes functions or constants: a compiled function calls only functions of its own file.
"""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function, and keep the result where there is a place for it: beside its file or in the user's home."""
    try:
        return njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # read-only installation and no home
        return njit(error_model="numpy")(function)
