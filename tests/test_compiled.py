"""Planners compile where the compiler's work can be kept and where it cannot."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from numba import njit

from zebrat_bullet.planning.compiled import compiled


def module_in(folder: Path) -> ModuleType:
    """Import a module with one function from a folder."""
    file = folder / "doubling.py"
    file.write_text("def doubled(x):\n    return 2.0 * x\n", encoding="utf-8")
    spec = importlib.util.spec_from_file_location("doubling", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_was_compiled_is_kept_beside_its_file(tmp_path: Path) -> None:
    assert compiled(module_in(tmp_path).doubled)(21.0) == 42.0
    assert list((tmp_path / "__pycache__").glob("doubling.doubled-*.nbc"))


def test_where_nothing_can_be_kept_functions_are_compiled_all_the_same(tmp_path: Path, monkeypatch) -> None:
    # Files where the folders would be, as a read-only installation without a home leaves none.
    for name in ("__pycache__", "home"):
        (tmp_path / name).touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    function = module_in(tmp_path).doubled
    with pytest.raises(RuntimeError, match="cannot cache function"):
        njit(cache=True)(function)
    assert compiled(function)(21.0) == 42.0
