"""Episodes of planar cars: same seed, same numbers; nothing leaks from one car, world or drive to another."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from boxes import box_world
from planar_cars import FIELD

from zebrat_bullet.config import DynamicsConfig, EpisodeConfig, NoiseConfig, ObservationConfig, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planar.drive import N_STARTS, PlanarDrive, PlanarStep
from zebrat_bullet.task.episode import Outcome
from zebrat_bullet.types import Commands, Pose2
from zebrat_bullet.world import World, load_world

TASK = TaskConfig(
    noise=NoiseConfig(range_sigma_m=0.01, dropout=0.1),
    dynamics=DynamicsConfig(speed=(0.8, 1.0), delay_s=(0.0, 0.2), steering_offset_rad=(-0.05, 0.05)),
    observation=ObservationConfig(log_gaps=True, trail_steps=(1, 5, 12)),
    episode=EpisodeConfig(max_steps=25),
)
N = 60


@pytest.fixture(scope="module")
def worlds() -> list[World]:
    return [load_world(name) for name in ("track_1", "track_2", "track_7")]


def actions(seed: int, n_steps: int, n: int = N) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (n_steps, n, 2)).astype(np.float32)


def numbers(step: PlanarStep) -> list[np.ndarray]:
    arrays = [step.observation, step.reward, step.outcome, step.ended, step.last_observation, step.world, step.start]
    return [*arrays, *step.terms.values()]


def same(ours: list[PlanarStep], theirs: list[PlanarStep]) -> bool:
    pairs = zip(ours, theirs, strict=True)
    return all(np.array_equal(a, b) for one, two in pairs for a, b in zip(numbers(one), numbers(two), strict=True))


def test_the_same_seed_gives_the_same_numbers_bit_for_bit(worlds: list[World]) -> None:
    one, two, three = (PlanarDrive(TASK, worlds, N, seed=seed) for seed in (4, 4, 5))
    steps = [[drive.step(action) for action in actions(0, 40)] for drive in (one, two, three)]
    assert same(steps[0], steps[1]) and not same(steps[0], steps[2])
    assert sum(len(step.ended) for step in steps[0]) > N  # with many episodes in between
    again = one.reset(4)
    assert np.array_equal(again, PlanarDrive(TASK, worlds, N, seed=4).reset(4))
    assert np.array_equal(one.step(actions(1, 1)[0]).observation, two_step(worlds))


def two_step(worlds: list[World]) -> np.ndarray:
    fresh = PlanarDrive(TASK, worlds, N, seed=9)
    fresh.reset(4)
    return fresh.step(actions(1, 1)[0]).observation


def test_a_loaded_state_goes_on_bit_for_bit_also_elsewhere_and_from_a_file(worlds: list[World]) -> None:
    drive = PlanarDrive(TASK, worlds, N, seed=1)
    for action in actions(0, 17):
        seen = drive.step(action).observation
    kept = pickle.dumps(drive.state())
    on = [drive.step(action) for action in actions(2, 30)]
    elsewhere = PlanarDrive(TASK, worlds, N, seed=77)
    for here in (drive, elsewhere):
        assert np.array_equal(here.load(*pickle.loads(kept)), seen)
        assert same([here.step(action) for action in actions(2, 30)], on)


def test_a_state_carries_the_chances_of_the_worlds_and_is_refused_where_worlds_or_task_are_others(
    worlds: list[World],
) -> None:
    drive = PlanarDrive(TASK, worlds[:2], N, seed=1)
    drive.weights = [1.0, 3.0]
    drive.add_worlds(worlds[2:])
    plain, arrays = drive.state()
    plain = json.loads(json.dumps(plain))
    on = [drive.step(action) for action in actions(2, 30)]
    same_worlds = PlanarDrive(replace(TASK, lidar=replace(TASK.lidar, caster="embree")), worlds, N)
    same_worlds.load(plain, arrays)
    assert np.array_equal(same_worlds.weights, drive.weights)
    assert same([same_worlds.step(action) for action in actions(2, 30)], on)
    slower = PlanarDrive(replace(TASK, episode=EpisodeConfig(max_steps=26)), worlds, N)
    with pytest.raises(ConfigError, match="of another task; load it into cars of the task"):
        slower.load(plain, arrays)
    fewer = PlanarDrive(TASK, worlds[:2], N)
    with pytest.raises(ConfigError, match="among 3 worlds, here are 2; call add_worlds first"):
        fewer.load(plain, arrays)
    with pytest.raises(ConfigError, match="among other worlds; give the cars those, in the same order"):
        PlanarDrive(TASK, worlds[::-1], N).load(plain, arrays)
    older = {name: plain[name] for name in ("n_steps", "rng")}  # as earlier versions have it
    same_worlds.load(older, arrays)
    assert same_worlds.weights is None


def test_cars_tell_their_poses_in_the_frames_of_their_worlds(worlds: list[World]) -> None:
    drive = PlanarDrive(TASK, worlds, 3)
    there = np.array([tuple(world.start.pose) for world in worlds])
    drive.begin_at(np.arange(3), there)
    poses = drive.poses()
    assert poses.dtype == np.float64 and poses == pytest.approx(there, abs=1e-6)
    drive.step(np.ones((3, 2), np.float32))
    assert (np.linalg.norm((drive.poses() - poses)[:, :2], axis=1) > 0.005).all()
    assert np.abs(drive.sim.origin).max() > 0.5  # from which the simulation measures


def test_a_state_is_a_copy(worlds: list[World]) -> None:
    drive = PlanarDrive(TASK, worlds, 3)
    state = drive.state()
    before = pickle.dumps(state)
    for action in actions(0, 5, 3):
        drive.step(action)
    assert pickle.dumps(state) == before


def test_two_drives_in_one_process_do_not_touch_each_other(worlds: list[World]) -> None:
    alone = PlanarDrive(TASK, worlds, N, seed=2)
    expected = [alone.step(action) for action in actions(0, 10)]
    one, other = PlanarDrive(TASK, worlds, N, seed=2), PlanarDrive(TASK, worlds[:1], 7, seed=3)
    steps = []
    for action, noise in zip(actions(0, 10), actions(1, 10, 7), strict=True):
        steps.append(one.step(action))
        other.step(noise)
    assert same(steps, expected)


def test_a_car_drives_the_same_whatever_others_do(worlds: list[World]) -> None:
    """Without noise, dynamics and ends, a car's numbers depend on its pose and its commands alone."""
    quiet = TaskConfig(episode=EpisodeConfig(max_steps=100))
    poses = [world.start.pose for world in worlds]
    together = PlanarDrive(quiet, worlds, 3)
    first = together.begin_at(np.arange(3), poses)
    forward = np.tile(np.float32([0.7, 0.05]), (3, 1))
    steps = [together.step(forward) for _ in range(6)]
    for i, world in enumerate(worlds):
        alone = PlanarDrive(quiet, [world], 1)
        assert np.array_equal(alone.begin_at(np.array([0]), [poses[i]])[0], first[i])
        for step in steps:
            own = alone.step(forward[:1])
            np.testing.assert_allclose(own.observation[0], step.observation[i], atol=1e-6)
            assert own.reward[0] == pytest.approx(step.reward[i], abs=1e-5)


