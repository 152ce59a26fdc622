"""Where the two views look from."""

import math

import pytest
from vtkmodules.vtkRenderingCore import vtkCamera

from zebrat_bullet.render.cameras import ChaseCamera, TopCamera
from zebrat_bullet.types import Pose2


def _heading(camera):
    (x0, y0, _), (x1, y1, _) = camera.GetPosition(), camera.GetFocalPoint()
    return math.atan2(y1 - y0, x1 - x0)


def test_the_chase_camera_starts_straight_behind_and_above():
    camera = vtkCamera()
    ChaseCamera(camera).follow(Pose2(1.0, 2.0, 0.5), 0.0)
    x, y, z = camera.GetPosition()
    assert _heading(camera) == pytest.approx(0.5)
    assert (x - 1.0) * math.cos(0.5) + (y - 2.0) * math.sin(0.5) < -1.0
    assert z > 2.0


def test_a_wall_half_a_metre_behind_the_car_does_not_hide_its_roof():
    camera = vtkCamera()
    ChaseCamera(camera).follow(Pose2(0.0, 0.0, 0.0), 0.0)
    x, _, z = camera.GetPosition()
    rear_x, roof_z, wall_x, wall_height = -0.5, 0.47, -1.0, 1.0
    share = (wall_x - rear_x) / (x - rear_x)
    assert roof_z + share * (z - roof_z) > wall_height


def test_the_chase_camera_turns_after_the_car_without_a_jolt():
    camera = vtkCamera()
    chase = ChaseCamera(camera)
    chase.follow(Pose2(0.0, 0.0, 3.0), 0.0)
    turned = 3.0 + 0.5  # past pi: the camera must take the short way
    headings = []
    for n in range(1, 101):
        chase.follow(Pose2(0.0, 0.0, turned - 2.0 * math.pi), 0.04 * n)
        headings.append(_heading(camera) % (2.0 * math.pi))
    steps = [b - a for a, b in zip([3.0, *headings], headings, strict=False)]
    assert all(0.0 <= step < 0.05 for step in steps)
    assert headings[-1] == pytest.approx(turned, abs=0.01)


def test_a_new_episode_puts_the_chase_camera_straight_behind_the_car_again():
    camera = vtkCamera()
    chase = ChaseCamera(camera)
    chase.follow(Pose2(0.0, 0.0, 0.0), 5.0)
    chase.follow(Pose2(0.1, 0.0, 1.0), 0.0)
    assert _heading(camera) == pytest.approx(1.0)


def test_the_top_camera_keeps_the_car_in_the_middle_and_north_up():
    camera = vtkCamera()
    TopCamera(camera).follow(Pose2(3.0, -2.0, 1.0))
    assert camera.GetFocalPoint()[:2] == camera.GetPosition()[:2] == (3.0, -2.0)
    assert camera.GetViewUp() == (0.0, 1.0, 0.0)
