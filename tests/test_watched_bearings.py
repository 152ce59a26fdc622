"""A lidar confined to the bearings that the task looks at tells the task the same, to the last bit, with fewer rays."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest
from boxes import box_world, standing
from numpy.typing import NDArray

from zebrat_bullet.config import EpisodeConfig, FlattenConfig, LidarConfig, NoiseConfig, SafetyRegionConfig, TaskConfig
from zebrat_bullet.config_text import from_json
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.rollout import replay_episode, run_episode
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.lidar import Lidar
from zebrat_bullet.task.drive import Drive, DriveStep
from zebrat_bullet.types import Clearance, Command, Pose2, Reading
from zebrat_bullet.world import World, load_world

both_casters = pytest.mark.parametrize("caster", ["bullet", "embree"])
NOISY = NoiseConfig(range_sigma_m=0.02, dropout=0.1, mount_xyz_m=(0.02, 0.0, 0.0), mount_yaw_rad=0.02)


def task_of(caster: str, bearings: str, n_bearings: int = 360, kind: str = "sr", robot: str = "zebrat") -> TaskConfig:
    lidar = LidarConfig(caster=caster, bearings=bearings, n_bearings=n_bearings)
    anywhere = EpisodeConfig(start="anywhere")
    return TaskConfig(robot=robot, lidar=lidar, region=SafetyRegionConfig(kind=kind), episode=anywhere)


def bits(clearance: Clearance) -> bytes:
    assert not np.isnan(clearance.obs_m).any()
    return clearance.obs_m.tobytes() + bytes([clearance.collision])


def random_commands(seed: int) -> Iterator[Command]:
    rng = np.random.default_rng(seed)
    while True:
        yield Command(rng.uniform(-0.2, 0.6), rng.uniform(-0.6, 0.6))


def driven(task: TaskConfig, worlds: list[World], n_steps: int) -> Iterator[Reading | DriveStep]:
    """Yield the readings and steps of a random drive from places anywhere in the worlds, ten steps in each at most."""
    drive, rng, commands, next_world = (
        Drive(task, worlds[0]),
        np.random.default_rng(1),
        random_commands(2),
        cycle(worlds),
    )
    step = None
    for k in range(n_steps):
        if k % 10 == 0 or (step is not None and step.outcome is not None):
            yield drive.reset(rng, next(next_world))
        step = drive.step(next(commands))
        yield step
    drive.close()


def assert_same(one: Reading | DriveStep, other: Reading | DriveStep) -> None:
    if isinstance(one, DriveStep) and isinstance(other, DriveStep):
        assert (one.reward, one.terms, one.outcome) == (other.reward, other.terms, other.outcome)
        one, other = one.reading, other.reading
    assert isinstance(one, Reading) and isinstance(other, Reading)
    assert bits(one.clearance) == bits(other.clearance)


@both_casters
@pytest.mark.parametrize(
    ("robot", "kind", "n_bearings"),
    [
        ("zebrat", "sr", 360),
        ("zebrat", "firect", 360),
        ("zebrat", "fifr", 360),
        ("zebrat", "sr", 361),
        ("hexagon", "sr", 360),
        ("hexagon", "firect", 128),
        ("long", "sr", 720),
        ("long", "fifr", 90),
    ],
)
@pytest.mark.parametrize("noise", [NoiseConfig(), NOISY], ids=["exact", "noisy"])
def test_a_drive_sees_and_earns_the_same(
    caster: str, robot: str, kind: str, n_bearings: int, noise: NoiseConfig
) -> None:
    worlds = [load_world(name) for name in ("big_track", "track_4", "track_7", "real_1")]
    every, region = (
        list(driven(replace(task_of(caster, bearings, n_bearings, kind, robot), noise=noise), worlds, 40))
        for bearings in ("all", "region")
    )
    assert len(every) == len(region) >= 44
    for one, other in zip(every, region, strict=True):
        assert_same(one, other)


def aimed_rays(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that grows by the number of rays at each cast of a drive's lidar."""
    numbers: list[int] = []
    cast = drive.lidar.caster.cast

    def counted(*arguments: NDArray) -> NDArray[np.float32]:
        ranges = cast(*arguments)
        numbers.append(len(ranges))
        return ranges

    monkeypatch.setattr(drive.lidar.caster, "cast", counted)
    return numbers


