"""Point clouds to Open3D, to look at and to save."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.types import PointCloud

if TYPE_CHECKING:  # Open3D takes seconds to load, and only these two functions need it
    import open3d as o3d

CLOUD_SUFFIXES = (".ply", ".pcd")


def to_open3d(cloud: PointCloud) -> "o3d.geometry.PointCloud":
    """Return the returns of a cloud (rays without one left out) for `open3d.visualization.draw_geometries`."""
    import open3d as o3d

    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points_lidar[cloud.valid].astype(np.float64)))


def save_cloud(cloud: PointCloud, path: str | Path) -> None:
    """Write the returns of a cloud, in m in the lidar frame, as .ply or .pcd.

    Raises:
        ConfigError: another suffix.
        OSError: the file cannot be written.
    """
    import open3d as o3d

    path = Path(path)
    if path.suffix not in CLOUD_SUFFIXES:
        raise ConfigError(f"a cloud is saved as {' or '.join(CLOUD_SUFFIXES)}, got {path.name!r}")
    if not o3d.io.write_point_cloud(str(path), to_open3d(cloud)):  # type: ignore[arg-type]  # its stub lacks str
        raise OSError(f"cannot write {path}; does its folder exist, and may you write there?")
