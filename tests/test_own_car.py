"""A car as others write it loads once its roles are named, drives as it must, and is refused with all its faults."""

import json
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from own_cars import ROS_JOINTS, OwnCar
from planar_cars import FIELD, drive, planar, stand

from zebrat_bullet.assets import asset_folder
from zebrat_bullet.cli import main
from zebrat_bullet.config import PhysicsConfig, TaskConfig
from zebrat_bullet.config_text import from_json, to_json
from zebrat_bullet.errors import RobotError
from zebrat_bullet.robot import fitted, inspect_robot, load_robot, most_steering_rad, named_robot
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command, Pose2
from zebrat_bullet.world import load_world

JOINTS = [f"{role}={name}" for role, name in ROS_JOINTS.items()]
CYLINDER = '<geometry><cylinder radius="0.05" length="0.03"/></geometry>'
TILTED = '<inertial><origin rpy="0 0.3 0" xyz="0 0 0.1"/><mass value="4"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'  # noqa: E501


def turning_radius(source: str, simulate: Callable[..., Simulation]) -> tuple[float, float, float]:
    """Return radius at full lock of the rear axle's centre, the one of the bicycle model, and the speed reached."""
    robot = load_robot(source)
    sim = simulate(robot=robot)
    lock = min(0.6, most_steering_rad(robot))
    sim.reset(Pose2(0.0, 0.0, 0.0))
    points = []
    for step in range(45):
        state = sim.step(Command(0.4, lock))
        if step >= 10:
            x, y, yaw = state.pose.x, state.pose.y, state.pose.yaw
            points.append((x + robot.rear_axle_x_m * math.cos(yaw), y + robot.rear_axle_x_m * math.sin(yaw)))
    at = np.array(points)
    a, b, c = np.linalg.lstsq(np.column_stack([2 * at, np.ones(len(at))]), (at**2).sum(axis=1), rcond=None)[0]
    return math.sqrt(c + a * a + b * b), robot.wheelbase_m / math.tan(lock), state.speed_mps


