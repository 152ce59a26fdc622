"""The body stops at walls, the wheels do not know them, and lidar rays do not know the car."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pybullet
import pytest
import shapely
from boxes import box_world
from numpy.typing import NDArray

from zebrat_bullet.geometry import to_world
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import Command, Pose2
from zebrat_bullet.world.solid import extrude, join
from zebrat_bullet.world.world import World

Simulate = Callable[..., Simulation]
AHEAD = Command(0.6, 0.0)
FRONT_WALL = ((1.0, 1.1), (-2.0, 2.0), (0.0, 1.0))


def corridor_world() -> World:
    """An L-shaped corridor 1.2 and 1.4 m wide with a buttress and a slanted pillar, walls 0.1 m thick."""
    inside = shapely.union_all([shapely.box(-1.0, -0.6, 4.0, 0.6), shapely.box(2.6, -0.6, 4.0, 4.0)])
    ring = inside.buffer(0.1, join_style="mitre").difference(inside)
    pillar = shapely.Point(1.3, 0.6).buffer(0.12, quad_segs=1)
    walls = [ring, shapely.box(2.6, 2.2, 2.8, 2.4), pillar]
    mesh = join([extrude(wall, 0.0, 1.0) for wall in walls])
    return replace(box_world(), mesh=mesh, walls=shapely.MultiPolygon([shapely.union_all(walls)]))


def penetration_depth_m(outline_world: NDArray[np.float64], walls: shapely.MultiPolygon) -> float:
    """Return how deep a car's corner stands in a wall, or a wall's corner in the car; 0 where neither does."""
    outline = shapely.Polygon(outline_world)
    corners = shapely.points(outline_world)
    wall_corners = shapely.points(shapely.get_coordinates(walls))
    in_wall = shapely.distance(corners[shapely.within(corners, walls)], walls.boundary)
    in_car = shapely.distance(wall_corners[shapely.within(wall_corners, outline)], outline.exterior)
    return max(in_wall.max(initial=0.0), in_car.max(initial=0.0))


def test_penetration_depth_is_measured_as_a_depth() -> None:
    walls = box_world(FRONT_WALL).walls
    square = np.array([[0.0, -0.5], [1.02, -0.5], [1.02, 0.5], [0.0, 0.5]])
    assert penetration_depth_m(square, walls) == pytest.approx(0.02)
    assert penetration_depth_m(square - (0.03, 0.0), walls) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("rate_hz", "n_steps"), [(120.0, 10_000), (80.0, 2_000)])
def test_the_body_never_passes_into_a_wall(simulate: Simulate, robot: RobotModel, rate_hz: float, n_steps: int) -> None:
    simulation, world, rng = simulate(rate_hz=rate_hz), corridor_world(), np.random.default_rng(7)
    simulation.set_world(world)
    command, hold, n_contacts, deepest = Command(0.0, 0.0), 0, 0, 0.0
    for k in range(n_steps):
        if k % 50 == 0:
            simulation.reset(Pose2(rng.uniform(0.0, 0.5), rng.uniform(-0.1, 0.1), rng.uniform(-0.2, 0.2)))
        if hold == 0:  # half the commands are at their limits, and all push on for a while against what they hit
            hold = int(rng.integers(1, 15))
            speed, steering = np.clip(rng.uniform(-1.2, 1.2, 2), -0.6, 0.6)
            command = Command(float(speed), float(steering))
        hold -= 1
        state = simulation.step(command)
        n_contacts += state.contact
        deepest = max(deepest, penetration_depth_m(to_world(robot.footprint_base, state.pose), world.walls))
        assert deepest < 0.01, f"step {k}: {state}"
    assert n_contacts > n_steps / 10


def test_a_wall_stops_the_car_and_contact_says_so(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.set_world(box_world(FRONT_WALL))
    simulation.reset(Pose2(0.0, 0.0, 0.0))
    free = [simulation.step(AHEAD) for _ in range(3)]
    assert free[-1].pose.x < 0.45 and not any(state.contact for state in free)  # its front is 0.5 m ahead
    pushed = [simulation.step(AHEAD) for _ in range(10)]
    assert pushed[-1].contact and not pushed[-1].unseen_contact
    assert pushed[-1].pose.x == pytest.approx(0.5, abs=0.01)
    assert pushed[-1].speed_mps == pytest.approx(0.0, abs=0.03)
    freed = [simulation.step(Command(-0.6, 0.0)) for _ in range(3)]
    assert not freed[-1].contact


def test_a_graze_within_a_control_step_is_not_missed(simulate: Simulate) -> None:
    simulation = simulate(control_step_s=2.0)
    # A turn from standstill swings the outer rear corner out by 0.229^2 / (2 * 0.819) = 3 cm, and in again.
    simulation.set_world(box_world(((-5.0, 5.0), (-0.42, -0.32), (0.0, 1.0))))
    simulation.reset(Pose2(0.0, 0.0, 0.0))
    assert simulation.step(Command(0.6, 0.6)).contact
    assert not simulation.step(Command(0.6, 0.6)).contact


def test_the_floor_is_no_wall(simulate: Simulate) -> None:
    simulation = simulate()
    for world in (None, box_world(FRONT_WALL), box_world()):
        if world is not None:
            simulation.set_world(world)
        simulation.reset(Pose2(-1.0, 0.0, 0.0))
        assert not simulation.step(AHEAD).contact and simulation.touches() == []
    on_the_floor = pybullet.getContactPoints(simulation.car_id, physicsClientId=simulation.client_id)
    assert len(on_the_floor) >= 4  # there are contacts, of the wheels


def test_reset_forgets_a_contact(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.set_world(box_world(FRONT_WALL))
    simulation.reset(Pose2(0.45, 0.0, 0.0))
    assert simulation.step(AHEAD).contact
    assert not simulation.reset(Pose2(0.0, 0.0, 0.0)).contact
    assert not simulation.step(AHEAD).contact


def test_contact_with_a_low_obstacle_is_unseen(simulate: Simulate) -> None:
    kerb = ((1.0, 1.2), (-0.5, 0.5), (0.0, 0.2))
    wall = ((-1.1, -1.0), (-2.0, 2.0), (0.0, 1.0))
    world = box_world(kerb, wall)
    simulation = simulate()
    simulation.set_world(replace(world, low_obstacles=shapely.MultiPolygon([shapely.box(1.0, -0.5, 1.2, 0.5)])))
    simulation.reset(Pose2(0.3, 0.0, 0.0))
    ahead = [simulation.step(AHEAD) for _ in range(3)][-1]
    assert ahead.contact and ahead.unseen_contact
    simulation.reset(Pose2(-0.3, 0.0, 0.0))
    behind = [simulation.step(Command(-0.6, 0.0)) for _ in range(3)][-1]
    assert behind.contact and not behind.unseen_contact


def test_steered_wheels_pass_a_wall_that_the_body_clears(simulate: Simulate) -> None:
    simulation = simulate()
    # At full lock the inner wheel reaches out to 0.245 + 0.15 sin 0.773 = 0.35; the wall is 2 cm beside the body.
    simulation.set_world(box_world(((-5.0, 5.0), (0.32, 0.42), (0.0, 1.0))))
    simulation.reset(Pose2(0.0, 0.0, 0.0))
    states = [simulation.step(Command(0.0, 0.6)) for _ in range(5)]
    assert states[-1].knuckle_rad == pytest.approx([0.773, 0.485], abs=0.01)
    assert not any(state.contact for state in states)


def test_rays_pass_through_the_car_and_meet_floor_and_walls(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.set_world(box_world(FRONT_WALL))
    simulation.reset(Pose2(0.0, 0.0, 0.0))
    simulation.step(Command(0.0, 0.3))
    starts = [(0.4, 0.0, 0.75), (0.0, 0.0, 0.3), (-2.0, 0.0, 0.3), (0.289, 0.245, 0.75), (0.0, 0.0, 0.3)]
    ends = [(3.0, 0.0, 0.75), (3.0, 0.0, 0.3), (3.0, 0.0, 0.3), (0.289, 0.245, -1.0), (-5.0, 0.0, 0.3)]
    hits = pybullet.rayTestBatch(starts, ends, physicsClientId=simulation.client_id)
    walls, floor = simulation.walls_id, simulation.floor_id
    assert [hit[0] for hit in hits] == [walls, walls, walls, floor, -1]
    np.testing.assert_allclose([hit[3][0] for hit in hits[:3]], 1.0, atol=1e-6)
    assert math.isclose(hits[3][3][2], 0.0, abs_tol=1e-6)
