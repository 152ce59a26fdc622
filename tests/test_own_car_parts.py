"""What hangs on a car's wheels and hinges counts, in the unit it is written in; what is misread is refused by name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from own_cars import ROS_JOINTS, OwnCar

from zebrat_bullet.errors import RobotError
from zebrat_bullet.robot import GRAVITY_MPS2, inspect_robot, load_robot, named_robot

WHEELS = ("left_rear", "right_rear", "left_front", "right_front")
INERTIA = '<inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/>'


def fixed(name: str, parent: str, inside: str = "", origin: str = "") -> str:
    """Return a link fixed to another."""
    return (
        f'<link name="{name}">{inside}</link><joint name="{name}_joint" type="fixed"><parent link="{parent}"/>'
        f'<child link="{name}"/>{origin}</joint>'
    )


@pytest.mark.parametrize("link", ["left_knuckle", "right_rear_wheel"])
def test_a_lidar_that_is_steered_or_rolls_is_refused(tmp_path: Path, link: str) -> None:
    text = OwnCar().urdf().replace('<link name="scanner"/>', fixed("scanner", link))
    start = text.index('<joint name="lidar_mount"')
    (tmp_path / "own.urdf").write_text(
        text[:start] + text[text.index("</joint>", start) + len("</joint>") :], encoding="utf-8"
    )
    with pytest.raises(RobotError, match=rf"lidar_mount \(scanner\) hangs on {link.split('_')[0]}.*, which moves"):
        load_robot(named_robot(tmp_path / "own.urdf", ["lidar_mount=scanner"]))


def test_the_mass_of_links_fixed_to_wheels_and_knuckles_is_the_cars(tmp_path: Path) -> None:
    """A body of 4 kg, four wheels of 0.3 kg with tyres of 1 kg, and one brake of 0.5 kg on each knuckle: 10.2 kg."""
    tyre, brake = (f'<inertial><mass value="{kg}"/>{INERTIA}</inertial>' for kg in (1, 0.5))
    more = "".join(fixed(f"{where}_tyre", f"{where}_wheel", tyre) for where in WHEELS)
    more += "".join(fixed(f"{side}_brake", f"{side}_knuckle", brake) for side in ("left", "right"))
    robot = load_robot(OwnCar(more=more).write(tmp_path))
    assert robot.weight_n / GRAVITY_MPS2 == pytest.approx(10.2)


def test_a_steered_mudguard_belongs_to_the_footprint_from_lock_to_lock(tmp_path: Path) -> None:
    """A post 0.08 m ahead and outside of the hinge at (0.16, 0.12) swings on a circle of 0.113 m, 0.9 rad each way."""
    post = '<collision><geometry><box size="1e-6 1e-6 0.05"/></geometry></collision>'
    more = "".join(
        fixed(f"{side}_guard", f"{side}_knuckle", post, f'<origin xyz="0.08 {y} 0.05"/>')
        for side, y in (("left", 0.08), ("right", -0.08))
    )
    robot = load_robot(OwnCar(more=more).write(tmp_path))
    assert np.ptp(robot.footprint_base[:, 1]) == pytest.approx(2 * (0.12 + 0.08 * np.sqrt(2.0)), abs=2e-3)
    assert robot.footprint_base[:, 0].max() == pytest.approx(0.16 + 0.08 * np.sqrt(2.0), abs=1e-3)
    assert any("left_guard, right_guard stand" in note for note in robot.notes)
    alone = load_robot(named_robot(tmp_path / "own.urdf", ["footprint=collision"]))
    assert np.ptp(alone.footprint_base[:, 1]) == pytest.approx(0.30)


def test_what_rolls_with_a_wheel_belongs_to_the_footprint(tmp_path: Path) -> None:
    """A knob reaches 0.11 m outside of the wheel at y = 0.12 m, and up to hypot(0.08, 0.01) m from its axle."""
    knob = '<collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision>'
    more = fixed("knob", "left_rear_wheel", knob, '<origin xyz="0 0.1 0.07"/>')
    robot = load_robot(OwnCar(more=more).write(tmp_path))
    assert robot.footprint_base[:, 1].max() == pytest.approx(0.23)
    assert robot.footprint_base[:, 0].min() == pytest.approx(-0.16 - np.hypot(0.01, 0.08), abs=1e-6)


def test_a_wheel_may_have_its_shape_in_a_link_fixed_to_it(tmp_path: Path) -> None:
    """Its cylinder is turned in the tyre's own frame, and stands 0.01 m outside of the joint."""
    cylinder = '<collision><geometry><cylinder radius="0.05" length="0.03"/></geometry></collision>'
    tyres = "".join(
        fixed(f"{where}_tyre", f"{where}_wheel", cylinder, f'<origin xyz="0 {y} 0" rpy="1.5707963 0 0"/>')
        for where, y in zip(WHEELS, (0.01, -0.01) * 2, strict=True)
    )
    robot = load_robot(OwnCar(wheel="", more=tyres).write(tmp_path))
    assert (robot.wheel_radius_m, robot.track_m) == pytest.approx((0.05, 0.26))


