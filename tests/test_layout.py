"""The package imports one way only, and heavy libraries only where they belong."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "zebrat_bullet"
ORDER = [
    *(
        "errors",
        "notes",
        "outputs",
        "files",
        "values",
        "arrays",
        "types",
        "config",
        "config_text",
        "geometry",
        "assets",
        "processes",
        "robot",
        "world",
        "planning",
        "sim",
        "sensing",
        "task",
        "planar",
        "deploy",
    ),
    *(
        "render",
        "envs",
        "agents",
        "evaluation",
        "detection",
        "training",
        "imitation",
        "comparison",
        "teleop",
        "play",
        "report",
    ),
    *("bench", "ros", "recording"),
    *("pytest_plugin", "cli", "__main__"),
]
ALLOWED = {
    "pybullet": {"sim", "sensing", "bench"},
    "mujoco": {"sim", "sensing"},
    "torch": {"training", "imitation", "agents", "bench"},
    "stable_baselines3": {"training", "agents", "bench"},
    "open3d": {"sensing"},
    "warp": {"planar"},
    "gymnasium": {"envs", "training"},
    **{name: {"recording"} for name in ("mcap", "mcap_ros2", "rosbags", "lz4", "zstandard")},
    **{
        name: {"ros"}
        for name in ("rclpy", "sensor_msgs", "geometry_msgs", "nav_msgs", "rosgraph_msgs", "ackermann_msgs")
    },
    "pyarrow": {"comparison"},
    "onnx": {"agents"},
    "onnxruntime": {"deploy"},
}
MODULES = sorted(PACKAGE.rglob("*.py"))


def stage(path: Path) -> str:
    relative = path.relative_to(PACKAGE)
    return relative.parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    return names


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_module_imports_only_what_stands_before_it(path):
    if path == PACKAGE / "__init__.py":
        return
    here = ORDER.index(stage(path))
    for name in imported(path):
        if name.startswith("zebrat_bullet."):
            other = name.split(".")[1]
            assert ORDER.index(other) <= here, f"{path} imports {name}, which stands after it"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_heavy_libraries_are_imported_only_where_they_belong(path):
    for name in imported(path):
        top = name.split(".")[0]
        if top in ALLOWED and path != PACKAGE / "__init__.py":
            assert stage(path) in ALLOWED[top], f"{path} imports {name}"


def test_importing_the_package_loads_nothing_heavy():
    code = (
        "import sys, zebrat_bullet; "
        "heavy = ('pybullet', 'mujoco', 'open3d', 'torch', 'stable_baselines3', 'vtk', 'matplotlib'); "
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_text_is_written_and_read_as_utf_8_whatever_the_locale(path):
    calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    for call in calls:
        if isinstance(call.func, ast.Attribute) and call.func.attr in ("write_text", "read_text"):
            assert any(word.arg == "encoding" for word in call.keywords), f"line {call.lineno} names no encoding"
