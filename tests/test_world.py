"""What a world file becomes: one closed mesh, a centre line, widths, an exit; and the worlds that are shipped."""

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
import yaml
from PIL import Image

from zebrat_bullet.assets import asset_folder, list_assets
from zebrat_bullet.geometry import wall_segments
from zebrat_bullet.report.track_figure import draw_worlds
from zebrat_bullet.robot import load_robot
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import FAMILIES, World, generate_tracks, load_world, world_summary
from zebrat_bullet.world.solid import extrude
from zebrat_bullet.world.validate import open_width, start_area

NAMES = list_assets("worlds", ".yaml")
ROBOT = load_robot("zebrat")
CORNER = """
name: corner
segments:
  - {straight: 4.0, width: 1.5}
  - {turn: 90}
  - {straight: 3.0, width: 1.5}
"""


def write(folder: Path, text: str, name: str = "w.yaml") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


@pytest.fixture
def corner(tmp_path: Path) -> World:
    return load_world(write(tmp_path, CORNER))


def test_twelve_worlds_are_shipped() -> None:
    assert sorted(["big_track", *(f"track_{i}" for i in range(1, 9)), *(f"real_{i}" for i in range(1, 4))]) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_world_is_one_closed_outward_mesh_with_walls_above_the_blind_zone(name: str) -> None:
    world = load_world(name)
    body = trimesh.Trimesh(world.mesh.vertices, world.mesh.faces, process=False)
    assert body.is_watertight and body.is_winding_consistent and body.volume > 0
    assert world.mesh.faces.dtype == np.int32 and world.mesh.vertices.dtype == np.float64
    assert body.bounds[0, 2] == 0.0
    assert all(part.bounds[1, 2] >= 0.8 for part in body.split(only_watertight=False))
    assert world.name == name and world.description and len(world.low_obstacles.geoms) == 0


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_worlds_centre_line_widths_and_goal_fit_together(name: str) -> None:
    world = load_world(name)
    steps = np.hypot(*np.diff(world.centre_line, axis=0).T)
    assert steps.max() <= 0.1 + 1e-9 and steps.min() > 0
    assert len(world.widths_m) == len(world.centre_line)
    assert np.allclose(world.centre_line[0], (world.start.pose.x, world.start.pose.y))
    assert np.allclose(world.waypoints[-1], world.centre_line[-1])
    exit_middle = shapely.Point(world.open_line.mean(axis=0))
    assert shapely.Point(world.waypoints[-1]).distance(exit_middle) == pytest.approx(1.0)
    assert not world.past_open_line(world.start.pose.x, world.start.pose.y)
    assert world.past_open_line(*world.waypoints[-1])
    assert not start_area(world.start, ROBOT.footprint_base).intersects(world.walls)


@pytest.mark.parametrize(
    ("name", "length_m", "narrowest_m", "turns_deg"),
    [
        ("track_7", 14.5, 1.35, [90, -90, -90, 90, 90]),
        ("track_6", 11.1, 1.0, [45]),
        ("track_8", 13.5, 1.3, [60, -110, 120, -100, 60]),
        ("big_track", 39.4, 1.0, [45, -45, 90, -90, 90, 45, -45, -180, 90, -45]),
    ],
)
def test_the_summary_gives_length_width_and_turns(
    name: str, length_m: float, narrowest_m: float, turns_deg: list[int]
) -> None:
    facts = world_summary(load_world(name))
    assert facts["length_m"] == pytest.approx(length_m, abs=0.11)
    assert (facts["narrowest_m"], facts["turns_deg"]) == (narrowest_m, turns_deg)


def test_the_big_track_is_tracks_1_2_and_3_in_a_row() -> None:
    parts = [
        yaml.safe_load((asset_folder("worlds") / f"track_{i}.yaml").read_text(encoding="utf-8"))["segments"]
        for i in (1, 2, 3)
    ]
    whole = yaml.safe_load((asset_folder("worlds") / "big_track.yaml").read_text(encoding="utf-8"))["segments"]
    assert whole == [segment for part in parts for segment in part]


