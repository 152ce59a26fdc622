"""The oracle drives what can be driven, with real physics: forward, backward, from anywhere, and when pushed aside."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from zebrat_bullet.agents import load_agent
from zebrat_bullet.config import EpisodeConfig, LidarConfig, PhysicsConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import EpisodeRecord
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.planning.arc_path import ArcPath, axle_pose, clearances
from zebrat_bullet.planning.certificate import load_certificate
from zebrat_bullet.planning.tracking import PathTracker
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.task.drive import Drive, DriveStep
from zebrat_bullet.types import Pose2, Reading
from zebrat_bullet.world import World, load_world
from zebrat_bullet.world.build import build_world
from zebrat_bullet.world.elements import Straight, Turn
from zebrat_bullet.world.schema import StartSpec, WorldSpec

TASK = TaskConfig(lidar=LidarConfig(caster="embree"))


@pytest.fixture(scope="module")
def drive() -> Iterator[Drive]:
    made = Drive(TASK, load_world("track_4"))
    yield made
    made.close()


def axle_poses(record: EpisodeRecord, robot: RobotModel) -> np.ndarray:
    return np.array([axle_pose(Pose2(*pose), robot) for pose in record.pose.tolist()])


def hairpin(width: float) -> World:
    """Return a U-turn of sharp corners round a wall 0.3 m thick, tighter than the rules for shipped worlds allow."""
    legs = [Straight(straight=4.0, width=width), Turn(turn=90), Straight(straight=width + 0.3, width=width)]
    spec = WorldSpec(
        name="hairpin",
        description="made by a test",
        start=StartSpec(at_m=1.5, range_x_m=0.0, range_y_m=0.0, range_yaw_rad=0.05),
        segments=[*legs, Turn(turn=90), Straight(straight=3.0, width=width)],
    )
    return build_world(spec, Path("hairpin"))


@pytest.mark.parametrize("name", ["track_3", "track_4", "real_2"])
def test_the_oracle_drives_out_at_full_speed_and_keeps_off_the_walls(name, drive, robot) -> None:
    world = load_world(name)
    record = run_episode(drive, load_agent("oracle", TASK), seed=0, episode=1, world=world)
    assert record.outcome == "success"
    assert clearances(axle_poses(record, robot), robot, world.walls).min() > 0.05
    # Of a start up to 0.1 m ahead of the one that the bound is for.
    assert record.duration_s > load_certificate(name).least_time_s - 0.1 / 0.6
    assert (record.command[2:, 0] == 0.6).all()


def test_the_oracle_reverses_where_it_must(drive, robot) -> None:
    world = hairpin(1.0)
    record = run_episode(drive, load_agent("oracle", TASK), seed=0, episode=0, world=world)
    assert record.outcome == "success"
    assert record.speed_mps.min() < -0.3
    assert clearances(axle_poses(record, robot), robot, world.walls).min() > 0.0


def test_the_oracle_starts_anywhere() -> None:
    task = replace(TASK, episode=EpisodeConfig(start="anywhere"))
    drive = Drive(task, load_world("track_7"))
    agent = load_agent("oracle", task)
    outcomes = [run_episode(drive, agent, seed=3, episode=episode).outcome for episode in range(4)]
    drive.close()
    assert outcomes == ["success"] * 4


def test_noise_on_its_commands_does_not_throw_it_off(drive) -> None:
    agent = load_agent("oracle", TASK, noise_sigma=0.1)
    assert run_episode(drive, agent, seed=0, episode=0, world=load_world("track_3")).outcome == "success"


def test_turned_aside_the_oracle_plans_again(drive) -> None:
    world, agent = load_world("track_6"), load_agent("oracle", TASK)
    agent.reset(0)
    clock = count()

    def act(reading: Reading) -> DriveStep:
        given = replace(reading, state=drive.state, walls=world.walls, goal_world=world.waypoints[-1])
        return drive.step(agent.act(replace(given, time_s=0.2 * next(clock))))

    reading = drive.reset(np.random.default_rng(0), world, pose=Pose2(1.5, 0.0, 0.0))
    for _ in range(5):
        reading = act(reading).reading
    step = act(drive.reset(np.random.default_rng(0), world, pose=Pose2(1.4, 0.0, 2.6)))
    while step.outcome is None:
        step = act(step.reading)
    assert step.outcome == "success"


def test_where_there_is_no_way_the_oracle_stands_still(drive) -> None:
    record = run_episode(drive, load_agent("oracle", TASK), seed=0, episode=0, world=hairpin(0.8))
    assert record.outcome == "stall"
    assert (record.command == 0.0).all()


def test_the_same_seed_gives_the_same_drive(drive) -> None:
    first, second = (run_episode(drive, load_agent("oracle", TASK), 5, 2, load_world("real_1")) for _ in range(2))
    assert np.array_equal(first.pose, second.pose)


def test_the_oracle_declares_all_that_it_is_given_and_takes_settings() -> None:
    assert load_agent("oracle", TASK).privileged == {"pose", "map", "goal"}
    assert load_agent("oracle:n_steering=5,arc_m=0.25", TASK).name == "oracle:n_steering=5,arc_m=0.25"
    with pytest.raises(ConfigError, match="n_steering"):
        load_agent("oracle:speed=1", TASK)


def test_a_tracker_follows_past_a_cusp_and_stops_at_the_end_within_centimetres(simulate, robot) -> None:
    # Forward through a quarter circle of 1 m to the left, then back through one with the wheels to the right.
    path = ArcPath(np.array([(0.0, 0.0, 0.0), (1.0, 1.0, np.pi / 2), (2.0, 0.0, np.pi)]), np.array([1, -1]))
    assert path.curvatures == pytest.approx([1.0, -1.0])
    sim, tracker = simulate(), PathTracker(path, robot, PhysicsConfig())
    state, errors, axle = sim.reset(Pose2(-robot.rear_axle_x_m, 0.0, 0.0)), [], []
    for _ in range(40):
        state = sim.step(tracker.act(state))
        errors.append(abs(tracker.lateral_error_m))
        axle.append(axle_pose(state.pose, robot))
    assert max(errors) < 0.03
    assert 0.97 < max(pose[1] for pose in axle) < 1.04
    assert axle[-1][:2] == pytest.approx((2.0, 0.0), abs=0.04)
    assert abs(state.speed_mps) < 0.01
