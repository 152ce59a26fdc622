"""Pictures of the car in its world, drawn off screen through OSMesa."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import yourdfpy

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.errors import MissingSystemLibraryError, RenderError
from zebrat_bullet.render import Frame, Renderer, live_frame
from zebrat_bullet.render.car import Car
from zebrat_bullet.render.osmesa import WINDOW_CLASS, require_osmesa
from zebrat_bullet.render.scene import gap_color
from zebrat_bullet.render.shading import shade
from zebrat_bullet.robot import load_robot
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Clearance, Command, FlatScan, Pose2
from zebrat_bullet.world import load_world

WIDTH, HEIGHT = 480, 270
N_BEARINGS = 32

DRAW_AND_TELL = """
from zebrat_bullet.render import Frame, Renderer
from zebrat_bullet.robot import load_robot
from zebrat_bullet.world import load_world

world = load_world("track_2")
renderer = Renderer(load_robot(), world, 320, 180)
assert len(set(map(tuple, renderer.frame(Frame(pose=world.start.pose)).reshape(-1, 3)))) > 50, "the picture is empty"
print(renderer.window_class, renderer.capabilities())
print(*{line.split()[-1] for line in open("/proc/self/maps") if ".so" in line})
"""


@pytest.fixture(scope="module")
def world():
    return load_world("track_2")


@pytest.fixture(scope="module")
def renderer(world):
    drawn = Renderer(load_robot(), world, WIDTH, HEIGHT)
    yield drawn
    drawn.close()


@pytest.fixture
def frame(world):
    return Frame(pose=world.start.pose)


def _views(picture):
    """The two views without the panel, as signed numbers."""
    return picture[: round(0.8 * HEIGHT)].astype(int)


def _n_changed(before, after):
    return int((np.abs(_views(before) - _views(after)).max(axis=2) > 20).sum())


def _clearance(gap_m):
    outline = np.full(N_BEARINGS, 0.3, np.float32)
    return Clearance(outline + np.float32(gap_m), outline, gap_m <= 0.0)


def test_osmesa_and_not_egl_draws_the_frame_in_software():
    told = subprocess.run([sys.executable, "-c", DRAW_AND_TELL], capture_output=True, text=True, check=True).stdout
    assert WINDOW_CLASS in told
    assert "llvmpipe" in told or "softpipe" in told
    assert "libOSMesa" in told
    assert "libEGL" not in told


def test_torch_makes_an_optimizer_after_a_picture():
    """Triton, a part of torch's CUDA builds, crashed when it was loaded after OSMesa; the CPU builds have none."""
    optimizer = "import torch; torch.optim.Adam([torch.zeros(1, requires_grad=True)]); print('made')"
    done = subprocess.run([sys.executable, "-c", DRAW_AND_TELL + optimizer], capture_output=True, text=True)
    assert done.returncode == 0 and "made" in done.stdout, done.stderr


def test_a_missing_osmesa_names_the_package_to_install():
    with pytest.raises(MissingSystemLibraryError, match="apt-get install libosmesa6"):
        require_osmesa(("libNoSuchMesa.so.8",))


def test_a_picture_has_the_size_asked_for_and_many_colours(renderer, frame):
    picture = renderer.frame(frame)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    assert picture.dtype == np.uint8
    assert len(np.unique(_views(picture).reshape(-1, 3), axis=0)) > 50


def test_a_picture_too_small_for_its_parts_is_refused(world):
    with pytest.raises(RenderError, match="at least"):
        Renderer(load_robot(), world, 100, 50)


def test_the_same_frame_gives_the_same_picture_whatever_was_drawn_before(renderer, frame):
    first = renderer.frame(frame)
    again = renderer.frame(frame)
    renderer.frame(replace(frame, pose=Pose2(2.0, 1.0, 1.0)))
    back = renderer.frame(frame)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, back)


def test_two_renderers_do_not_touch_each_other(renderer, world, frame):
    alone = renderer.frame(frame)
    other = Renderer(load_robot(), world, 320, 180)
    other.frame(replace(frame, pose=Pose2(2.0, 1.0, 1.0)))
    other.close()
    np.testing.assert_array_equal(renderer.frame(frame), alone)


def test_the_car_turns_in_the_picture(renderer, frame):
    turned = replace(frame, pose=Pose2(frame.pose.x, frame.pose.y, frame.pose.yaw + 0.5))
    assert _n_changed(renderer.frame(frame), renderer.frame(turned)) > 500


def test_steered_wheels_change_the_picture(renderer, frame):
    straight = renderer.frame(frame)
    assert _n_changed(straight, renderer.frame(replace(frame, knuckle_rad=np.array([0.6, 0.5])))) > 5