def test_starts_are_the_worlds_own_whatever_stands_beside_it_and_when_it_came(worlds: list[World]) -> None:
    first = PlanarDrive(TASK, worlds, 2, seed=1)
    second = PlanarDrive(TASK, worlds[2:], 2, seed=8)
    second.add_worlds(worlds[:2])
    assert first.starts.shape == second.starts.shape == (3, N_STARTS, 3)
    assert np.array_equal(first.starts[2], second.starts[0]) and np.array_equal(first.starts[:2], second.starts[1:])
    start = worlds[0].start
    away = first.starts[0] - (start.pose.x, start.pose.y, start.pose.yaw)
    assert np.abs(away[:, 2]).max() <= start.range_yaw_rad and len(np.unique(first.starts[0], axis=0)) == N_STARTS


def test_half_of_the_episodes_begin_at_the_start_where_either_is_asked_for(worlds: list[World]) -> None:
    drive = PlanarDrive(replace(TASK, episode=EpisodeConfig(start="either")), worlds, 2)
    for starts, world in zip(drive.starts, worlds, strict=True):
        off = np.abs(starts[:, :2] - (world.start.pose.x, world.start.pose.y)).max(axis=1)
        assert N_STARTS / 4 < (off < 0.15).sum() < 3 * N_STARTS / 4


def test_added_worlds_are_driven_from_then_on(worlds: list[World]) -> None:
    drive = PlanarDrive(TASK, worlds[:1], 200)
    drive.add_worlds(worlds[1:])
    drive.reset()
    assert set(drive.sim.world.tolist()) == {0, 1, 2}
    drive.weights = np.array([0.0, 0.0, 5.0])
    assert drive.weights.tolist() == [0.0, 0.0, 1.0]
    drive.reset()
    assert set(drive.sim.world.tolist()) == {2}
    drive.add_worlds(worlds[:1])
    assert drive.weights.tolist() == pytest.approx([0.0, 0.0, 0.75, 0.25])  # as often as the others' mean


