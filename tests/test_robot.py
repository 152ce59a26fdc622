"""The URDF says everything of the robot, and one that is no car is refused with a reason."""

from pathlib import Path

import numpy as np
import pybullet
import pytest
import shapely
import trimesh
import yourdfpy

from zebrat_bullet.assets import asset_folder
from zebrat_bullet.errors import AssetError, RobotError
from zebrat_bullet.geometry import rotation_2d
from zebrat_bullet.robot import RobotModel, load_robot

SMALL_CAR = Path(__file__).parent / "data" / "small_car.urdf"


def edited(tmp_path: Path, old: str, new: str, count: int = -1) -> Path:
    """Return a copy of the small car's URDF in which `old` has become `new`."""
    text = SMALL_CAR.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "edited.urdf"
    path.write_text(text.replace(old, new, count), encoding="utf-8")
    return path


def test_zebrat_has_the_dimensions_of_the_paper(robot: RobotModel) -> None:
    assert robot.wheelbase_m == pytest.approx(0.560)
    assert robot.track_m == pytest.approx(0.49)
    assert robot.wheel_radius_m == pytest.approx(0.15)
    assert robot.rear_axle_x_m == pytest.approx(-0.271)
    np.testing.assert_allclose(robot.footprint_base, [[-0.5, -0.3], [0.5, -0.3], [0.5, 0.3], [-0.5, 0.3]])
    np.testing.assert_allclose(robot.lidar_xyz_base, [0.4, 0.0, 0.75])
    np.testing.assert_allclose(robot.lidar_rpy, 0.0)
    assert (robot.body_bottom_m, robot.body_top_m) == pytest.approx((0.08, 0.47))
    assert robot.knuckle_limit_rad > 0.774  # atan(0.56 / (0.56 / tan 0.6 - 0.245)), the inner knuckle at full lock


def test_another_car_is_read_by_its_roles() -> None:
    small = load_robot(SMALL_CAR)
    assert (small.wheelbase_m, small.track_m, small.wheel_radius_m) == pytest.approx((0.32, 0.24, 0.06))
    # A 0.48 x 0.30 box with a 0.20 wide bumper that stands out by 2 cm, counter-clockwise from the rear right.
    outline = [[-0.24, -0.15], [0.24, -0.15], [0.26, -0.1], [0.26, 0.1], [0.24, 0.15], [-0.24, 0.15]]
    np.testing.assert_allclose(small.footprint_base, outline, atol=1e-9)
    np.testing.assert_allclose(small.lidar_rpy, [0.0, 0.1, 0.0], atol=1e-9)
    assert small.body_top_m == pytest.approx(0.19)


def test_a_collision_mesh_counts_like_a_box(tmp_path: Path) -> None:
    corners = [(x, y, z) for x in (-0.24, 0.24) for y in (-0.15, 0.15) for z in (-0.07, 0.07)]
    faces = [
        (1, 2, 4),
        (1, 4, 3),
        (5, 7, 8),
        (5, 8, 6),
        (1, 5, 6),
        (1, 6, 2),
        (3, 4, 8),
        (3, 8, 7),
        (1, 3, 7),
        (2, 6, 8),
    ]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in faces]
    (tmp_path / "body.obj").write_text("\n".join(lines), encoding="utf-8")
    path = edited(tmp_path, '<box size="0.48 0.30 0.14"/>', '<mesh filename="body.obj"/>')
    np.testing.assert_allclose(load_robot(path).footprint_base, load_robot(SMALL_CAR).footprint_base, atol=1e-9)


def test_vertices_along_the_sides_of_a_mesh_are_no_corners(tmp_path: Path) -> None:
    """A box turned by 30 degrees and finely meshed: rounding puts vertices of its sides a hair outside of them."""
    mesh = trimesh.creation.box((0.4, 0.2, 0.14)).subdivide().subdivide()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(30.0), (0, 0, 1)))
    mesh.export(tmp_path / "body.stl")
    path = edited(tmp_path, '<box size="0.48 0.30 0.14"/>', '<mesh filename="body.stl"/>')
    path.write_text(
        path.read_text(encoding="utf-8").replace('xyz="0.25 0 0.10"', 'xyz="0 0 0.10"'), encoding="utf-8"
    )  # the bumper, into the box
    corners = np.array([[-0.2, 0.1], [-0.2, -0.1], [0.2, -0.1], [0.2, 0.1]]) @ rotation_2d(np.radians(30.0)).T
    seen = load_robot(f"{path}:footprint=collision").footprint_base  # its wheels stand outside
    np.testing.assert_allclose(seen, corners, atol=1e-6)