CARS = {
    "plain": OwnCar(),
    "other joint names": OwnCar(names=dict(ROS_JOINTS)),
    "axis along link z, rpy on the joint": OwnCar(
        wheel=f"<collision>{CYLINDER}</collision>", wheel_origin="1.5708 0 0", wheel_axis="0 0 1"
    ),
    "axis against y, hinge axis down": OwnCar(wheel_axis="0 -1 0", hinge_axis="0 0 -1"),
    "hinge axis along x, turned up by its joint": OwnCar(
        hinge_axis="-1 0 0",
        hinge_rpy="0 1.5707963 0",
        wheel=f"<collision>{CYLINDER}</collision>",
        wheel_axis="0 0 -1",
        wheel_origin="1.5707963 0 0",
    ),
    "sphere wheels": OwnCar(wheel='<collision><geometry><sphere radius="0.05"/></geometry></collision>'),
    "front and rear track differ": OwnCar(half_front=0.11, half_rear=0.13),
    "wheels outside of their hinges": OwnCar(half_front=0.09, front_wheel_xyz=(0.0, 0.03, 0.0)),
    "wheels not quite on their hinges": OwnCar(front_wheel_xyz=(0.004, 0.002, 0.0)),
    "offset cylinders": OwnCar(
        wheel=f'<collision><origin xyz="0 0.02 0" rpy="1.5707963 0 0"/>{CYLINDER}</collision>',
    ),
    "painted wheels only": OwnCar(wheel=f'<visual><origin rpy="1.5707963 0 0"/>{CYLINDER}</visual>'),
    "massless root": OwnCar(
        root='<link name="base_footprint"/><link name="base_link">{inertial}{collision}</link>'
        '<joint name="lift" type="fixed"><parent link="base_footprint"/><child link="base_link"/></joint>'
    ),
    "base frame above the floor": OwnCar(
        wheel_z=-0.03, collision='<collision><geometry><box size="0.45 0.3 0.1"/></geometry></collision>',
        lidar='<origin xyz="0.1 0 0.15"/>',
    ),
    "body looks along y": OwnCar(
        root='<link name="world_box"/><link name="base_link">{inertial}{collision}</link>'
        '<joint name="turn" type="fixed"><parent link="world_box"/><child link="base_link"/>'
        '<origin rpy="0 0 1.57" xyz="1 2 0"/></joint>'
    ),
    "no inertia of the wheels": OwnCar(wheel_inertial=""),
    "no limits of the wheels": OwnCar(wheel_limit=""),
    "limits of exporters": OwnCar(
        wheel_limit='<limit effort="10000000" velocity="1000000"/>',
        hinge_limit='<limit lower="-0.9" upper="0.9" effort="10000000" velocity="1000000"/>',
    ),
    "continuous hinge with limits": OwnCar(hinge_type="continuous"),
    "tilted inertia": OwnCar(inertial=TILTED),
    "mimic, transmission, gazebo": OwnCar(
        hinge_limit='<limit lower="-0.9" upper="0.9" effort="5" velocity="6"/><mimic joint="left_rear_wheel_joint"/>',
        more='<transmission name="t"><type>x</type></transmission><gazebo reference="base_link"><mu1>1</mu1></gazebo>',
    ),
    "steering wheel, free joint": OwnCar(
        more='<link name="steering_wheel"/><joint name="column" type="continuous"><parent link="base_link"/>'
        '<child link="steering_wheel"/><origin xyz="0 0 0.2"/></joint>'
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CARS)
def test_a_car_of_usual_practice_turns_on_the_circle_of_its_axles(
    name: str, tmp_path: Path, simulate: Callable[..., Simulation]
) -> None:
    """L = 0.32 m: at 0.6 rad the rear axle's centre runs on a circle of 0.468 m, whatever frames its URDF chose."""
    car = CARS[name]
    source = str(car.write(tmp_path))
    source = named_robot(source, JOINTS) if car.names == ROS_JOINTS else source
    radius, wanted, speed = turning_radius(source, simulate)
    assert wanted == pytest.approx(0.32 / math.tan(0.6), rel=0.03)  # not quite on their hinges: 0.324 m
    assert radius == pytest.approx(wanted, rel=0.02)
    assert speed == pytest.approx(0.4, rel=0.03)


def test_mesh_wheels_and_package_names_are_found(tmp_path: Path, simulate: Callable[..., Simulation]) -> None:
    (tmp_path / "my_car" / "urdf").mkdir(parents=True)
    (tmp_path / "my_car" / "meshes").mkdir()
    trimesh.creation.cylinder(50.0, 30.0, sections=48).export(tmp_path / "my_car" / "meshes" / "wheel.stl")
    mesh = '<mesh filename="package://my_car/meshes/wheel.stl" scale="0.001 0.001 0.001"/>'
    gone = '<visual><geometry><mesh filename="package://elsewhere/body.dae"/></geometry></visual>'
    car = OwnCar(
        wheel=f'<collision><origin rpy="1.5707963 0 0"/><geometry>{mesh}</geometry></collision>',
        root='<link name="base_link">{inertial}{collision}' + gone + "</link>",
    )
    path = car.write(tmp_path / "my_car" / "urdf")
    robot = load_robot(path)
    assert robot.wheel_radius_m == pytest.approx(0.05, rel=1e-3)
    assert any("elsewhere" in note for note in robot.notes)
    radius, wanted, _ = turning_radius(str(path), simulate)
    assert radius == pytest.approx(wanted, rel=0.02)


def test_zebrat_with_turned_wheel_joints_drives_as_zebrat(
    tmp_path: Path, robot: object, simulate: Callable[..., Simulation]
) -> None:
    text = (asset_folder("urdf") / "zebrat.urdf").read_text(encoding="utf-8")
    turned = text.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 1"/>').replace('<origin rpy="1.5707963267948966 0 0"/>\n      <geometry><cylinder radius="0.15"', '<geometry><cylinder radius="0.15"')  # noqa: E501  # fmt: skip
    for at in ("-0.271 0.245 0.15", "-0.271 -0.245 0.15", "0 0 0"):
        turned = turned.replace(f'<origin xyz="{at}"/>\n    <axis', f'<origin xyz="{at}" rpy="1.5708 0 0"/>\n    <axis')
    path = tmp_path / "turned.urdf"
    path.write_text(turned, encoding="utf-8")
    ends = []
    for source in ("zebrat", str(path)):
        sim = simulate(robot=load_robot(source))
        sim.reset(Pose2(0.0, 0.0, 0.0))
        for _ in range(15):
            state = sim.step(Command(0.5, 0.3))
        ends.append((state.pose.x, state.pose.y, state.pose.yaw))
    assert abs(ends[0][1]) > 0.2
    np.testing.assert_allclose(ends[1], ends[0], atol=0.01)


def test_wheels_that_stand_across_their_axles_are_refused_with_the_mend(tmp_path: Path) -> None:
    path = OwnCar(wheel=f"<collision>{CYLINDER}</collision>").write(tmp_path)
    with pytest.raises(RobotError, match=r"left_rear_wheel.*across its axle.*turn the cylinder"):
        load_robot(path)


def test_the_planar_car_turns_as_its_axles_say_too(tmp_path: Path) -> None:
    car = OwnCar(half_front=0.08, half_rear=0.13, front_wheel_xyz=(0.0, 0.02, 0.0))
    path = car.write(tmp_path)
    robot = load_robot(path)
    assert (robot.track_m, robot.front_track_m) == pytest.approx((0.26, 0.2))
    sim = planar(FIELD, task=TaskConfig(robot=str(path)))
    stand(sim, (0.0, 0.0, 0.0))
    poses = drive(sim, [(0.4, 0.5)] * 40)[:, 0]
    at = poses[10:, :2] + robot.rear_axle_x_m * np.stack([np.cos(poses[10:, 2]), np.sin(poses[10:, 2])], axis=1)
    a, b, c = np.linalg.lstsq(np.column_stack([2 * at, np.ones(len(at))]), (at**2).sum(axis=1), rcond=None)[0]
    assert math.sqrt(c + a * a + b * b) == pytest.approx(0.32 / math.tan(0.5), rel=0.02)


def test_all_faults_are_said_at_once_each_with_its_mend(tmp_path: Path) -> None:
    car = OwnCar(
        inertial='<inertial><mass value="nan"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>',
        hinge_limit='<limit lower="-0.7" upper="0.7" effort="0" velocity="-1"/>',
        wheel_limit='<limit effort="2" velocity="inf"/>',
        collision='<collision><origin xyz="0 0 0.02"/><geometry><box size="0.45 0.3 0.12"/></geometry></collision>',
    )
    with pytest.raises(RobotError) as refused:
        load_robot(car.write(tmp_path))
    for words in ("mass", "finite", "effort above 0", "velocity above 0", "below the floor", "body_mass_kg="):
        assert words in str(refused.value)


@pytest.mark.parametrize(
    ("car", "reason"),
    [
        (OwnCar(half_base=280.0), r"wheelbase is 560.* metres"),
        (OwnCar(hinge_type="continuous", hinge_limit=""), "steering_limit_rad="),
        (OwnCar(hinge_limit='<limit lower="0" upper="0" effort="5" velocity="6"/>'), "steering_limit_rad="),
        (OwnCar(inertial=""), "body_mass_kg="),
        (OwnCar(wheel='<collision><geometry><box size="0.1 0.03 0.1"/></geometry></collision>'), "does not roll"),
        (OwnCar(wheel_axis="1 0 0"), "axis of left_rear_wheel_joint"),
        (OwnCar(hinge_axis="0 1 0"), "axis of left_steering_hinge_joint .*upright"),
        (OwnCar(half_rear=-0.12, half_front=-0.12), "swap the names of left and right"),
        (OwnCar(inertial=OwnCar().inertial.replace('"0 0 0.1"', '"0.5 0 0.1"')), "tip over"),
        (OwnCar(wheel=""), "wheel_radius_m="),
    ],
)
def test_nonsense_is_refused(tmp_path: Path, car: OwnCar, reason: str) -> None:
    if car.wheel_axis == "1 0 0":
        car = replace(car, wheel='<collision><geometry><sphere radius="0.05"/></geometry></collision>')
    with pytest.raises(RobotError, match=reason):
        load_robot(car.write(tmp_path))


def test_what_a_urdf_lacks_can_be_said(tmp_path: Path) -> None:
    car = OwnCar(hinge_type="continuous", hinge_limit="", inertial="", wheel="", wheel_inertial="")
    said = ["steering_limit_rad=0.4", "body_mass_kg=3", "wheel_radius_m=0.05", "wheel_speed_radps=8"]
    robot = load_robot(named_robot(str(car.write(tmp_path)), said))
    assert robot.knuckle_limit_rad == 0.4 and robot.wheel_radius_m == 0.05 and robot.wheel_speed_radps == 8.0


@pytest.mark.parametrize(
    ("removed", "kind"),
    [
        (("right_steering_hinge_joint", "right_front_wheel_joint"), "bicycle or tricycle"),
        (("left_steering_hinge_joint", "right_steering_hinge_joint"), "steers with no joint"),
        (("left_front_wheel_joint", "right_front_wheel_joint"), "without front wheels"),
    ],
)
def test_other_vehicles_are_refused_by_name(tmp_path: Path, removed: tuple[str, str], kind: str) -> None:
    text = OwnCar(names=dict(ROS_JOINTS)).urdf()
    for role in removed:
        text = text.replace(f'name="{ROS_JOINTS[role]}" type="continuous"', f'name="{ROS_JOINTS[role]}" type="fixed"')
        text = text.replace(f'name="{ROS_JOINTS[role]}" type="revolute"', f'name="{ROS_JOINTS[role]}" type="fixed"')
    path = tmp_path / "other.urdf"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RobotError, match=kind):
        load_robot(path)