def test_a_front_wheel_steers_about_the_vertical_and_rolls_about_its_axle():
    robot = load_robot()
    car = Car(robot)
    yaw, knuckle, roll = 0.3, 0.5, 0.2
    car.place(Pose2(1.0, 2.0, yaw), np.array([knuckle, 0.4]), np.array([0.0, 0.0, roll, 0.0]))
    ahead, aside = robot.rear_axle_x_m + robot.wheelbase_m, robot.track_m / 2
    hub = [
        1.0 + ahead * np.cos(yaw) - aside * np.sin(yaw),
        2.0 + ahead * np.sin(yaw) + aside * np.cos(yaw),
        robot.wheel_radius_m,
    ]
    poses = [np.reshape(actor.GetUserMatrix().GetData(), (4, 4)) for actor in car.actors]
    (wheel,) = [pose for pose in poses if np.allclose(pose[:3, 3], hub, atol=1e-6) and abs(pose[2, 0]) > 1e-9]
    heading = yaw + knuckle
    np.testing.assert_allclose(wheel[:3, 1], [-np.sin(heading), np.cos(heading), 0.0], atol=1e-9)
    np.testing.assert_allclose(wheel[2, 0], -np.sin(roll), atol=1e-9)


def test_a_mesh_in_the_urdf_is_drawn_in_the_colour_of_its_material(tmp_path, world, frame):
    ball = trimesh.creation.icosphere(radius=0.2)
    ball.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.SimpleMaterial(diffuse=[255, 0, 0]))
    ball.export(tmp_path / "ball.obj")
    visual = '<visual><origin xyz="0 0 1"/><geometry><mesh filename="ball.obj"/></geometry></visual>'
    urdf = load_robot().urdf_path.read_text(encoding="utf-8")
    root = yourdfpy.URDF.load(str(load_robot().urdf_path), load_meshes=False).base_link
    (tmp_path / "balloon.urdf").write_text(
        urdf.replace(f'<link name="{root}">', f'<link name="{root}">{visual}', 1), encoding="utf-8"
    )
    renderer = Renderer(load_robot(str(tmp_path / "balloon.urdf")), world, WIDTH, HEIGHT)
    picture = _views(renderer.frame(frame))
    renderer.close()
    red = (picture[..., 0] > 90) & (picture[..., 1:].max(axis=2) < 30)
    assert red.sum() > 200


def test_cloud_scan_and_path_each_change_the_picture(renderer, frame):
    plain = renderer.frame(frame)
    x, y = frame.pose.x, frame.pose.y
    cloud = np.column_stack([x + np.linspace(-1, 1, 200), np.full(200, y), np.full(200, 0.9)])
    assert _n_changed(plain, renderer.frame(replace(frame, cloud_world=cloud))) > 20
    scan = FlatScan(np.full(360, 0.45, np.float32), 6.0)
    assert _n_changed(plain, renderer.frame(replace(frame, scan=scan))) > 20
    path = np.array([[x - 2.0, y + 0.1], [x - 1.0, y + 0.4], [x, y]])
    assert _n_changed(plain, renderer.frame(replace(frame, path_world=path))) > 20


def test_bearings_without_a_return_are_not_drawn(renderer, frame):
    nothing_seen = FlatScan(np.full(360, 6.0, np.float32), 6.0)
    assert _n_changed(renderer.frame(frame), renderer.frame(replace(frame, scan=nothing_seen))) == 0


def test_the_safety_region_turns_from_green_to_red_as_it_is_approached(renderer, frame):
    free = _views(renderer.frame(replace(frame, clearance=_clearance(0.5))))
    close = _views(renderer.frame(replace(frame, clearance=_clearance(0.005))))
    changed = np.abs(free - close).max(axis=2) > 60
    assert changed.sum() > 50
    assert (free[changed][:, 1] > free[changed][:, 0]).mean() > 0.9
    assert (close[changed][:, 0] > close[changed][:, 1]).mean() > 0.9


def test_region_colours_are_red_at_touch_and_green_when_free():
    red, green = gap_color(0.0), gap_color(1.0)
    assert red[0] > 0.9 and red[1] < 0.3
    assert green[1] > 0.8 and green[0] < 0.3


def test_walls_of_every_bearing_are_lit():
    bearings = np.linspace(-np.pi, np.pi, 73)
    normals = np.column_stack([np.cos(bearings), np.sin(bearings), np.zeros(73)])
    assert shade(np.full((73, 3), 200.0), normals).min() >= 0.4 * 200.0


def test_the_panel_shows_terms_and_outcome(renderer, frame):
    def panel(shown):
        return renderer.frame(shown)[round(0.84 * HEIGHT) :].astype(int)

    plain = panel(frame)
    for shown in (replace(frame, terms={"F": 5.0, "O": -5.0}), replace(frame, status="success")):
        assert (np.abs(panel(shown) - plain).max(axis=2) > 40).sum() > 20


def test_drawing_a_live_drive_does_not_change_it(world, renderer):
    def drive_three_steps(draw):
        drive = Drive(TaskConfig(), world)
        reading = drive.reset(np.random.default_rng(3))
        pictures = []
        for _ in range(3):
            reading = drive.step(Command(0.3, 0.1)).reading
            if draw:
                pictures.append(renderer.frame(live_frame(drive, reading, [drive.state.pose])))
        drive.close()
        return drive.state, reading, pictures

    state, reading, pictures = drive_three_steps(draw=True)
    undrawn_state, undrawn_reading, _ = drive_three_steps(draw=False)
    assert state.pose == undrawn_state.pose
    np.testing.assert_array_equal(reading.scan.ranges_m, undrawn_reading.scan.ranges_m)
    assert _n_changed(pictures[0], pictures[-1]) > 100
