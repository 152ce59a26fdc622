"""Every track can be driven in one go, forward only, with room to spare: shown by finding such a drive."""

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from zebrat_bullet.assets import list_assets
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.world import World, generate_tracks, load_world

ROBOT = load_robot("zebrat")
STEP_M = 0.2
STEERING_RAD = np.linspace(-0.6, 0.6, 7)


def outlines(axle: NDArray[np.float64], robot: RobotModel, margin_m: float) -> NDArray[np.float64]:
    """Return (N, K, 2) outlines, enlarged by a margin, of cars with (N, 3) rear-axle poses."""
    outline = robot.footprint_base + margin_m * np.sign(robot.footprint_base) - (robot.rear_axle_x_m, 0.0)
    c, s = np.cos(axle[:, 2:]), np.sin(axle[:, 2:])
    x, y = outline.T
    return np.stack([axle[:, :1] + c * x - s * y, axle[:, 1:2] + s * x + c * y], axis=-1)


def furthest_drive(world: World, margin_m: float, beam: int = 200) -> float:
    """Search forward drives of circular arcs that touch nothing.

    Returns:
        How far along the centre line (0 to 1) the best of them comes.
    """
    line = world.centre_line
    distance = np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T).cumsum()])
    tree = cKDTree(line)
    shapely.prepare(world.walls)
    rng = np.random.default_rng(0)
    pose, rear = world.start.pose, ROBOT.rear_axle_x_m
    cars = np.array([[pose.x + rear * np.cos(pose.yaw), pose.y + rear * np.sin(pose.yaw), pose.yaw]])
    progress = np.zeros(1)
    bend = STEP_M * np.tan(STEERING_RAD) / ROBOT.wheelbase_m
    best = 0.0
    for _ in range(int(2.0 * distance[-1] / STEP_M)):
        turn = np.tile(bend, len(cars))
        before = np.repeat(progress, len(bend))
        cars = np.repeat(cars, len(bend), axis=0)
        half = cars[:, 2] + turn / 2
        cars = cars + np.column_stack([STEP_M * np.cos(half), STEP_M * np.sin(half), turn])
        free = ~shapely.intersects(shapely.polygons(outlines(cars, ROBOT, margin_m)), world.walls)
        centre = cars[:, :2] - rear * np.column_stack([np.cos(cars[:, 2]), np.sin(cars[:, 2])])
        progress = distance[tree.query(centre)[1]]
        free &= np.abs(progress - before) < 1.0
        if not free.any():
            return best
        cars, progress, centre = cars[free], progress[free], centre[free]
        best = max(best, float(progress.max() / distance[-1]))
        if progress.max() > distance[-1] - 0.3:
            return 1.0
        cells = np.round(np.column_stack([centre / 0.05, cars[:, 2] / 0.07])).astype(int)
        unique = np.unique(cells, axis=0, return_index=True)[1]
        keep = unique[np.argsort(0.3 * rng.random(len(unique)) - progress[unique])[:beam]]
        cars, progress = cars[keep], progress[keep]
    return best


@pytest.mark.parametrize("name", list_assets("worlds", ".yaml"))
def test_a_shipped_world_can_be_driven_in_one_go_with_six_centimetres_to_spare(name: str) -> None:
    assert furthest_drive(load_world(name), margin_m=0.06) == 1.0


def test_generated_tracks_can_be_driven_in_one_go() -> None:
    reached = [furthest_drive(world, margin_m=0.0) for world in generate_tracks(range(20))]
    assert reached == [1.0] * 20