def test_roles_stand_in_a_yaml_beside_the_urdf_or_on_the_command_line(tmp_path: Path) -> None:
    path = OwnCar(names=dict(ROS_JOINTS)).write(tmp_path, "mine.urdf")
    with pytest.raises(RobotError, match=r"--joints 'left_steering_hinge_joint=front_left_steer'.*lidar_mount=laser"):
        load_robot(path)
    named = load_robot(named_robot(path, JOINTS))
    (tmp_path / "mine.roles.yaml").write_text(
        "\n".join(f"{role}: {name}" for role, name in ROS_JOINTS.items()), encoding="utf-8"
    )
    written = load_robot(path)
    assert named.wheelbase_m == written.wheelbase_m == pytest.approx(0.32)
    assert load_robot(named_robot(path, ["footprint=hull"])).source.endswith("mine.urdf:footprint=hull")


def test_unknown_roles_and_values_are_refused_together(tmp_path: Path) -> None:
    path = OwnCar().write(tmp_path)
    with pytest.raises(RobotError, match=r"footprint must be one.*left_wheel.*there are left_steering_hinge_joint"):
        named_robot(path, ["left_wheel=x", "footprint=small"])


def test_the_footprint_covers_what_stands_outside_of_the_collision_shapes(tmp_path: Path) -> None:
    painted = '<visual><origin xyz="0 0 0.12"/><geometry><box size="0.45 0.30 0.12"/></geometry></visual>'
    small = '<collision><origin xyz="0.1 0 0.2"/><geometry><box size="0.19 0.17 0.1"/></geometry></collision>'
    car = OwnCar(
        root='<link name="base_link">{inertial}' + painted + "</link>",
        more=f'<link name="sensors">{small}</link><joint name="s" type="fixed"><parent link="base_link"/>'
        '<child link="sensors"/></joint>',
    )
    path = car.write(tmp_path)
    robot = load_robot(path)
    np.testing.assert_allclose(np.ptp(robot.footprint_base, axis=0), (0.45, 0.30), atol=1e-6)
    assert any("base_link" in note and "hull" in note for note in robot.notes)
    alone = load_robot(named_robot(path, ["footprint=collision"]))
    np.testing.assert_allclose(np.ptp(alone.footprint_base, axis=0), (0.19, 0.17), atol=1e-6)


