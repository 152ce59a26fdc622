"""The kernels compile for a GPU, also on a machine that has none: Warp brings the compiler."""

from pathlib import Path

import pytest
import warp as wp

from zebrat_bullet.planar import kernels


@pytest.mark.parametrize("arch", [80, 90])
def test_the_kernels_compile_for_cuda(tmp_path: Path, arch: int) -> None:
    wp.init()
    (made,) = wp.compile_aot_module(kernels, arch=arch, module_dir=tmp_path, use_ptx=True)
    ptx = Path(made).read_text()
    assert f".target sm_{arch}" in ptx
    for name in ("drive", "look"):
        assert f".entry {name}_" in ptx
