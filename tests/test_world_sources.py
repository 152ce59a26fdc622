"""A user's mesh file or ROS map becomes a world."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, load_world, world_summary
from zebrat_bullet.world.load import WorldNote
from zebrat_bullet.world.ros_map import read_ros_map
from zebrat_bullet.world.schema import StartSpec

MAP = """image: map.pgm
resolution: 0.05
origin: [-1.0, -2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def export(world: World, path: Path) -> Path:
    trimesh.Trimesh(world.mesh.vertices, world.mesh.faces, process=False).export(path)
    return path


def write_map(folder: Path, text: str = MAP) -> Path:
    """Write an 8 m x 4 m map with a wall 0.1 m thick at x = 5 and a white (free) rest."""
    cells = np.full((80, 160), 254, dtype=np.uint8)
    cells[:, 120:122] = 0
    cells[0, 0] = 205
    Image.fromarray(cells).save(folder / "map.pgm")
    (folder / "map.yaml").write_text(text, encoding="utf-8")
    return folder / "map.yaml"


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb"])
def test_a_mesh_file_has_the_walls_of_the_world_it_was_exported_from(suffix: str, tmp_path: Path) -> None:
    track = load_world("track_1")
    world = load_world(export(track, tmp_path / f"mine.{suffix}"), start=track.start.pose)
    assert world.walls.symmetric_difference(track.walls).area < 1e-2
    assert world.name == "mine" and world.open_line is None and world.centre_line.shape == (0, 2)
    assert world.waypoints.shape == (0, 2) and world.start.pose == track.start.pose
    assert not world.past_open_line(100.0, 100.0)
    assert world_summary(world)["length_m"] is None
    assert trimesh.Trimesh(world.mesh.vertices, world.mesh.faces, process=False).is_watertight


def test_a_hollow_solid_keeps_its_hollow(tmp_path: Path) -> None:
    ring = trimesh.creation.annulus(r_min=2.0, r_max=2.2, height=1.0, sections=64)
    ring.apply_translation([0, 0, 0.5])
    ring.export(tmp_path / "ring.stl")
    world = load_world(tmp_path / "ring.stl")
    assert world.walls.area == pytest.approx(np.pi * (2.2**2 - 2.0**2), rel=0.01)
    assert world.free_space.area == pytest.approx(np.pi * 2.0**2, rel=0.01)


def test_a_mesh_with_centre_line_and_exit_is_a_whole_track(tmp_path: Path) -> None:
    track = load_world("track_2")
    export(track, tmp_path / "walls.stl")
    corners = [[1.5, 0.0], *track.waypoints.tolist()]
    (tmp_path / "w.yaml").write_text(
        f"name: mine\nmesh: walls.stl\nstart: {{pose: [1.5, 0, 0]}}\ncentre_line: {corners}\n"
        f"open_line: {track.open_line.tolist()}\n",
        encoding="utf-8",
    )
    world = load_world(tmp_path / "w.yaml")
    assert np.allclose(world.open_line, track.open_line)
    assert world.past_open_line(*world.waypoints[-1]) and not world.past_open_line(1.5, 0.0)
    assert world.free_space.area == pytest.approx(track.free_space.area, rel=0.01)
    assert world.widths_m.min() == pytest.approx(1.35, abs=0.02)
    assert world_summary(world)["turns_deg"] == [-90, 90, 45, -45]


def test_an_open_mesh_is_refused(tmp_path: Path) -> None:
    box = trimesh.creation.box([0.2, 2.0, 1.0], transform=trimesh.transformations.translation_matrix([3, 0, 0.5]))
    box.update_faces(np.arange(len(box.faces)) != 0)
    box.export(tmp_path / "open.stl")
    with pytest.raises(WorldError, match=r"open\.stl: mesh: not watertight.*close its holes"):
        load_world(tmp_path / "open.stl")


def test_a_start_inside_a_wall_of_a_mesh_is_refused(tmp_path: Path) -> None:
    path = export(load_world("track_1"), tmp_path / "mine.obj")
    with pytest.raises(WorldError, match=r"mine\.obj: start:.*move the start"):
        load_world(path, start=Pose2(0.0, 0.0, 0.0))


def test_the_occupied_cells_of_a_ros_map_become_walls(tmp_path: Path) -> None:
    world = load_world(write_map(tmp_path))
    # Column 120 begins 120 * 0.05 = 6 m right of the origin at x = -1.
    assert world.walls.bounds == pytest.approx((5.0, -2.0, 5.1, 2.0), abs=1e-3)
    assert world.walls.area == pytest.approx(0.4, rel=0.02)
    assert world.mesh.vertices[:, 2].max() == 1.0
    assert trimesh.Trimesh(world.mesh.vertices, world.mesh.faces, process=False).is_watertight


def test_the_yaw_of_a_ros_map_origin_turns_it_about_its_lower_left_cell(tmp_path: Path) -> None:
    turned = write_map(tmp_path, MAP.replace("0.0]", "1.5707963]"))
    world = load_world(turned, start=Pose2(-3.0, 0.0, 0.0))
    assert world.walls.bounds == pytest.approx((-5.0, 4.0, -1.0, 4.1), abs=1e-3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("0.0]", "90.0]"), "origin: the map is turned by 90 rad, as written; if degrees are meant, write 1.5708"),
        (("resolution: 0.05", "resolution: 5"), "resolution: a cell is 5 m wide, as written; 0.05 is usual"),
    ],
)
def test_an_implausible_number_of_a_ros_map_is_told(change: tuple[str, str], said: str, tmp_path: Path) -> None:
    read = read_ros_map(write_map(tmp_path, MAP.replace(*change)), 1.0, "free", StartSpec())
    assert read.notes == (said,)


def test_a_goal_off_the_map_is_told(tmp_path: Path) -> None:
    path = write_map(tmp_path)
    with pytest.warns(WorldNote, match=r"goal: \(60\.00, 1\.00\) lies 53\.0 m off what is shown \(x -1\.00 to 7\.00"):
        load_world(path, goal=(60.0, 1.0))
    assert not any("goal" in note for note in load_world(path, goal=(3.0, 1.0)).notes)


def test_cells_that_touch_at_a_corner_still_make_a_closed_mesh(tmp_path: Path) -> None:
    path = write_map(tmp_path)
    cells = np.full((80, 160), 254, dtype=np.uint8)
    cells[10:70, 60:64] = 0
    cells[6:10, 64:68] = 0
    # A ring of cells without its lower right one: the hollow touches the outside in a point.
    cells[30:33, 100:103] = 0
    cells[31, 101] = cells[32, 102] = 254
    Image.fromarray(cells).save(tmp_path / "map.pgm")
    world = load_world(path, start=Pose2(0.0, 0.0, 1.57))
    assert world.walls.area == pytest.approx(0.05**2 * (60 * 4 + 16 + 7), rel=0.01)
    assert trimesh.Trimesh(world.mesh.vertices, world.mesh.faces, process=False).is_watertight


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (("resolution: 0.05", "resolution: 0"), "resolution"),
        (("map.pgm", "none.pgm"), "image"),
        (("occupied_thresh: 0.65", "occupied_thresh: 1.0"), "occupied_thresh"),
    ],
)
def test_a_bad_ros_map_is_refused_with_file_and_field(change: tuple[str, str], field: str, tmp_path: Path) -> None:
    with pytest.raises(WorldError, match=field) as caught:
        load_world(write_map(tmp_path, MAP.replace(*change)))
    assert "map.yaml" in str(caught.value)