def test_cardboard_walls_have_gaps_and_unequal_heights() -> None:
    world = load_world("real_1")
    assert len(world.walls.geoms) > 5
    assert len(np.unique(world.mesh.vertices[:, 2])) > 10


def test_the_walls_of_a_corner_stand_where_its_segments_say(corner: World) -> None:
    # Closed end at x = 0, mitred corner at (4, 0), exit at y = 3: 4.75 x 0.75 + 3 outside, an L of 1.5 m inside.
    inside = shapely.Polygon([(0, -0.75), (4.75, -0.75), (4.75, 3), (3.25, 3), (3.25, 0.75), (0, 0.75)])
    assert corner.free_space.symmetric_difference(inside).area < 1e-3
    assert corner.walls.bounds == pytest.approx((-0.1, -0.85, 4.85, 3.0), abs=2e-3)
    assert corner.walls.area == pytest.approx(0.1 * (1.7 + 4.85 + 3.85 - 0.1 + 3.25 + 2.25), abs=0.02)
    assert np.allclose(corner.open_line, [(4.75, 3.0), (3.25, 3.0)])


def test_open_space_lies_past_the_line_and_nowhere_else(corner: World) -> None:
    assert corner.past_open_line(4.0, 3.01)
    assert not corner.past_open_line(4.0, 2.99)
    assert not corner.past_open_line(1.0, 0.0)


def test_inside_a_track_that_turns_back_no_point_is_past_the_line(tmp_path: Path) -> None:
    back = "  - {turn: 90}\n  - {straight: 4.0, width: 1.5}\n"
    world = load_world(write(tmp_path, CORNER.replace("3.0", "4.0") + back.replace("4.0", "3.0")))
    assert np.allclose(world.open_line[:, 0], 1.0), "it leaves towards -x, so its own start at x < 1 is on the far side"
    assert not world.past_open_line(0.5, 0.0)
    assert world.past_open_line(0.5, 4.0)


def test_the_segments_of_walls_are_the_edges_of_all_their_rings() -> None:
    hollow = shapely.box(0, 0, 3, 2).difference(shapely.box(1, 0.5, 2, 1.5))
    edges = wall_segments(shapely.MultiPolygon([hollow, shapely.box(5, 5, 6, 6)]))
    assert edges.shape == (12, 2, 2)
    assert np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum() == pytest.approx(10 + 4 + 4)
    assert wall_segments(shapely.MultiPolygon()).shape == (0, 2, 2)


@pytest.mark.parametrize("name", NAMES)
def test_open_space_is_never_seen_from_the_centre_line_before_the_exit(name: str) -> None:
    """Left + right stays under 8 m with the lidar 0.4 m ahead of the body centre, at headings within 45 degrees."""
    world = load_world(name)
    segments, line = wall_segments(world.walls), world.centre_line
    yaw = np.arctan2(*np.diff(line, axis=0).T[::-1])
    for aside in np.radians([-45.0, -33.0, -17.0, -8.0, 0.0, 3.0, 12.0, 28.0, 45.0]):
        lidar = line[:-1] + 0.4 * np.column_stack([np.cos(yaw + aside), np.sin(yaw + aside)])
        inside = shapely.contains_xy(world.free_space.buffer(-0.02), *lidar.T)
        assert open_width(lidar[inside], (yaw + aside)[inside], segments).max() <= 8.0


def test_the_width_seen_sideways_in_a_straight_is_the_width_of_the_corridor(corner: World) -> None:
    here, straight = np.array([[2.0, 0.1]]), np.zeros(1)
    assert open_width(here, straight, wall_segments(corner.walls)) == pytest.approx(1.5, abs=1e-3)
    # 30 degrees aside the same corridor looks 1 / cos 30 times as wide.
    assert open_width(here, straight + math.radians(30), wall_segments(corner.walls)) == pytest.approx(
        1.5 / math.cos(math.radians(30)), abs=1e-3
    )


