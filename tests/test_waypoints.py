"""Waypoint guidance: which waypoint is next, what coming nearer to it pays, and who is told of it."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.policy import PolicyAgent
from zebrat_bullet.assets import list_assets
from zebrat_bullet.config import EpisodeConfig, LidarConfig, TaskConfig, with_reward
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.rollout import replay_episode, run_episode
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.task.observation import ObservationSpec
from zebrat_bullet.task.waypoints import WaypointGuide
from zebrat_bullet.types import Command, Pose2, Reading, Waypoint
from zebrat_bullet.world import World, load_world

FOMT = TaskConfig(lidar=LidarConfig(caster="embree", n_channels=4))
WG = with_reward(FOMT, "wg")


class Straight:
    """Drives straight ahead at full speed, and remembers the readings it was shown."""

    name = "straight"

    def __init__(self, privileged: frozenset[str] = frozenset()) -> None:
        self.privileged = privileged

    def reset(self, seed: int) -> None:
        self.readings: list[Reading] = []

    def act(self, reading: Reading) -> Command:
        self.readings.append(reading)
        return Command(0.6, 0.0)


@pytest.fixture(scope="module")
def world() -> World:
    """Waypoints at x = 2, 4 and 6 m on a centre line along the x axis."""
    line = np.column_stack([np.linspace(0.0, 6.0, 61), np.zeros(61)])
    return replace(load_world("track_1"), centre_line=line, waypoints=np.array([[2.0, 0.0], [4.0, 0.0], [6.0, 0.0]]))


@pytest.fixture(scope="module")
def bare() -> World:
    """A world that names no waypoints."""
    return replace(load_world("track_1"), name="bare", waypoints=np.empty((0, 2)))


@pytest.fixture(scope="module")
def drive():
    made = Drive(WG, load_world("track_2"))
    yield made
    made.close()


def at(x: float, y: float = 0.0, yaw: float = 0.0) -> Pose2:
    return Pose2(x, y, yaw)


def test_a_step_counts_by_how_much_it_came_nearer_to_the_next_waypoint(world):
    guide = WaypointGuide(world, at(0.0))
    assert guide.step(at(0.5, 2.0)) == pytest.approx(2.0 - 2.5)  # 3, 4, 5 triangle: (1.5, 2.0) from the waypoint
    assert guide.step(at(0.0)) == pytest.approx(2.5 - 2.0)


def test_the_step_that_reaches_a_waypoint_counts_to_it_and_the_next_step_to_the_next(world):
    guide = WaypointGuide(world, at(0.0))
    assert guide.step(at(1.49)) == pytest.approx(1.49)
    assert guide.waypoint(at(1.49)).distance_m == pytest.approx(0.51)
    assert guide.step(at(1.5)) == pytest.approx(0.01)
    assert guide.waypoint(at(1.5)).distance_m == pytest.approx(2.5)
    assert guide.step(at(1.4)) == pytest.approx(-0.1)
    assert guide.waypoint(at(1.4)).distance_m == pytest.approx(2.6)  # a reached waypoint does not come back


def test_a_straight_drive_is_paid_for_its_length(world):
    guide = WaypointGuide(world, at(0.0))
    assert sum(guide.step(at(x)) for x in np.linspace(0.12, 6.0, 50)) == pytest.approx(6.0)


def test_the_sum_depends_on_where_the_car_came_and_not_on_how(world):
    detour = WaypointGuide(world, at(0.0))
    nearer = [detour.step(pose) for pose in (at(1.0, 0.6), at(0.3, -0.5), at(-0.5), at(1.2, 0.1))]
    assert sum(nearer) == pytest.approx(WaypointGuide(world, at(0.0)).step(at(1.2, 0.1)))


def test_a_waypoint_passed_at_more_than_half_a_metre_counts_as_done(world):
    guide = WaypointGuide(world, at(1.0, 0.7))
    guide.step(at(1.99, 0.7))
    assert guide.waypoint(at(1.99, 0.7)).distance_m == pytest.approx(math.hypot(0.01, 0.7))
    guide.step(at(2.01, 0.7))
    assert guide.waypoint(at(2.01, 0.7)).distance_m == pytest.approx(math.hypot(1.99, 0.7))
    assert guide.step(at(2.11, 0.7)) > 0.0  # so going on pays


def test_without_a_centre_line_only_reaching_a_waypoint_counts(world):
    free = replace(world, centre_line=np.empty((0, 2)), widths_m=np.empty(0))
    guide = WaypointGuide(free, at(1.0, 0.7))
    guide.step(at(3.0, 0.7))
    assert guide.waypoint(at(3.0, 0.7)).distance_m == pytest.approx(math.hypot(1.0, 0.7))
    guide.step(at(2.0, 0.4))
    assert guide.waypoint(at(2.0)).distance_m == pytest.approx(2.0)


def test_the_goal_stays_the_next_waypoint(world):
    guide = WaypointGuide(world, at(5.0))
    guide.step(at(6.0))
    assert guide.step(at(7.0)) == pytest.approx(-1.0)


@pytest.mark.parametrize(("x", "next_x"), [(0.0, 2.0), (1.6, 4.0), (2.7, 4.0), (3.6, 6.0), (5.9, 6.0)])
def test_an_episode_begins_with_the_first_waypoint_ahead_that_is_not_reached_yet(world, x, next_x):
    pose = at(x, 0.1)
    assert WaypointGuide(world, pose).waypoint(pose).distance_m == pytest.approx(math.hypot(next_x - x, 0.1))


def test_the_bearing_is_seen_from_the_car_left_positive(world):
    guide = WaypointGuide(world, at(0.0))
    assert guide.waypoint(at(0.0)) == Waypoint(2.0, 0.0)
    assert guide.waypoint(at(0.0, yaw=math.pi / 2)) == Waypoint(2.0, pytest.approx(-math.pi / 2))
    assert guide.waypoint(at(0.0, -2.0)) == Waypoint(pytest.approx(math.sqrt(8.0)), pytest.approx(math.pi / 4))
    assert abs(guide.waypoint(at(0.0, yaw=math.pi)).bearing_rad) == pytest.approx(math.pi)
    assert guide.waypoint(at(0.0, yaw=5 * math.pi + 0.3)).bearing_rad == pytest.approx(math.pi - 0.3)


def test_the_mirrored_car_is_told_the_same_mirrored(world):
    mirrored = replace(world, centre_line=world.centre_line * (1, -1), waypoints=world.waypoints * (1, -1))
    pose, other = at(0.3, 0.4, 0.7), at(0.3, -0.4, -0.7)
    here, there = WaypointGuide(world, pose).waypoint(pose), WaypointGuide(mirrored, other).waypoint(other)
    assert (there.distance_m, there.bearing_rad) == (here.distance_m, -here.bearing_rad)


def test_the_reward_is_a_hundred_times_the_metres_and_at_the_end_fifty_alone(drive):
    reading = drive.reset(np.random.default_rng(0))
    first = load_world("track_2").waypoints[0]
    poses, steps = [drive.state.pose], []
    while not steps or steps[-1].outcome is None:
        steps.append(drive.step(Command(0.6, 0.0)))
        poses.append(drive.state.pose)
    away = [math.dist((pose.x, pose.y), first) for pose in poses]
    assert reading.waypoint.distance_m == pytest.approx(away[0])
    n = next(i for i, d in enumerate(away) if d <= 0.5)
    for step, (before, after) in list(zip(steps, pairwise(away), strict=True))[:n]:
        assert step.reward == step.terms["W"] == pytest.approx(100.0 * (before - after))
        assert [step.terms[name] for name in "FOMT"] == [0.0] * 4
    assert sum(step.reward for step in steps[:n]) == pytest.approx(100.0 * (away[0] - away[n]))
    assert (steps[-1].outcome, steps[-1].reward) == ("collision", -50.0)


def test_the_reward_changes_neither_the_drive_nor_its_end(drive):
    unguided = Drive(FOMT, drive.world)
    one, two = (run_episode(each, Straight(), 3, 0) for each in (drive, unguided))
    unguided.close()
    assert np.array_equal(one.pose, two.pose) and one.outcome == two.outcome
    assert one.terms[:, one.term_names.index("W")].any() and not two.terms[:, two.term_names.index("W")].any()


def test_a_reading_names_the_waypoint_only_to_an_agent_that_declares_it(drive):
    fair, guided = Straight(), Straight(frozenset({"waypoint"}))
    run_episode(drive, fair, 0, 0)
    record = run_episode(drive, guided, 0, 0)
    assert all(reading.waypoint is None for reading in fair.readings)
    assert all(reading.waypoint is not None for reading in guided.readings)
    assert record.privileged == ("waypoint",)


def test_a_guided_policy_is_told_the_waypoint_in_an_unguided_task_too_and_the_record_says_so():
    spec = ObservationSpec(n_rays=32, range_max_m=6.0, max_speed_mps=0.6, max_steering_rad=0.6, waypoint=True)
    weight = np.zeros((2, 36), np.float32)
    weight[1, 35] = 2.0  # steers towards the waypoint
    policy = PolicyAgent("towards", [(weight, np.array([9.0, 0.0], np.float32))], spec, {})
    assert policy.privileged == {"waypoint"}
    drive = Drive(FOMT, load_world("track_2"))
    record = run_episode(drive, policy, 0, 0)
    again = replay_episode(drive, record, drive.world)
    drive.close()
    assert record.privileged == again.privileged == ("waypoint",)


@pytest.mark.parametrize("name", list_assets("worlds", ".yaml"))
def test_the_oracle_passes_every_waypoint_of_a_shipped_world_within_60_cm(name):
    drive = Drive(WG, load_world(name))
    record = run_episode(drive, load_agent("oracle", WG), 0, 0)
    drive.close()
    waypoints = drive.world.waypoints
    nearest = np.hypot(*(record.pose[:, None, :2] - waypoints).transpose(2, 0, 1)).min(axis=0)
    assert record.outcome == "success" and nearest[:-1].max() < 0.6
    # Every waypoint was done in turn: the last steps but one count towards the goal.
    towards_goal = -np.diff(np.hypot(*(record.pose[-4:, :2] - waypoints[-1]).T))
    assert record.terms[-3:, record.term_names.index("W")] == pytest.approx(100.0 * towards_goal)


def test_episodes_that_begin_anywhere_are_led_on_and_never_back():
    task = replace(WG, episode=EpisodeConfig(start="anywhere"))
    env = ZebratEnv("track_7", task=task)
    line = env.drive.world.centre_line
    firsts = set()
    for seed in range(30):
        _, info = env.reset(seed=seed)
        pose, told = info["pose"], env.drive.reset(np.random.default_rng(0), pose=info["pose"]).waypoint
        ahead = pose.yaw + told.bearing_rad
        x, y = pose.x + told.distance_m * math.cos(ahead), pose.y + told.distance_m * math.sin(ahead)
        mine, its = (np.hypot(*(line - point).T).argmin() for point in ((pose.x, pose.y), (x, y)))
        assert its > mine and told.distance_m > 0.5
        firsts.add((round(x, 3), round(y, 3)))
    env.close()
    assert len(firsts) > 4


def test_a_world_without_waypoints_is_refused(bare):
    with pytest.raises(ConfigError, match="world 'bare' has none; name them in its world file"):
        Drive(WG, bare)
    with pytest.raises(ConfigError, match="world 'bare' has none"):
        ZebratEnv(["track_1", bare], reward="wg", task=FOMT)
    drive = Drive(FOMT, bare)
    with pytest.raises(ConfigError, match="world 'bare' has none"):
        run_episode(drive, Straight(frozenset({"waypoint"})), 0, 0)
    assert drive.reset(np.random.default_rng(0)).waypoint is None
    drive.close()


def test_with_reward_sets_what_the_reward_needs_to_observe():
    assert (WG.observation.last_command, WG.observation.waypoint, WG.reward.weights) == (True, True, {"W": 100.0})
    paper = with_reward(FOMT, "wg_paper")
    assert (paper.observation.last_command, paper.observation.waypoint, paper.reward) == (False, True, WG.reward)
    assert with_reward(FOMT, "fomt") == FOMT and not FOMT.guided and WG.guided and paper.guided
    with pytest.raises(ConfigError, match="unknown reward preset 'fom'; valid are: fomt, fot, fmt, ft, wg, wg_paper"):
        with_reward(FOMT, "fom")
