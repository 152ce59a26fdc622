"""Simulations are independent, repeat themselves bit for bit, and leak nothing."""

import hashlib
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import psutil
import pybullet
import pytest
from boxes import box_world

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.errors import WorldError
from zebrat_bullet.robot import RobotModel, load_robot
from zebrat_bullet.sim.simulation import Simulation
from zebrat_bullet.types import Command, Pose2
from zebrat_bullet.world.world import Mesh, World

Simulate = Callable[..., Simulation]
START = Pose2(0.3, -0.1, 0.2)


def walled() -> World:
    return box_world(((1.0, 1.1), (-2.0, 2.0), (0.0, 1.0)), ((-1.1, -1.0), (-2.0, 2.0), (0.0, 1.0)))


def trajectory(simulation: Simulation, seed: int = 3, n_steps: int = 60) -> bytes:
    """Return the bytes of every number of a random drive, wall contacts included."""
    rng = np.random.default_rng(seed)
    states = [simulation.reset(START)]
    states += [simulation.step(Command(*rng.choice([-0.6, 0.3, 0.6], 2).tolist())) for _ in range(n_steps)]
    rows = [
        (s.pose.x, s.pose.y, s.pose.yaw, s.height_m, s.roll, s.pitch, s.speed_mps, *s.knuckle_rad, *s.wheel_rad)
        for s in states
    ]
    assert any(s.contact for s in states)
    return np.array(rows, dtype=np.float64).tobytes()


def fingerprint() -> str:
    """Return the hash of a drive in a fresh simulation."""
    simulation = Simulation(load_robot("zebrat"), PhysicsConfig())
    simulation.set_world(walled())
    digest = hashlib.sha256(trajectory(simulation)).hexdigest()
    simulation.close()
    return digest


def resident_mb() -> float:
    return psutil.Process().memory_info().rss / 1e6


def n_bodies(simulation: Simulation) -> int:
    return pybullet.getNumBodies(physicsClientId=simulation.client_id)


def test_what_happened_before_leaves_no_trace(simulate: Simulate) -> None:
    world = walled()
    fresh = simulate()
    fresh.set_world(world)
    expected = trajectory(fresh)
    assert trajectory(fresh) == expected
    used = simulate()
    used.set_world(box_world(((0.6, 0.7), (-1.0, 1.0), (0.0, 1.0))))
    used.reset(Pose2(0.0, 0.0, 0.0))
    for _ in range(20):
        used.step(Command(0.6, 0.6))
    used.set_world(world)
    used.reset(START)
    for _ in range(10):
        used.step(Command(0.0, 0.6))
    assert trajectory(used) == expected


def test_another_process_drives_the_same_bit_for_bit() -> None:
    command = "import tests.test_sim_isolation as t; print(t.fingerprint())"
    result = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {sys.path!r}; {command}"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.strip() == fingerprint()  # and PyBullet keeps its own words out of stdout


def test_two_simulations_do_not_touch_each_other(simulate: Simulate) -> None:
    alone = simulate()
    alone.set_world(walled())
    expected = trajectory(alone)
    one, other = simulate(), simulate()
    one.set_world(walled())
    rng = np.random.default_rng(3)
    one.reset(START)
    other.reset(Pose2(0.0, 0.0, 0.0))
    for _ in range(60):
        command = Command(*rng.choice([-0.6, 0.3, 0.6], 2).tolist())
        state = one.step(command)
        far = other.step(Command(0.6, 0.0))
    assert far.pose.x > 7.0
    ending = np.frombuffer(expected)[-13:]
    assert [state.pose.x, state.pose.y, state.pose.yaw] == ending[:3].tolist()


def test_a_thousand_resets_leak_nothing(simulate: Simulate) -> None:
    simulation = simulate()
    simulation.set_world(walled())
    simulation.reset(START)
    bodies, before = n_bodies(simulation), resident_mb()
    for k in range(1000):
        simulation.reset(Pose2(0.0, 0.0, 0.01 * k))
        simulation.step(Command(0.6, 0.6))
    assert n_bodies(simulation) == bodies == 3
    assert resident_mb() - before < 20.0


def test_two_hundred_worlds_leak_nothing(simulate: Simulate) -> None:
    simulation = simulate()
    x, y = np.meshgrid(np.arange(40.0), np.arange(40.0))
    big = Mesh(np.column_stack([x.ravel(), y.ravel(), np.ones(1600)]), _grid_faces(40))
    worlds = [box_world(), walled(), World(**{**vars(box_world()), "mesh": big})]
    for world in worlds:
        simulation.set_world(world)
    before = resident_mb()
    for k in range(200):
        simulation.set_world(worlds[k % 3])
        simulation.reset(START)
        assert n_bodies(simulation) == (2 if k % 3 == 0 else 3)
    assert resident_mb() - before < 20.0


def _grid_faces(n: int) -> np.ndarray:
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return np.column_stack([corner, corner + 1, corner + n]).astype(np.int32)


def test_the_same_world_again_is_not_rebuilt(simulate: Simulate) -> None:
    simulation, world = simulate(), walled()
    simulation.set_world(world)
    before = simulation.reset(START).pose
    simulation.set_world(world)
    assert simulation.step(Command(0.0, 0.0)).pose.x == pytest.approx(before.x, abs=1e-3)


def test_closed_simulations_give_their_client_back(robot: RobotModel) -> None:
    ids = set()
    for _ in range(5):
        simulation = Simulation(robot, PhysicsConfig())
        ids.add(simulation.client_id)
        simulation.close()
        simulation.close()
    assert len(ids) == 1


def test_a_mesh_too_big_for_pybullet_is_refused_with_its_size(simulate: Simulate) -> None:
    vertices = np.random.default_rng(0).uniform(0.0, 1.0, (140_000, 3))
    faces = np.arange(139_998, dtype=np.int32).reshape(-1, 3)
    world = World(**{**vars(box_world()), "mesh": Mesh(vertices, faces)})
    with pytest.raises(WorldError, match="140000 vertices"):
        simulate().set_world(world)
