"""What the body of a car would hit though it is none of the walls refuses the world, for the cars that reach it."""

from dataclasses import replace
from pathlib import Path

import pytest
import shapely
import trimesh
from trimesh.transformations import translation_matrix

from zebrat_bullet.errors import WorldError
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.world import World, WorldNote, load_world

ROBOT = load_robot()
TALL = replace(ROBOT, body_top_m=1.65)
DEEP = replace(ROBOT, body_bottom_m=0.006)
WALLS = [((10, 0.2, 2), (4, -0.1, 1)), ((10, 0.2, 2), (4, 1.7, 1)), ((0.2, 1.6, 2), (-0.9, 0.8, 1))]
"""Size and middle of the walls of a corridor 1.6 m wide, open to the right."""


def corridor(
    folder: Path, robot: RobotModel, size: tuple[float, ...], middle: tuple[float, ...], more: str = ""
) -> World:
    """Return the corridor with one more box in it."""
    boxes = [trimesh.creation.box(each, translation_matrix(at)) for each, at in [*WALLS, (size, middle)]]
    trimesh.util.concatenate(boxes).export(folder / "walls.stl")
    (folder / "own.yaml").write_text(
        f"name: own\nmesh: walls.stl\nstart: {{pose: [0.5, 0.8, 0]}}\n{more}\n", encoding="utf-8"
    )
    return load_world(folder / "own.yaml", robot=robot)


def track(folder: Path, robot: RobotModel, bottom: float, at: tuple[float, float] = (3.0, 0.0)) -> World:
    (folder / "own.yaml").write_text(
        "name: own\nsegments: [{straight: 6, width: 1.6}]\nobstacles:\n"
        f"  - {{box: [{at[0]}, {at[1]}], size: [0.3, 1.4], bottom_m: {bottom}, height_m: {bottom + 0.3}}}\n",
        encoding="utf-8",
    )
    return load_world(folder / "own.yaml", robot=robot)


def test_a_lintel_lower_than_the_car_is_refused_and_a_lower_car_passes_under(tmp_path: Path) -> None:
    lintel = ((0.3, 1.6, 0.2), (3, 0.8, 1.0))
    with pytest.raises(WorldError, match=r"over \(3\.00, 0\.80\) something hangs lower than .* 1\.65 m") as caught:
        corridor(tmp_path, TALL, *lintel)
    assert caught.value.at == pytest.approx((3.0, 0.8))
    assert not corridor(tmp_path, ROBOT, *lintel).walls.intersects(shapely.Point(3.0, 0.8))
    corridor(tmp_path, TALL, (0.3, 1.6, 0.2), (3, 0.8, 1.8))


def test_what_begins_right_above_the_highest_cut_is_in_the_way_of_a_tall_car(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="something hangs"):
        corridor(tmp_path, TALL, (0.3, 1.6, 1.0), (3, 0.8, 1.295))


def test_an_obstacle_that_hangs_lower_than_the_car_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match=r"own\.yaml: over \(3\.00, 0\.00\) something hangs"):
        track(tmp_path, TALL, 0.9)
    with pytest.raises(WorldError, match="something hangs"):  # just past the exit
        track(tmp_path, TALL, 0.9, at=(6.5, 0.0))
    track(tmp_path, ROBOT, 0.9)
    track(tmp_path, TALL, 1.7)
    track(tmp_path, TALL, 0.9, at=(3.0, 4.0))  # not where anyone drives


def test_an_obstacle_over_the_floor_of_a_mesh_counts_too(tmp_path: Path) -> None:
    hangs = "obstacles: [{box: [5, 0.8], size: [0.3, 0.3], bottom_m: 0.85, height_m: 1}]"
    with pytest.raises(WorldError, match=r"over \(5\.00, 0\.80\)"):
        corridor(tmp_path, TALL, (0.2, 0.2, 1), (8, 0.3, 0.5), hangs)


def test_what_lies_lower_than_the_walls_is_refused_for_a_body_that_reaches_it(tmp_path: Path) -> None:
    sill = ((0.3, 1.6, 0.03), (3, 0.8, 0.015))
    with pytest.raises(WorldError, match=r"at \(3\.00, 0\.80\) lies something.* down to 0\.006 m") as caught:
        corridor(tmp_path, DEEP, *sill)
    assert "offset" in str(caught.value)
    corridor(tmp_path, ROBOT, *sill)
    corridor(tmp_path, DEEP, (0.3, 1.6, 0.005), (3, 0.8, 0.0025))  # the body passes over it


@pytest.mark.parametrize("thickness", [0.001, 0.03, 0.05, 0.2])
def test_a_slab_of_any_thickness_is_the_floor_so_that_a_low_body_drives_on_it(tmp_path: Path, thickness: float) -> None:
    slab = ((10, 2.2, thickness), (4, 0.8, thickness / 2))
    with pytest.warns(WorldNote, match=rf"the slab {thickness:g} m thick under its walls is taken as the floor"):
        world = corridor(tmp_path, DEEP, *slab)
    assert world.mesh.vertices[:, 2].max() == pytest.approx(2.0 - thickness - 0.002)


def test_a_slab_whose_face_is_the_floor_already_stays(tmp_path: Path) -> None:
    world = corridor(tmp_path, DEEP, (10, 2.2, 0.2), (4, 0.8, -0.1))
    assert world.notes == () and world.mesh.vertices[:, 2].max() == pytest.approx(2.0)


def test_a_slab_that_the_file_says_is_none_is_refused_for_a_low_body(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="lies something that the body of this car hits"):
        corridor(tmp_path, DEEP, (10, 2.2, 0.03), (4, 0.8, 0.015), "offset: [0, 0, 0]")