@both_casters
def test_a_step_casts_once_and_only_what_region_and_rule_look_at(caster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = Drive(task_of(caster, "region"), load_world("track_2"))
    numbers = aimed_rays(drive, monkeypatch)
    scan = drive.reset(np.random.default_rng(0)).scan
    for _ in range(3):
        scan = drive.step(Command(0.3, 0.1)).reading.scan
    watched = sorted({*drive.region.indices.tolist(), 90, 270})
    assert len(watched) == 32  # the region holds both sides already
    assert numbers == [16 * 32] * 4
    assert np.flatnonzero(~np.isnan(scan.ranges_m)).tolist() == watched
    trace = drive.lidar.caster.trace()
    assert (trace["t_hit"].shape[0] if caster == "embree" else sum(map(len, trace))) == 16 * 32
    drive.close()


@both_casters
def test_open_space_is_seen_also_where_the_region_does_not_watch_the_sides(caster: str) -> None:
    drive = Drive(task_of(caster, "region", 361, "firect", "hexagon"), box_world())
    assert not {361 // 4, 3 * 361 // 4} <= set(drive.region.indices)
    drive.reset(np.random.default_rng(0), pose=Pose2(0.0, 0.0, 0.0))
    assert drive.step(Command(0.0, 0.0)).outcome == "false_exit"  # nothing within reach on either side, and no exit
    drive.close()


class RandomDriver:
    name = "random driver"
    privileged: frozenset[str] = frozenset()

    def reset(self, seed: int) -> None:
        self._commands = random_commands(seed)

    def act(self, reading: Reading) -> Command:
        assert not np.isnan(reading.scan.ranges_m).any()
        return next(self._commands)


@both_casters
def test_an_agent_and_its_record_have_whole_scans_cast_once(caster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    world = load_world("track_2")
    every, region = (Drive(task_of(caster, bearings), world) for bearings in ("all", "region"))
    numbers = aimed_rays(region, monkeypatch)
    records = [run_episode(drive, RandomDriver(), 0, 3) for drive in (every, region)]
    assert numbers == [16 * 360] * len(records[1].scan_m)
    assert len(records[0].scan_m) > 3 and np.array_equal(records[0].scan_m, records[1].scan_m)
    again = replay_episode(Drive(from_json(TaskConfig, records[1].task), world), records[1], world)
    assert np.array_equal(again.scan_m, records[1].scan_m)
    every.close()
    region.close()


def test_only_an_environment_that_draws_casts_whole_scans() -> None:
    for render_mode, whole in ((None, False), ("rgb_array", True)):
        env = ZebratEnv("track_2", task=task_of("embree", "region"), render_mode=render_mode)
        env.reset(seed=0)
        env.step(np.array([0.5, 0.0], np.float32))
        assert (not np.isnan(env._reading.scan.ranges_m).any()) == whole
        env.close()


@pytest.mark.parametrize("noise", [NoiseConfig(), NOISY], ids=["exact", "noisy"])
def test_a_tilted_lidar_casts_the_whole_sweep(noise: NoiseConfig) -> None:
    robot, world, rng = load_robot("zebrat"), load_world("track_4"), np.random.default_rng(0)
    watched = np.arange(5, 360, 12)
    lidar = Lidar(robot, LidarConfig(caster="embree"), noise, FlattenConfig(), watched=watched)
    lidar.set_world(world)
    n_told_by_neighbours = 0
    for k, (roll, pitch) in enumerate(rng.uniform(-0.06, 0.06, (30, 2))):
        x, y = world.centre_line[rng.integers(len(world.centre_line))]
        state = standing(float(x), float(y), float(rng.uniform(-3, 3)), roll=float(roll), pitch=float(pitch))
        whole = lidar.scan(state, np.random.default_rng(k)).ranges_m
        sweep = lidar.sweep(state, np.random.default_rng(k), watched_only=True)
        assert lidar.flat(sweep).ranges_m.tobytes() == whole.tobytes()
        own_beams = np.full((16, 360), 6.0, np.float32)
        own_beams[:, watched] = sweep.ranges_m.reshape(16, 360)[:, watched]
        alone = lidar.flat(replace(sweep, ranges_m=own_beams.ravel())).ranges_m
        n_told_by_neighbours += int((alone[watched] != whole[watched]).sum())
    assert n_told_by_neighbours > 30  # so the watched beams alone would not have done


@both_casters
def test_a_lidar_that_is_all_but_level_keeps_to_its_bearings(caster: str) -> None:
    drive = Drive(task_of(caster, "region"), load_world("track_4"))
    drive.reset(np.random.default_rng(0))
    for tilt, whole in ((0.0009, False), (0.0011, True)):
        state = replace(drive.state, roll=tilt, pitch=-tilt)
        part = drive.lidar.scan(state, np.random.default_rng(0), watched_only=True).ranges_m
        every = drive.lidar.scan(state, np.random.default_rng(0)).ranges_m
        assert (not np.isnan(part).any()) == whole and not np.isnan(every).any()
        assert part[drive.region.indices].tobytes() == every[drive.region.indices].tobytes()
    drive.close()


def test_the_cloud_of_a_confined_sweep_is_that_part_of_the_whole() -> None:
    watched = np.array([10, 200, 355])
    lidar = Lidar(load_robot("zebrat"), LidarConfig(caster="embree"), NoiseConfig(), FlattenConfig(), watched=watched)
    lidar.set_world(load_world("track_1"))
    rng = np.random.default_rng(0)
    part, whole = (lidar.cloud(lidar.sweep(standing(), rng, watched_only=only)) for only in (True, False))
    assert np.array_equal(part.points_lidar, whole.points_lidar.reshape(16, 360, 3)[:, watched].reshape(-1, 3))
    assert np.array_equal(part.valid, whole.valid.reshape(16, 360)[:, watched].ravel())


def test_bearings_are_all_or_region() -> None:
    assert LidarConfig().bearings == "all"
    with pytest.raises(ConfigError, match="bearings must be 'all' or 'region', got 'some'"):
        LidarConfig(bearings="some")