def test_each_world_is_drawn_as_often_as_the_others(worlds: list[World]) -> None:
    drive = PlanarDrive(TASK, worlds, 3000)
    assert np.bincount(drive.sim.world) == pytest.approx([1000] * 3, abs=100)


def test_the_next_episode_begins_in_the_step_that_ends_one(worlds: list[World]) -> None:
    """What it observes is what a car that begins at that start observes; the last observation is the end's own."""
    task = replace(TASK, noise=NoiseConfig(), dynamics=DynamicsConfig())
    drive = PlanarDrive(task, worlds, N, seed=3)
    mirror = PlanarDrive(task, worlds, N, seed=3)
    ended = 0
    for action in actions(3, 40):
        before = drive.state()
        step = drive.step(action)
        mirror.load(*before)
        command = mirror.spec.decode_cars(action)
        mirror.sim.command[:, 0], mirror.sim.command[:, 1] = command.speed_mps, command.steering_rad
        mirror.sim.step()
        mirror._trail.follow(mirror.sim.command)
        mirror.sim.look()
        assert np.array_equal(step.last_observation, mirror._observe()[step.ended])
        assert np.array_equal(step.last_pose, mirror.poses()[step.ended])
        starts = drive.starts[drive.sim.world, drive._start]
        first = mirror.begin_at(drive.sim.world, starts)
        assert np.array_equal(step.observation[step.ended], first[step.ended])
        assert (step.observation[step.ended, -14:-12] == 0.0).all()  # no command was given yet
        # nor did it come from anywhere
        assert np.allclose(step.observation[step.ended, -12:], [0.0, 0.0, 0.0, 1.0] * 3, atol=1e-6)
        ended += len(step.ended)
    assert ended > N


def test_it_ends_and_pays_as_the_outcomes_say(worlds: list[World]) -> None:
    drive = PlanarDrive(replace(TASK, episode=EpisodeConfig(max_steps=30, stall_steps=10)), worlds, 200, seed=3)
    seen = set()
    for action in actions(5, 60, 200) * (0.3, 1.0) + (0.4, 0.0):
        step = drive.step(action.astype(np.float32))
        total = sum(step.terms.values())
        pays = {Outcome.COLLISION.code: -50.0, Outcome.SUCCESS.code: 50.0, Outcome.FALSE_EXIT.code: 50.0}
        expected = [pays.get(code, paid) for code, paid in zip(step.outcome.tolist(), total.tolist(), strict=True)]
        assert step.reward == pytest.approx(np.array(expected), rel=1e-6)
        assert np.array_equal(step.ended, np.flatnonzero(step.outcome)) and step.outcome.dtype == np.int8
        seen |= set(step.outcome.tolist())
    assert {0, Outcome.COLLISION.code, Outcome.TIMEOUT.code} <= seen


def test_driving_out_is_a_success_and_into_the_wall_a_collision() -> None:
    """A hall of 2 m between walls, open at x = 4: a lidar that crosses that line sees open space on both sides."""
    walls = box_world(((-2.0, 4.0), (1.0, 1.5), (0.0, 1.0)), ((-2.0, 4.0), (-1.5, -1.0), (0.0, 1.0)))
    hall = replace(walls, open_line=np.array([[4.0, -1.0], [4.0, 1.0]]))
    drive = PlanarDrive(TaskConfig(), [hall], 2)
    drive.begin_at(np.zeros(2, np.int32), [Pose2(2.0, 0.0, 0.0), Pose2(2.0, 0.0, 0.9)])
    found: dict[int, tuple[str, float]] = {}
    for _ in range(20):
        step = drive.follow(Commands(np.float32([0.6, 0.6]), np.float32([0.0, 0.0])))
        for car in step.ended.tolist():
            found.setdefault(car, (str(Outcome.of(int(step.outcome[car]))), float(step.reward[car])))
    assert found == {0: ("success", 50.0), 1: ("collision", -50.0)}


def test_a_car_with_room_all_around_believes_itself_outside() -> None:
    drive = PlanarDrive(TaskConfig(), [FIELD], 2)
    step = drive.step(np.zeros((2, 2), np.float32))
    assert step.outcome.tolist() == [Outcome.FALSE_EXIT.code] * 2 and step.reward.tolist() == [50.0, 50.0]
