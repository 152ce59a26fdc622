"""Meshes as others make them become walls, or are refused with what was found in them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.transformations import translation_matrix

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, WorldNote, load_world

START = Pose2(2.0, 2.0, 0.0)


def box(x: float, y: float, z: float, size: tuple[float, float, float]) -> trimesh.Trimesh:
    """Return a box by its lowest corner."""
    middle = np.array([x, y, z]) + np.array(size) / 2
    return trimesh.creation.box(size, transform=translation_matrix(middle))


def room(height: float = 1.0, z: float = 0.0) -> trimesh.Trimesh:
    """Return the walls, 0.2 m thick, of a room with 8 m x 4 m inside, its corner at the origin; four boxes overlap."""
    parts = [
        *(box(-0.2, y, z, (8.4, 0.2, height)) for y in (-0.2, 4.0)),
        *(box(x, -0.2, z, (0.2, 4.4, height)) for x in (-0.2, 8.0)),
    ]
    return trimesh.util.concatenate(parts)


WALLS_M2 = 8.4 * 4.4 - 8.0 * 4.0


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., World]:
    """Returns what loads a mesh, exported as a file of some kind, with the keys of a world file where there are any."""

    def made(mesh: trimesh.Trimesh, suffix: str = "stl", keys: str = "", start: Pose2 = START) -> World:
        mesh.export(tmp_path / f"walls.{suffix}")
        if not keys:
            return load_world(tmp_path / f"walls.{suffix}", start=start)
        (tmp_path / "own.yaml").write_text(f"name: own\nmesh: walls.{suffix}\n{keys}\n", encoding="utf-8")
        return load_world(tmp_path / "own.yaml", start=start)

    return made


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
def test_bodies_that_overlap_are_walls_where_they_do(load: Callable[..., World], suffix: str) -> None:
    world = load(room(), suffix)
    assert world.walls.area == pytest.approx(WALLS_M2, rel=1e-3)
    assert world.free_space.area == pytest.approx(32.0, rel=1e-3)


def test_two_boxes_that_share_a_face_are_closed(load: Callable[..., World]) -> None:
    world = load(trimesh.util.concatenate([box(5, 0, 0, (1, 1, 1)), box(6, 0, 0, (1, 1, 1))]))
    assert world.walls.area == pytest.approx(2.0, rel=1e-3) and world.walls.bounds == pytest.approx((5, 0, 7, 1))


def test_a_body_turned_inside_out_is_turned_back(load: Callable[..., World]) -> None:
    inward = box(5, 0, 0, (1, 2, 1))
    inward.invert()
    with pytest.warns(UserWarning, match="turned outward"):
        assert load(inward, "ply").walls.area == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_a_room_exported_y_up_is_stood_upright_and_that_is_said(load: Callable[..., World], suffix: str) -> None:
    mesh = room()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))  # z up to y up
    with pytest.warns(UserWarning, match="y-up"):
        guessed = load(mesh, suffix)
    assert guessed.walls.area == pytest.approx(WALLS_M2, rel=1e-3)
    assert guessed.walls.bounds == pytest.approx((-0.2, -0.2, 8.2, 4.2), abs=1e-6)
    assert load(mesh, suffix, "up: y").walls.equals_exact(guessed.walls, 1e-6)


def test_kilometres_are_millimetres_unless_the_file_says_otherwise(load: Callable[..., World]) -> None:
    mesh = room()
    mesh.apply_scale(1000.0)
    with pytest.warns(UserWarning, match="millimetres"):
        assert load(mesh).walls.bounds == pytest.approx((-0.2, -0.2, 8.2, 4.2), abs=1e-6)
    mesh.apply_scale(0.1)
    assert load(mesh, keys="scale: 0.01").walls.area == pytest.approx(WALLS_M2, rel=1e-3)
    assert load(mesh, keys="scale: 0.01\noffset: [1, 2, 0]", start=Pose2(3, 4, 0)).walls.bounds == pytest.approx(
        (0.8, 1.8, 9.2, 6.2), abs=1e-6
    )


def test_a_drawing_in_centimetres_is_taken_as_metres_and_that_is_said_also_where_it_is_refused(
    load: Callable[..., World],
) -> None:
    mesh = room()
    mesh.apply_scale(100.0)
    with pytest.warns(WorldNote, match=r"taken as metres, 840 of them \(`scale: 0\.01`"):
        assert load(mesh).walls.bounds == pytest.approx((-20.0, -20.0, 820.0, 420.0), abs=1e-3)
    with pytest.warns(WorldNote, match="840 of them"), pytest.raises(WorldError, match="start"):
        load(mesh, start=Pose2(-1.0, -1.0, 0.0))
    assert load(mesh, keys="scale: 0.01").walls.bounds == pytest.approx((-0.2, -0.2, 8.2, 4.2), abs=1e-6)


def test_a_slab_under_the_walls_is_the_floor(load: Callable[..., World]) -> None:
    on_slab = trimesh.util.concatenate([box(-1, -1, 0, (10, 6, 0.2)), room(z=0.2)])
    with pytest.warns(UserWarning, match="0.2 m thick"):
        world = load(on_slab)
    assert world.walls.area == pytest.approx(WALLS_M2, rel=1e-3)
    assert world.mesh.vertices[:, 2].max() == pytest.approx(1.0, abs=0.01)


def test_low_walls_are_refused_unless_declared_and_then_known_as_low(load: Callable[..., World]) -> None:
    low = trimesh.util.concatenate([room(), box(5, 1, 0, (0.2, 2, 0.3))])
    with pytest.raises(WorldError, match=r"5\.10, 2\.00\) ends 0\.3 m above.*low: true.*x -0\.20 to 8\.20"):
        load(low)
    world = load(low, keys="low: true")
    assert world.low_obstacles.area == pytest.approx(0.4, rel=1e-3)
    assert world.walls.area == pytest.approx(WALLS_M2 + 0.4, rel=1e-3)
    with pytest.raises(WorldError, match="low: true"):
        load(room(height=0.3))
    assert load(room(height=0.8)).low_obstacles.is_empty


@pytest.mark.parametrize(("bottom", "top"), [(0.0, 0.09), (0.03, 0.06), (0.23, 0.27), (0.405, 0.41), (0.72, 0.76)])
def test_what_lies_between_the_heights_at_which_a_mesh_is_cut_is_a_low_wall(
    load: Callable[..., World], bottom: float, top: float
) -> None:
    shelf = trimesh.util.concatenate([room(), box(5, 0, bottom, (0.2, 4, top - bottom))])
    with pytest.raises(WorldError, match=rf"\(5\.10, 2\.00\) ends {top:.2g} m above.*low: true"):
        load(shelf)
    world = load(shelf, keys="low: true")
    assert world.low_obstacles.bounds == pytest.approx((5.0, 0.0, 5.2, 4.0), abs=1e-4)
    assert world.walls.area == pytest.approx(WALLS_M2 + 0.8, rel=1e-3)


def test_a_bar_thinner_than_walls_may_lean_is_a_low_wall(load: Callable[..., World]) -> None:
    bar = trimesh.util.concatenate([room(), box(5, 0, 0.25, (0.008, 4, 0.008))])
    assert load(bar, keys="low: true").low_obstacles.area == pytest.approx(0.032, rel=0.01)


def test_the_foot_of_a_ramp_counts_from_where_the_scan_begins(load: Callable[..., World]) -> None:
    ramp = trimesh.convex.convex_hull([[5, y, 0] for y in (1, 2)] + [[6, y, z] for y in (1, 2) for z in (0, 1)])
    world = load(ramp, keys="low: true")
    assert world.walls.bounds == pytest.approx((5.05, 1.0, 6.0, 2.0), abs=1e-3)


def test_surfaces_between_the_cuts_are_low_walls_too(load: Callable[..., World]) -> None:
    shelf = trimesh.Trimesh([[5, 1, 0.25], [6, 1, 0.25], [6, 2, 0.25], [5, 2, 0.25]], [[0, 1, 2], [0, 2, 3]])
    strip = trimesh.Trimesh([[3, 0, 0.22], [3, 1, 0.22], [3, 1, 0.28], [3, 0, 0.28]], [[0, 1, 2], [0, 2, 3]])
    world = load(trimesh.util.concatenate([room(), shelf, strip]), keys="thickness_m: 0.1\nlow: true")
    assert world.low_obstacles.bounds == pytest.approx((2.95, 0.0, 6.05, 2.05), abs=0.06)
    assert world.low_obstacles.area == pytest.approx(1.1**2 + 0.1 * 1.05, rel=0.02)


def test_what_begins_or_ends_at_the_edge_of_the_band_is_no_wall(load: Callable[..., World]) -> None:
    beside = trimesh.util.concatenate([room(), box(5, 1, 0, (1, 1, 0.05)), box(5, 1, 0.8, (1, 1, 0.2))])
    assert load(beside).walls.area == pytest.approx(WALLS_M2, rel=1e-3)


def test_open_surfaces_are_walls_of_the_thickness_that_is_asked_for(load: Callable[..., World]) -> None:
    sheet = trimesh.Trimesh([[5, 0, 0], [5, 3, 0], [5, 3, 1], [5, 0, 1]], [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(WorldError, match=r"not watertight.*thickness_m.*z 0\.00 to 1\.00"):
        load(sheet)
    world = load(sheet, keys="thickness_m: 0.1")
    assert world.walls.bounds == pytest.approx((4.95, -0.05, 5.05, 3.05), abs=1e-3)
    assert trimesh.Trimesh(world.mesh.vertices, world.mesh.faces, process=False).is_watertight
    both = load(trimesh.util.concatenate([sheet, box(6, 0, 0, (1, 1, 1))]), keys="thickness_m: 0.1")
    assert both.walls.area == pytest.approx(0.31 + 1.0, rel=0.02)


def test_a_floor_and_a_ceiling_of_no_thickness_are_no_walls(load: Callable[..., World]) -> None:
    plane = trimesh.Trimesh([[-1, -1, 0], [9, -1, 0], [9, 5, 0], [-1, 5, 0]], [[0, 1, 2], [0, 2, 3]])
    ceiling = plane.copy()
    ceiling.apply_translation([0, 0, 2.5])
    with pytest.warns(UserWarning, match="flat on the floor"):
        world = load(trimesh.util.concatenate([room(), plane, ceiling]))
    assert world.walls.area == pytest.approx(WALLS_M2, rel=1e-3)


def test_a_mesh_high_above_the_floor_is_refused_with_its_extents_and_what_stands_in_the_band(
    load: Callable[..., World],
) -> None:
    with pytest.raises(WorldError, match=r"z 3\.00 to 4\.00 m, and 0% of its faces.*") as caught:
        load(room(z=3.0))
    assert "offset" in str(caught.value)
    assert load(room(z=3.0), keys="offset: [0, 0, -3]").walls.area == pytest.approx(WALLS_M2, rel=1e-3)


@pytest.mark.parametrize(("name", "said"), [("a.world", "Gazebo"), ("a.sdf", "Gazebo"), ("a.dae", "export it as OBJ")])
def test_other_kinds_of_places_are_refused_by_name(name: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("<sdf/>", encoding="utf-8")
    with pytest.raises(WorldError, match=said):
        load_world(tmp_path / name)
    (tmp_path / "own.yaml").write_text(f"name: own\nmesh: {name}\n", encoding="utf-8")
    with pytest.raises(WorldError, match=said):
        load_world(tmp_path / "own.yaml")


@pytest.mark.parametrize("suffix", ["stl", "ply", "glb", "obj"])
def test_a_damaged_mesh_is_refused_by_name(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"cut.{suffix}"
    room().export(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for length in (0, 1, 20, 90, len(whole) // 2):
        path.write_bytes(whole[:length])
        with pytest.raises(WorldError, match=f"cut.{suffix}"):
            load_world(path, start=START)
    for _ in range(20):
        damaged = bytearray(whole)
        for at in rng.integers(len(damaged), size=10):
            damaged[at] = rng.integers(256)
        path.write_bytes(bytes(damaged))
        try:
            load_world(path, start=START)
        except WorldError as error:
            assert f"cut.{suffix}" in str(error)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("mesh: walls.stl\nwall: {height_m: 2.5}", r"wall\.height_m: for walls that are built .* a `mesh` has its own"),
        ("map: map.yaml\nwall: {height_m: 1.2, thickness_m: 0.5}", r"world: wall\.thickness_m: .* a `map` has its own"),
        ("map: map.yaml\nwall: {boxes: {seed: 3}}", r"wall\.boxes: .* a `map` has its own: remove it"),
    ],
)
def test_what_the_walls_of_others_do_not_heed_is_refused_by_name(keys: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(f"name: own\n{keys}\n", encoding="utf-8")
    with pytest.raises(WorldError, match=said):
        load_world(tmp_path / "own.yaml")


@pytest.mark.parametrize("source", ["map: map.yaml", "mesh: walls.stl", "free_space: [[[0, 0], [9, 0], [9, 2]]]"])
def test_a_start_along_segments_is_refused_where_there_are_none(source: str, tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(
        f"name: own\n{source}\nstart: {{at_m: 4, pose: [1.5, 0, 0]}}\n", encoding="utf-8"
    )
    with pytest.raises(WorldError, match=r"start\.at_m: for `segments` only, and this is a .* remove it"):
        load_world(tmp_path / "own.yaml")


def test_keys_of_a_mesh_are_refused_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(
        "name: own\nsegments: [{straight: 4, width: 1.5}]\nscale: 2.0\n", encoding="utf-8"
    )
    with pytest.raises(WorldError, match="scale: for a `mesh` only"):
        load_world(tmp_path / "own.yaml")
