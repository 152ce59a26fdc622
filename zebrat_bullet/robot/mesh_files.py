"""Where the meshes that a URDF names are, and in which unit they are written."""

import math
import os
import re
from collections.abc import Iterator
from pathlib import Path

from zebrat_bullet.errors import RobotError
from zebrat_bullet.files import MB, is_file, read_bytes

_COLLADA_HEAD_BYTES = 65536


def collada_unit_m(file: Path) -> float:
    """Return the unit in m that a COLLADA file says it is written in; 1 where it says none."""
    with file.open("rb") as stream:
        match = re.search(rb"""<unit\b[^>]*\bmeter\s*=\s*["']([^"']*)["']""", stream.read(_COLLADA_HEAD_BYTES))
    try:
        unit_m = float(match[1]) if match else 1.0
    except ValueError:
        return 1.0
    return unit_m if 0.0 < unit_m < math.inf else 1.0


def mesh_file(urdf: Path, name: str) -> Path | None:
    """Return the file of a mesh that a URDF names: relative to it, `file://`, or `package://NAME/...`; None if missing.

    A package is a folder of its name, or one whose package.xml says it, at or beside the URDF's own folder or one
    above it, or where ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and CMAKE_PREFIX_PATH point.
    """
    if name.startswith(("package://", "model://")):
        package, _, inside = name.partition("://")[2].partition("/")
        tried: Iterator[Path] = (folder / inside for folder in _package_folders(urdf, package))
    else:
        tried = iter([urdf.parent / re.sub(r"^file://(localhost)?", "", name)])
    return next((file.resolve() for file in tried if is_file(file)), None)


def _package_folders(urdf: Path, package: str) -> Iterator[Path]:
    for folder in urdf.parents:
        if folder.name == package or _package_name(folder) == package:
            yield folder
        yield folder / package
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"):
        for folder in map(Path, filter(None, os.environ.get(variable, "").split(os.pathsep))):
            yield from (folder / package, folder / "share" / package)


def _package_name(folder: Path) -> str | None:
    file = folder / "package.xml"
    if not is_file(file):
        return None
    match = re.search(rb"<name>\s*([\w.-]+)\s*</name>", read_bytes(file, RobotError, MB))
    return match[1].decode() if match else None
