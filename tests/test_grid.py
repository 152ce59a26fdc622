"""Occupancy grids: which cells walls fill, what ROS makes them cost, and maps that come back as the same walls."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely

from zebrat_bullet.planning.grid import OccupancyGrid, inflate, inscribed_radius_m, write_ros_map
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.world import load_world

WALL = shapely.MultiPolygon([shapely.box(0.0, 0.0, 0.1, 1.0)])


def post(resolution_m: float = 0.05) -> OccupancyGrid:
    """A grid of 41 x 41 cells with one occupied cell in its middle."""
    occupied = np.zeros((41, 41), bool)
    occupied[20, 20] = True
    return OccupancyGrid(occupied, resolution_m, np.zeros(2))


def test_a_wall_fills_the_cells_it_reaches_into_and_no_more() -> None:
    grid = OccupancyGrid.of_walls(WALL, resolution_m=0.05, padding_m=0.5)
    assert grid.occupied.sum() == 2 * 20
    assert grid.occupied.shape == (40, 22)
    assert grid.origin_world == pytest.approx([-0.5, -0.5])
    shifted = shapely.affinity.translate(WALL, 0.01, 0.0)
    assert OccupancyGrid.of_walls(shifted, resolution_m=0.05, padding_m=0.5).occupied.sum() == 3 * 20


def test_the_grid_holds_the_points_it_must() -> None:
    grid = OccupancyGrid.of_walls(WALL, padding_m=0.5, also_inside=[(4.0, -2.0)])
    assert grid.contains(grid.cells_of([(4.0, -2.0), (4.4, -2.4), (4.6, -2.0)])).tolist() == [True, True, False]


def test_cells_and_points_map_to_each_other() -> None:
    grid = OccupancyGrid(np.zeros((4, 6), bool), 0.5, np.array([-1.0, 2.0]))
    assert grid.cells_of((-0.9, 2.6)).tolist() == [1, 0]
    assert grid.cells_of([(-1.01, 2.0), (1.99, 3.99)]).tolist() == [[0, -1], [3, 5]]
    assert grid.centres_of([(1, 0), (3, 5)]).tolist() == [[-0.75, 2.75], [1.75, 3.75]]


def test_distance_runs_from_centre_to_centre() -> None:
    distance = post().distance_m
    assert distance[20, 20] == 0.0
    assert distance[20, 24] == pytest.approx(0.20)
    assert distance[23, 24] == pytest.approx(0.25)
    assert np.isinf(OccupancyGrid(np.zeros((3, 3), bool), 0.05, np.zeros(2)).distance_m).all()


@pytest.mark.parametrize(
    ("cells_away", "inflation_radius_m", "cost"),
    [
        (0, 0.5, 254),
        (6, 0.5, 253),  # 0.3 m: within the inscribed radius
        (7, 0.5, 152),  # 252 exp(-10 * 0.05) = 152.8, cut off as ROS does
        (10, 0.5, 34),  # 252 exp(-10 * 0.2) = 34.1
        (11, 0.5, 0),
        (6, 0.3, 253),
        (7, 0.3, 0),
    ],
)
def test_inflation_costs_are_those_of_ros(cells_away: int, inflation_radius_m: float, cost: int) -> None:
    costs = inflate(post(), inflation_radius_m, inscribed_radius_m=0.3)
    assert costs[20, 20 + cells_away] == cost


def test_the_inscribed_radius_of_zebrat_is_half_its_width(robot: RobotModel) -> None:
    assert inscribed_radius_m(robot.footprint_base) == pytest.approx(0.3)


@pytest.mark.parametrize("name", ["track_2", "track_8"])
def test_a_world_comes_back_from_its_map(name: str, tmp_path: Path) -> None:
    world = load_world(name)
    grid = OccupancyGrid.of_walls(world.walls)
    again = load_world(write_ros_map(grid, tmp_path / "maps" / "my.map"), start=world.start.pose)
    # Walls grow by less than a cell on each side, so never by more than their outline times a cell.
    assert shapely.covers(again.walls.buffer(1e-3), world.walls)
    assert again.walls.area - world.walls.area < world.walls.length * grid.resolution_m
    assert np.array_equal(OccupancyGrid.of_walls(again.walls).occupied, grid.occupied)


def test_the_command_line_writes_a_map_that_loads(tmp_path: Path) -> None:
    zebrat = Path(sys.executable).parent / "zebrat"
    done = subprocess.run(
        [zebrat, "worlds", "track_2", "--map", tmp_path, "--json"], capture_output=True, text=True, check=True
    )
    assert "track_2" in json.loads(done.stdout)
    world = load_world("track_2")
    mapped = load_world(tmp_path / "track_2.yaml", start=world.start.pose)
    assert mapped.walls.bounds == pytest.approx(world.walls.bounds, abs=0.05)
