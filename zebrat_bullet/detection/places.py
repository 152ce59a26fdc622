"""Where collisions are studied: any world, or a field of thin posts, and a free pose in either."""

from functools import lru_cache

import numpy as np
import shapely

from zebrat_bullet.config import EpisodeConfig
from zebrat_bullet.errors import ConfigError, WorldError
from zebrat_bullet.geometry import to_world
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.task.episode import draw_pose
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import Start, World, load_world
from zebrat_bullet.world.solid import extrude, join

POSTS = "posts-"
_FIELD_M = 12.0
_SPACING_M = 1.8  # the car gets between two posts, but seldom far
_TRIES = 1000


@lru_cache(maxsize=8)
def load_place(name: str, robot: str = "zebrat") -> World:
    """Load a world, checked with the car that drives there, or make "posts-0.02": round posts of so many metres.

    Raises:
        ConfigError: the diameter is no number between 0.005 and 0.5.
        AssetError, WorldError, RobotError: no such world or car, or a bad one.
    """
    if not name.startswith(POSTS):
        return load_world(name, robot=load_robot(robot))
    try:
        diameter = float(name.removeprefix(POSTS))
    except ValueError:
        diameter = float("nan")
    if not 0.005 <= diameter <= 0.5:
        raise ConfigError(f"a field of posts is named like posts-0.02, 0.005 to 0.5 m in diameter, got {name!r}")
    return _post_field(name, diameter)


def _post_field(name: str, diameter_m: float) -> World:
    """Return posts on a jittered grid; the same places whatever the diameter."""
    rng = np.random.default_rng(0)
    grid = np.arange(-_FIELD_M / 2, _FIELD_M / 2 + 0.01, _SPACING_M)
    places = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    places += rng.uniform(-0.3, 0.3, places.shape)
    posts = [shapely.Point(place).buffer(diameter_m / 2, quad_segs=6) for place in places]
    walls = shapely.MultiPolygon(posts)
    return World(
        name=name,
        description=f"round posts, {diameter_m} m in diameter",
        mesh=join([extrude(post, 0.0, 1.0) for post in posts]),
        walls=walls,
        low_obstacles=shapely.MultiPolygon(),
        free_space=shapely.box(*walls.bounds).difference(walls),
        centre_line=np.zeros((0, 2)),
        widths_m=np.zeros(0),
        start=Start(Pose2(0.0, 0.0, 0.0)),
        waypoints=np.zeros((0, 2)),
        open_line=None,
    )


def free_pose(world: World, robot: RobotModel, rng: np.random.Generator) -> Pose2:
    """Draw a pose that touches nothing: along the centre line, or anywhere where there is none.

    Raises:
        WorldError: none was found.
    """
    if len(world.centre_line):
        return draw_pose(world, robot, EpisodeConfig(start="anywhere"), rng)
    shapely.prepare(world.walls)
    low_x, low_y, high_x, high_y = world.free_space.bounds
    for _ in range(_TRIES):
        pose = Pose2(rng.uniform(low_x, high_x), rng.uniform(low_y, high_y), rng.uniform(-np.pi, np.pi))
        outline = shapely.Polygon(to_world(robot.footprint_base, pose))
        if world.free_space.covers(outline.centroid) and shapely.distance(outline, world.walls) > 0.1:
            return pose
    raise WorldError(f"world {world.name!r}: the car found no free pose in {_TRIES} tries; its walls stand too close")