def test_physics_touches_a_wall_where_the_footprint_does(tmp_path: Path, simulate: Callable[..., Simulation]) -> None:
    """Wheels outside of the body: the hull, 0.27 m wide, is what a wall meets."""
    car = OwnCar(
        collision='<collision><origin xyz="0 0 0.12"/><geometry><box size="0.45 0.1 0.12"/></geometry></collision>'
    )
    robot = load_robot(car.write(tmp_path))
    world = load_world("track_2")
    sim = simulate(robot=robot)
    sim.set_world(world)
    half = np.ptp(robot.footprint_base[:, 1]) / 2.0
    wall = 0.7  # the first corridor of track_2 is 1.4 m wide, along x
    for gap, touches in ((0.005, False), (-0.005, True)):
        sim.reset(Pose2(1.5, wall - half - gap, 0.0))
        assert bool(sim.touches()) is touches


def test_limits_of_the_urdf_count_where_they_are_lower(tmp_path: Path, simulate: Callable[..., Simulation]) -> None:
    car = OwnCar(
        wheel_limit='<limit effort="2" velocity="4"/>',
        hinge_limit='<limit lower="-0.3" upper="0.3" effort="5" velocity="6"/>',
    )
    path = car.write(tmp_path)
    robot = load_robot(path)
    task = fitted(TaskConfig(robot=str(path)))
    assert task.physics.max_speed_mps == pytest.approx(4 * 0.05)
    inner = math.atan2(
        math.tan(task.physics.max_steering_rad), 1 - math.tan(task.physics.max_steering_rad) * 0.12 / 0.32
    )
    assert inner == pytest.approx(0.3, abs=1e-6)
    sim = simulate(robot=robot)
    sim.reset(Pose2(0.0, 0.0, 0.0))
    states = [sim.step(Command(0.6, 0.6)) for _ in range(15)]
    state, spun = states[-1], np.diff([at.wheel_rad for at in states], axis=0) / 0.2
    assert np.abs(spun).max() <= 4.0 * 1.01 and state.speed_mps > 0.15
    assert state.steering_rad == pytest.approx(task.physics.max_steering_rad, abs=0.01)


