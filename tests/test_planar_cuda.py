"""The kernels compile for a GPU, also on a machine that has none: Warp brings the compiler."""

from pathlib import Path

import pytest
import warp as wp

from zebrat_bullet.planar.kernels.drive import make_drive
from zebrat_bullet.planar.kernels.look import look


@pytest.mark.parametrize("arch", [80, 90])
@pytest.mark.parametrize("kernel", [make_drive(1), look], ids=["drive", "look"])
def test_the_kernels_compile_for_cuda(tmp_path: Path, kernel: wp.Kernel, arch: int) -> None:
    wp.init()
    (made,) = wp.compile_aot_module(kernel.module, arch=arch, module_dir=tmp_path, use_ptx=True)
    ptx = Path(made).read_text(encoding="utf-8")
    assert f".target sm_{arch}" in ptx and f".entry {kernel.key}_" in ptx
