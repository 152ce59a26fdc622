"""Global plans: the cheapest way, the same by both methods, and a clear word where there is none."""

import numpy as np
import pytest
import shapely

from zebrat_bullet.errors import ConfigError, PlanError
from zebrat_bullet.planning.global_plan import plan
from zebrat_bullet.planning.grid import OccupancyGrid
from zebrat_bullet.world import load_world


def room(*inner: shapely.Polygon) -> OccupancyGrid:
    """A room of 6 m x 4 m with inner walls."""
    shell = shapely.box(-0.1, -0.1, 6.1, 4.1).difference(shapely.box(0.0, 0.0, 6.0, 4.0))
    return OccupancyGrid.of_walls(shapely.MultiPolygon([shell, *inner]))


def length_m(path: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def test_an_empty_room_is_crossed_in_a_straight_line_of_any_heading() -> None:
    path = plan(room(), (1.0, 1.0), (5.0, 2.5), 0.5, inscribed_radius_m=0.3)
    assert path[0].tolist() == [1.0, 1.0] and path[-1].tolist() == [5.0, 2.5]
    assert length_m(path) == pytest.approx(np.hypot(4.0, 1.5), rel=0.01)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 0.05 * np.sqrt(2) + 0.05


def test_a_wall_is_rounded_a_cell_about_the_inscribed_radius_away_and_farther_where_that_costs_less() -> None:
    wall = shapely.box(2.9, 0.0, 3.1, 2.0)
    grid = room(wall)
    near = plan(grid, (1.0, 1.0), (5.0, 1.0), 0.3, inscribed_radius_m=0.3)
    far = plan(grid, (1.0, 1.0), (5.0, 1.0), 0.5, inscribed_radius_m=0.3)
    gap_near = shapely.distance(wall, shapely.LineString(near))
    gap_far = shapely.distance(wall, shapely.LineString(far))
    assert gap_near == pytest.approx(0.3, abs=0.05)
    assert 0.4 < gap_far < 0.55
    # Round the corners (2.9, 2) and (3.1, 2) on arcs of 0.3 m: a taut string is 2 sqrt(2.1^2 + 1.3^2) at the least.
    assert 2 * np.hypot(2.0, 1.3) < length_m(near) < 1.05 * 2 * np.hypot(2.1, 1.3)


@pytest.mark.parametrize("radius_m", [0.3, 0.5])
@pytest.mark.parametrize("name", ["track_2", "track_3", "track_7"])
def test_astar_finds_a_way_as_short_as_dijkstra_and_both_keep_off_the_walls(name: str, radius_m: float) -> None:
    world = load_world(name)
    start, goal = (world.start.pose.x, world.start.pose.y), world.waypoints[-1]
    grid = OccupancyGrid.of_walls(world.walls, also_inside=[start, goal])
    ways = [plan(grid, start, goal, radius_m, inscribed_radius_m=0.3, method=m) for m in ("dijkstra", "astar")]
    assert length_m(ways[0]) == pytest.approx(length_m(ways[1]), rel=0.03)
    for way in ways:
        assert shapely.distance(world.walls, shapely.LineString(way)) > 0.27


def test_the_faster_its_cost_falls_the_nearer_a_wall_is_passed() -> None:
    wall = shapely.box(2.9, 0.0, 3.1, 2.0)
    gaps = []
    for factor in (3.0, 30.0):
        path = plan(room(wall), (1.0, 1.0), (5.0, 1.0), 0.8, inscribed_radius_m=0.3, cost_scaling_factor=factor)
        gaps.append(shapely.distance(wall, shapely.LineString(path)))
    assert gaps[0] > gaps[1] + 0.1


def test_a_passage_narrower_than_the_car_is_no_way() -> None:
    grid = room(shapely.box(2.9, 0.0, 3.1, 1.8), shapely.box(2.9, 2.3, 3.1, 4.0))
    with pytest.raises(PlanError, match=r"no way from \(1\.00, 1\.00\) to \(5\.00, 1\.00\).*narrower than 0\.6 m"):
        plan(grid, (1.0, 1.0), (5.0, 1.0), 0.5, inscribed_radius_m=0.3)


def test_ends_in_a_wall_or_off_the_map_are_named() -> None:
    grid = room(shapely.box(2.0, 1.0, 4.0, 3.0))
    with pytest.raises(PlanError, match=r"the goal \(3\.00, 2\.00\) is 0\.00 m from a wall.*move it"):
        plan(grid, (1.0, 1.0), (3.0, 2.0), 0.5, inscribed_radius_m=0.3)
    with pytest.raises(PlanError, match=r"the start \(9\.00, 1\.00\) lies off the map"):
        plan(grid, (9.0, 1.0), (5.0, 1.0), 0.5, inscribed_radius_m=0.3)
    with pytest.raises(ConfigError, match="'dijkstra' or 'astar', got 'rrt'"):
        plan(grid, (1.0, 1.0), (5.0, 1.0), 0.5, inscribed_radius_m=0.3, method="rrt")


def test_a_start_a_little_too_near_to_a_wall_is_moved_off_it() -> None:
    path = plan(room(), (1.0, 0.2), (5.0, 2.0), 0.5, inscribed_radius_m=0.3)
    assert path[0].tolist() == [1.0, 0.2]
    assert path[1, 1] > 0.3


def test_a_start_at_the_goal_is_a_plan_already() -> None:
    for method in ("dijkstra", "astar"):
        path = plan(room(), (1.0, 1.0), (1.01, 1.0), 0.5, inscribed_radius_m=0.3, method=method)
        assert path.tolist() == [[1.0, 1.0], [1.01, 1.0]]