@pytest.mark.parametrize(
    ("height_m", "said"),
    [
        (3.0, r"sees no wall at all.*lidar_mount"),
        # 0.15 m above the band its beams enter it 0.56 m away: outside the sides of the car, inside its length.
        (
            0.95,
            r"sees walls only beyond the car's outline \(.*right from 0\.5\d m.*left from 0\.5\d m.*\): its beams",
        ),
    ],
)
def test_a_lidar_that_misses_the_height_band_beside_the_car_is_refused(
    tmp_path: Path, height_m: float, said: str
) -> None:
    path = OwnCar(lidar=f'<origin xyz="0.1 0 {height_m}"/>').write(tmp_path)
    with pytest.raises(RobotError, match=said):
        Drive(TaskConfig(robot=str(path)), load_world("track_2"))


@pytest.mark.parametrize(
    ("rpy", "said"),
    [
        ("1.5708 0 0", r"roll 1\.571 .*in \d+ of 360 bearings \(.*right.*left.*\).*level"),
        ("-1.5708 0 -1.5708", r"roll -1\.571 .*in \d+ of 360 bearings \(.*ahead.*\).*no optical one"),
    ],
)
def test_a_lidar_on_its_side_or_in_an_optical_frame_is_refused(tmp_path: Path, rpy: str, said: str) -> None:
    """Its beams leave the height band inside the outline, or hardly beyond it: of walls there it would say "open"."""
    path = OwnCar(lidar=f'<origin xyz="0.1 0 0.25" rpy="{rpy}"/>').write(tmp_path)
    with pytest.raises(RobotError, match=said):
        Drive(TaskConfig(robot=str(path)), load_world("track_2"))


def test_a_lidar_on_its_side_that_sees_a_few_centimetres_beyond_the_outline_is_refused(tmp_path: Path) -> None:
    """Its beams stand 15 degrees off the vertical, and leave the band 0.70 m above it 4 cm beyond the body's side."""
    path = OwnCar(lidar='<origin xyz="0 0 0.1" rpy="1.5708 0 0"/>').write(tmp_path)
    with pytest.raises(RobotError, match=r"none 0\.3 m beyond the car's outline, in \d{2,} of 360 bearings"):
        Drive(TaskConfig(robot=str(path)), load_world("track_2"))


@pytest.mark.parametrize("rpy", ["3.1416 0 0", "0 0.2 0", "0 0 1.5708"])
def test_a_lidar_upside_down_a_little_tilted_or_turned_sees(tmp_path: Path, rpy: str) -> None:
    path = OwnCar(lidar=f'<origin xyz="0.1 0 0.25" rpy="{rpy}"/>').write(tmp_path)
    Drive(TaskConfig(robot=str(path)), load_world("track_2")).close()


def test_records_name_the_car_for_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    OwnCar(names=dict(ROS_JOINTS)).write(tmp_path, "mine.urdf")
    monkeypatch.chdir(tmp_path)
    drive = Drive(TaskConfig(robot=named_robot("mine.urdf", JOINTS)), load_world("track_2"))
    drive.close()
    again = from_json(TaskConfig, to_json(drive.config))
    monkeypatch.chdir("/")
    assert load_robot(again.robot).wheelbase_m == pytest.approx(0.32)