def test_a_wheel_without_a_shape_is_told_each_mend_once(tmp_path: Path) -> None:
    with pytest.raises(RobotError) as refused:
        load_robot(OwnCar(wheel="").write(tmp_path))
    first = str(refused.value).splitlines()[1]
    assert first.count("wheel_radius_m=") == first.count("give its <collision> a cylinder") == 1


@pytest.mark.parametrize("tag", ["collision", "visual"])
def test_a_collada_file_is_read_in_its_unit_and_painted_so(tmp_path: Path, tag: str) -> None:
    from zebrat_bullet.render.car import Car

    trimesh.creation.box((0.45 / 0.0254, 0.30 / 0.0254, 0.12 / 0.0254)).export(tmp_path / "body.dae")
    text = (tmp_path / "body.dae").read_text(encoding="utf-8")
    inches = text.replace("<up_axis>", '<unit name="inch" meter="0.0254"/><up_axis>')
    assert inches != text
    (tmp_path / "body.dae").write_text(inches, encoding="utf-8")
    shape = '<origin xyz="0 0 0.12"/><geometry><mesh filename="body.dae" scale="1 0.5 1"/></geometry>'
    car = OwnCar(collision=f"<visual>{shape}</visual>" + (f"<{tag}>{shape}</{tag}>" if tag == "collision" else ""))
    robot = load_robot(named_robot(car.write(tmp_path), ["footprint=hull"]))
    assert np.ptp(robot.footprint_base[:, 0]) == pytest.approx(0.45, abs=1e-4)
    assert any("body.dae is written in units of 0.0254 m" in note for note in robot.notes)
    bounds = np.array([actor.GetBounds() for actor in Car(robot).actors])
    assert np.ptp(bounds[:, :2]) == pytest.approx(0.45, abs=1e-4)


def test_a_body_drawn_in_mm_is_refused_for_its_length_with_the_scale_that_mends_it(tmp_path: Path) -> None:
    trimesh.creation.box((450, 300, 120)).export(tmp_path / "body.stl")
    mesh = '<collision><origin xyz="0 0 0.12"/><geometry><mesh filename="body.stl"{}/></geometry></collision>'
    with pytest.raises(
        RobotError, match=r"body is 450 m long with the axles 0\.32 m apart.*scale=\"0\.001 0\.001 0\.001\""
    ):
        load_robot(OwnCar(collision=mesh.format("")).write(tmp_path))
    load_robot(OwnCar(collision=mesh.format(' scale="0.001 0.001 0.001"')).write(tmp_path))


def limits(lower: float, upper: float) -> str:
    return f'<limit lower="{lower}" upper="{upper}" effort="5" velocity="6"/>'


def test_steering_limits_in_degrees_are_refused_with_their_radians(tmp_path: Path) -> None:
    path = OwnCar(hinge_limit=limits(-30, 30)).write(tmp_path)
    with pytest.raises(RobotError, match=r"from -30 to 30 rad.*if degrees are meant, write -0\.5236 to 0\.5236"):
        load_robot(path)
    with pytest.raises(RobotError, match=r"got '30' rad; if degrees are meant, write 0\.5236"):
        named_robot(path, ["steering_limit_rad=30"])
    assert load_robot(named_robot(path, ["steering_limit_rad=0.5"])).knuckle_limit_rad == 0.5


@pytest.mark.parametrize(
    ("lower", "upper", "taken", "said"),
    [
        (-0.2, 0.6, 0.2, r"left_steering_hinge_joint turns from -0.2 to 0.6 rad; 0.2 to both sides is taken"),
        (-1.57, 1.57, 1.4, r"the hinges may turn by 1.57 rad; 1.4 rad is taken, the most there is"),
    ],
)
def test_a_steering_limit_that_is_not_taken_as_written_is_said(
    tmp_path: Path, lower: float, upper: float, taken: float, said: str
) -> None:
    robot = load_robot(OwnCar(hinge_limit=limits(lower, upper)).write(tmp_path))
    assert robot.knuckle_limit_rad == taken and said in robot.notes
    assert not any("hinge" in note for note in load_robot(OwnCar().write(tmp_path)).notes)


XACRO = (
    '<robot name="own" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="sizes.xacro"/>'
    '<xacro:arg name="radius" default="0.05"/>'
)