def test_a_buttress_narrows_the_passage_and_leaves_the_free_space(tmp_path: Path) -> None:
    block = "obstacles:\n  - {buttress: left, at_m: 2.6, length: 0.4, depth: 0.3}\n"
    world = load_world(write(tmp_path, CORNER + block))
    assert world.widths_m.min() == pytest.approx(1.2, abs=0.01)
    assert not shapely.contains_xy(world.free_space, 2.6, 0.5)
    assert shapely.contains_xy(world.free_space, 2.6, 0.4)


def test_a_low_obstacle_is_recorded_and_a_raised_bar_passes_overhead(tmp_path: Path) -> None:
    obstacles = (
        "obstacles:\n  - {box: [2.6, 0.6], size: [0.2, 0.2], height_m: 0.2, low: true}\n"
        "  - {box: [3.0, 0.0], size: [0.1, 1.4], bottom_m: 0.9, height_m: 1.1}\n"
    )
    world = load_world(write(tmp_path, CORNER + obstacles))
    assert world.low_obstacles.area == pytest.approx(0.04)
    assert world.walls.contains(shapely.Point(2.6, 0.6)) and not world.walls.intersects(shapely.Point(3.0, 0.0))
    assert 0.9 in world.mesh.vertices[:, 2]


def test_a_free_space_of_polygons_gives_the_same_world_as_its_segments(tmp_path: Path, corner: World) -> None:
    text = """
name: polygons
free_space: [[[0, -0.75], [4.75, -0.75], [4.75, 3], [3.25, 3], [3.25, 0.75], [0, 0.75]]]
centre_line: [[0, 0], [4, 0], [4, 4]]
open_line: [[3.25, 3], [4.75, 3]]
start: {pose: [1.5, 0, 0]}
"""
    world = load_world(write(tmp_path, text))
    assert world.walls.symmetric_difference(corner.walls).area < 1e-2
    assert np.allclose(world.open_line, corner.open_line)
    assert np.allclose(world.centre_line[-1], corner.centre_line[-1])
    assert world.turns_deg == pytest.approx([90.0])
    assert world.widths_m[5] == pytest.approx(1.5, abs=1e-6)


def test_start_and_goal_can_be_given_with_the_call() -> None:
    world = load_world("track_1", start=Pose2(2.0, 0.1, 0.05), goal=Pose2(20.0, 3.0, 0.0))
    assert world.start.pose == Pose2(2.0, 0.1, pytest.approx(0.05)) and world.start.range_x_m == 0.0
    assert world.waypoints.tolist() == [[20.0, 3.0]]


def test_the_figure_of_all_tracks_is_drawn(tmp_path: Path) -> None:
    draw_worlds(
        [load_world(name) for name in ("big_track", "track_4", "real_1")], tmp_path / "tracks.png", ROBOT.footprint_base
    )
    image = np.asarray(Image.open(tmp_path / "tracks.png").convert("RGB")).reshape(-1, 3)
    assert len(np.unique(image, axis=0)) > 20


def test_a_figure_of_many_tracks_is_no_strip(tmp_path: Path) -> None:
    tracks = [track for family in FAMILIES[1:] for track in generate_tracks([8], family=family, difficulty=0.7)]
    draw_worlds(tracks, tmp_path / "tracks.png", ROBOT.footprint_base)
    width, height = Image.open(tmp_path / "tracks.png").size
    assert 0.45 < width / height < 2.2


def test_a_prism_is_closed_also_where_corners_of_outline_and_hole_lie_on_one_line() -> None:
    outline = shapely.Polygon(
        [(0, 0), (1, 0), (2, 0), (4, 0), (4, 4), (0, 4)], [[(1, 1), (2, 1), (2, 2), (1, 2)], [(3, 1), (3.5, 1), (3, 2)]]
    )
    mesh = extrude(outline, 0.5, 2.5)
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert body.is_watertight and body.volume == pytest.approx((16 - 1 - 0.25) * 2.0)