def test_robots_draws_and_tells_what_it_understood_of_a_car_it_refuses(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = OwnCar(names=dict(ROS_JOINTS), inertial="").write(tmp_path, "mine.urdf")
    picture = tmp_path / "mine.png"
    assert main(["robots", str(path), "--draw", "--out", str(picture), "--json", "--quiet"]) == 1
    shown = capfd.readouterr()
    said = json.loads(shown.out.splitlines()[-1])["mine"]
    assert said["wheelbase_m"] == pytest.approx(0.32) and said["width_m"] == pytest.approx(0.30)
    assert len(said["problems"]) == 2 and "body_mass_kg" in shown.err
    assert picture.stat().st_size > 5000
    assert main(["robots", str(path), "--joints", *JOINTS, "body_mass_kg=4", "--json", "--quiet"]) == 0
    said = json.loads(capfd.readouterr().out.splitlines()[-1])["mine"]
    assert said["length_m"] == pytest.approx(0.45) and said["problems"] == []


def test_what_is_no_tree_of_links_is_refused(tmp_path: Path) -> None:
    loop = '<joint name="again" type="fixed"><parent link="scanner"/><child link="base_link"/></joint>'
    for more, reason in ((loop, "loop"), ('<link name="alone"/>', "root links"), (loop.replace("scanner", "x"), "'x'")):
        with pytest.raises(RobotError, match=reason):
            load_robot(OwnCar(more=more).write(tmp_path))


def test_xacro_is_expanded_or_the_way_to_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = OwnCar().urdf().replace('<robot name="own">', '<robot name="own" xmlns:xacro="http://www.ros.org/wiki/xacro">'
                                   '<xacro:property name="r" value="0.05"/>')  # fmt: skip
    (tmp_path / "own.urdf.xacro").write_text(text.replace('radius="0.05"', 'radius="${r}"'), encoding="utf-8")
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "xacrodoc", None)
        with pytest.raises(RobotError, match=r"zebrat-bullet\[xacro\]"):
            load_robot(tmp_path / "own.urdf.xacro")
    pytest.importorskip("xacrodoc")
    assert load_robot(tmp_path / "own.urdf.xacro").wheel_radius_m == pytest.approx(0.05)


def test_the_speed_of_a_car_is_no_less_than_asked_where_its_motors_allow(robot: object) -> None:
    assert fitted(TaskConfig()).physics == PhysicsConfig()


def test_a_car_is_inspected_without_being_driven(tmp_path: Path) -> None:
    seen = inspect_robot(OwnCar(inertial="").write(tmp_path))
    assert seen.robot is None and seen.chassis is not None and seen.body is not None


def test_a_car_in_frames_of_its_own_is_painted_where_it_stands(tmp_path: Path) -> None:
    """Its root looks along y and lies under the floor; its wheel, turned by a quarter, carries a knob ahead of it."""
    from zebrat_bullet.render.car import Car

    knob = '<visual><origin xyz="0 0.2 0"/><geometry><sphere radius="0.01"/></geometry></visual>'
    turned = '<link name="root"/><joint name="t" type="fixed"><parent link="root"/><child link="base_link"/>'
    turned += '<origin rpy="0 0 1.5707963" xyz="0 0 -1"/></joint>'
    car = OwnCar(
        root='<link name="base_link">{inertial}{collision}</link>' + turned,
        wheel=f"<collision>{CYLINDER}</collision>" + knob,
        wheel_origin="1.5707963 0 0",
        wheel_axis="0 0 -1",
    )  # fmt: skip
    robot = load_robot(car.write(tmp_path))
    painted = Car(robot)
    painted.place(Pose2(3.0, 1.0, 0.0), np.zeros(2), np.full(4, math.pi / 2.0))
    boxes = np.array([actor.GetBounds() for actor in painted.actors])  # x, x, y, y, z, z
    middles = boxes.reshape(-1, 3, 2).mean(axis=2)
    rear_left = middles[np.argmin(middles[:, 0] - middles[:, 1])]
    # The knob stood 0.2 m above the axle; rolled forward by a quarter, it is 0.2 m ahead of it.
    np.testing.assert_allclose(rear_left, (3.0 - 0.16 + 0.2, 1.0 + 0.12, 0.05), atol=1e-3)