def test_a_xacro_argument_that_the_file_does_not_declare_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    text = OwnCar(half_base=0.16).urdf().replace('<robot name="own">', XACRO)
    text = text.replace('radius="0.05"', 'radius="$(arg radius)"').replace('"0.16 ', '"$(arg reach) ')
    (tmp_path / "own.urdf.xacro").write_text(text, encoding="utf-8")
    (tmp_path / "sizes.xacro").write_text(
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="reach" default="0.16"/></robot>',
        encoding="utf-8",
    )
    path = tmp_path / "own.urdf.xacro"
    assert load_robot(path).wheelbase_m == pytest.approx(0.32)
    assert load_robot(named_robot(path, ["xacro.reach=0.20"])).wheelbase_m == pytest.approx(0.36)
    with pytest.raises(RobotError, match=r"has no <xacro:arg> raech; those there are: .*radius, reach"):
        load_robot(named_robot(path, ["xacro.raech=0.20"]))
    with pytest.raises(RobotError, match="is no xacro file, so it takes no arguments, got reach"):
        load_robot(named_robot(OwnCar().write(tmp_path), ["xacro.reach=0.20"]))


def test_a_fault_in_the_roles_file_is_told_of_that_file_with_the_nearest_name(tmp_path: Path) -> None:
    path = OwnCar().write(tmp_path)
    (tmp_path / "own.roles.yaml").write_text("wheel_radius: 0.05\n", encoding="utf-8")
    with pytest.raises(RobotError, match=r"own\.roles\.yaml: .*'wheel_radius' \(did you mean wheel_radius_m\?\)"):
        load_robot(path)


@pytest.mark.parametrize(
    ("car", "pair"),
    [
        (OwnCar(half_rear=-0.12), "left_rear_wheel_joint and right_rear_wheel_joint$"),
        (OwnCar(half_front=-0.12), "left_front_wheel_joint and right_front_wheel_joint and of left_steering_hinge_joi"),
    ],
)
def test_where_left_and_right_are_swapped_on_one_axle_that_pair_is_named(
    tmp_path: Path, car: OwnCar, pair: str
) -> None:
    with pytest.raises(RobotError, match=f"stands on the right of the right one; swap the names of {pair}"):
        load_robot(car.write(tmp_path))


def test_the_lidar_is_guessed_by_its_exact_name_and_the_others_are_named(tmp_path: Path) -> None:
    car = OwnCar(names={**ROS_JOINTS, "lidar_mount": "laser"})
    root = car.root + fixed("lidar_cable", "base_link") + fixed("rear_laser_link", "base_link")
    with pytest.raises(RobotError, match=r"'lidar_mount=laser' \(the lidar may also be rear_laser_link, lidar_cable\)"):
        load_robot(replace(car, root=root).write(tmp_path))


def test_a_capsule_is_refused_by_its_link_and_left_out_where_it_is_only_painted(tmp_path: Path) -> None:
    geometry = '<geometry><capsule radius="0.04" length="0.2"/></geometry>'
    solid = OwnCar(more=fixed("bumper", "base_link", f"<collision>{geometry}</collision>"))
    with pytest.raises(RobotError, match="link bumper: <capsule> is not read; write box, cylinder, sphere or mesh"):
        load_robot(solid.write(tmp_path))
    painted = OwnCar(more=fixed("bumper", "base_link", f"<visual>{geometry}</visual>"))
    assert any("bumper: a painted <capsule>" in note for note in load_robot(painted.write(tmp_path)).notes)


def test_a_grip_of_its_own_is_left_out_alike_in_every_simulator_and_that_is_said(tmp_path):
    text = (Path(__file__).parent / "data" / "small_car.urdf").read_text(encoding="utf-8")
    slippery = tmp_path / "slippery.urdf"
    slippery.write_text(text.replace('<lateral_friction value="1.0"/>', '<lateral_friction value="0.1"/>'), "utf-8")
    seen = inspect_robot(slippery)
    assert len(seen.notes) == 1 and "(0.1) is left out: tyres grip the floor by 1 in every simulator" in seen.notes[0]
    assert seen.robot.plain_urdf and 'lateral_friction value="1.0"' in seen.robot.plain_urdf
    assert not load_robot(Path(__file__).parent / "data" / "small_car.urdf").plain_urdf


def test_a_car_on_wide_wheels_is_driven_on_thin_ones_for_wide_ones_rub(tmp_path):
    text = (Path(__file__).parent / "data" / "small_car.urdf").read_text(encoding="utf-8")
    wide = tmp_path / "wide.urdf"
    wide.write_text(text.replace('radius="0.06" length="0.006"', 'radius="0.06" length="0.03"'), "utf-8")
    assert 'length="0.004"' in load_robot(wide).plain_urdf
