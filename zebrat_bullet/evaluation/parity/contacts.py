"""Contact at the same pose: the planar car's, PyBullet's, and what the polygons say."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from zebrat_bullet.arrays import on_host
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.evaluation.parity.drives import planar_cars
from zebrat_bullet.geometry import footprint_hits, to_world
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.task.episode import anywhere_poses
from zebrat_bullet.types import Pose2
from zebrat_bullet.world.world import World

NEAR_M, NEARER_M = 0.03, 0.001
HAIR_M = 1e-4
"""An outline this much wider or narrower decides what is a close call."""


@dataclass(frozen=True, kw_only=True)
class Contacts:
    """(P,) bool each, half of the poses within `NEAR_M` of touching, half within `NEARER_M`.

    Attributes:
        exact: outline and walls meet, as polygons.
        planar, bullet: what the two cars say.
        close: the polygons' answer is another for an outline `HAIR_M` wider or narrower.
    """

    exact: NDArray[np.bool_]
    planar: NDArray[np.bool_]
    bullet: NDArray[np.bool_]
    close: NDArray[np.bool_]


def compare_contacts(world: World, task: TaskConfig, n: int, seed: int) -> Contacts:
    """Ask all three about n poses near the walls of a world."""
    robot = load_robot(task.robot)
    poses = _near_poses(world, robot, n, np.random.default_rng(seed))
    exact, wider, narrower = (
        np.array([footprint_hits(world.walls, outline, pose) for pose in poses])
        for outline in (_grown(robot, 0.0), _grown(robot, HAIR_M), _grown(robot, -HAIR_M))
    )
    cars = planar_cars(np.array([(pose.x, pose.y, pose.yaw) for pose in poses]), world, task)
    cars.step()  # at rest, asked for nothing: a car stays where it is
    simulation = Simulation(robot, task.physics)
    simulation.set_world(world)
    bullet = []
    for pose in poses:
        simulation.reset(pose)
        bullet.append(bool(simulation.touches()))
    simulation.close()
    return Contacts(exact=exact, planar=on_host(cars.contact).copy(), bullet=np.array(bullet), close=wider & ~narrower)


def _near_poses(world: World, robot: RobotModel, n: int, rng: np.random.Generator) -> list[Pose2]:
    """Draw poses along the centre line and move each car straight towards its nearest wall, until about there."""
    poses = []
    for row in anywhere_poses(world, robot, rng, n):
        pose = Pose2(*row.tolist())
        line = shapely.shortest_line(shapely.Polygon(to_world(robot.footprint_base, pose)), world.walls)
        begin, end = shapely.get_coordinates(line)
        reach = rng.choice((NEAR_M, NEARER_M))
        x, y = (end - begin) * (1.0 + rng.uniform(-reach, reach) / line.length)
        poses.append(Pose2(pose.x + x, pose.y + y, pose.yaw))
    return poses


def _grown(robot: RobotModel, by_m: float) -> NDArray[np.float64]:
    outline = shapely.Polygon(robot.footprint_base).buffer(by_m, join_style="mitre")
    return shapely.get_coordinates(outline)[:-1]