def test_a_hollow_in_the_body_belongs_to_the_footprint(tmp_path: Path) -> None:
    """A bumper that stands off by 4 cm: the outline spans the gap between."""
    path = edited(tmp_path, 'xyz="0.25 0 0.10"', 'xyz="0.29 0 0.10"')
    outline = [[-0.24, -0.15], [0.24, -0.15], [0.3, -0.1], [0.3, 0.1], [0.24, 0.15], [-0.24, 0.15]]
    np.testing.assert_allclose(load_robot(path).footprint_base, outline, atol=1e-9)


def test_missing_roles_are_named_with_all_that_is_needed(tmp_path: Path) -> None:
    path = edited(tmp_path, "left_steering_hinge_joint", "left_kingpin")
    with pytest.raises(RobotError, match=r"lacks the joints left_steering_hinge_joint; .*lidar_mount \(fixed"):
        load_robot(path)


@pytest.mark.parametrize(
    ("old", "new", "count", "reason"),
    [
        ('"0.16 0.12 0.06"', '"0.16 0.15 0.06"', -1, "mirror"),
        ('"0.16 ', '"0.18 ', 1, "mirror"),
        ('radius="0.06"', 'radius="0.05"', 1, "one radius"),
        ('radius="0.06"', 'radius="0.05"', 1, "on one floor"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="1 0 0"/>', 1, "across its axle"),
        ('type="revolute"', 'type="fixed"', 1, "make it revolute"),
        ('effort="5"', 'effort="0"', 1, "effort above 0"),
        ('<parent link="left_knuckle"/>', '<parent link="base_footprint"/>', 1, "cannot steer"),
        ('<cylinder radius="0.06" length="0.006"/>', '<box size="1 1 1"/>', 1, "a cylinder"),
        ('<mass value="8"/>', '<mass value="0"/>', 1, "tip over"),
        ('<box size="0.48 0.30 0.14"/>', '<mesh filename="gone.obj"/>', 1, "no mesh at"),
    ],
)
def test_contradictions_are_refused(tmp_path: Path, old: str, new: str, count: int, reason: str) -> None:
    with pytest.raises(RobotError, match=reason):
        load_robot(edited(tmp_path, old, new, count))


def test_a_file_that_is_no_urdf_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "poem.urdf"
    path.write_text("Tyger Tyger, burning bright", encoding="utf-8")
    with pytest.raises(RobotError, match="cannot be read as a URDF"):
        load_robot(path)


def test_an_unknown_name_lists_the_shipped_robots() -> None:
    with pytest.raises(AssetError, match="zebrat"):
        load_robot("no_such_robot")


@pytest.mark.parametrize("name", ["hexagon", "long"])
def test_what_is_shown_of_the_other_cars_stays_within_their_footprints(name: str) -> None:
    urdf, robot = yourdfpy.URDF.load(str(asset_folder("urdf") / f"{name}.urdf")), load_robot(name)
    shown = urdf.scene.to_mesh().vertices
    inside = shapely.Polygon(robot.footprint_base).buffer(1e-3).covers(shapely.MultiPoint(shown[:, :2]))
    assert inside and shown[:, 2].min() == pytest.approx(0.0, abs=0.005)


def test_every_visual_of_zebrat_loads_coloured() -> None:
    path = asset_folder("urdf") / "zebrat.urdf"
    urdf = yourdfpy.URDF.load(str(path), load_meshes=True)
    n_visuals = sum(len(link.visuals) for link in urdf.link_map.values())
    assert len(urdf.scene.geometry) == n_visuals > 20
    colours = {tuple(mesh.visual.face_colors[0]) for mesh in urdf.scene.geometry.values()}
    assert len(colours) == 8
    lower, upper = urdf.scene.bounds
    assert lower[2] == pytest.approx(0.0, abs=0.005) and 0.75 < upper[2] < 0.85
    assert np.all(lower[:2] >= (-0.501, -0.301)) and np.all(upper[:2] <= (0.501, 0.301))


def test_pybullet_loads_zebrat_with_its_visuals() -> None:
    client = pybullet.connect(pybullet.DIRECT)
    try:
        car = pybullet.loadURDF(str(asset_folder("urdf") / "zebrat.urdf"), physicsClientId=client)
        assert len(pybullet.getVisualShapeData(car, physicsClientId=client)) > 20
        mass = sum(pybullet.getDynamicsInfo(car, i, physicsClientId=client)[0] for i in range(-1, 7))
        assert mass == pytest.approx(100 + 0.83 + 2 * 1.0 + 4 * 1.5)
    finally:
        pybullet.disconnect(client)
