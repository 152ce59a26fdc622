"""What planar cars refuse, with the reason, and before anything was simulated."""

import copy
import pickle
import re
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import shapely
from boxes import box_world
from planar_cars import FIELD, planar

from zebrat_bullet.config import FlattenConfig, LidarConfig, ObservationConfig, RewardConfig, TaskConfig, with_reward
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.errors import ActionError, AssetError, ConfigError, EpisodeError, RobotError, WorldError
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.planar.simulation import PlanarSimulation, find_device
from zebrat_bullet.robot import RobotModel
from zebrat_bullet.training.planar_vec_env import PlanarVecEnv
from zebrat_bullet.types import Pose2

LOW = replace(box_world(), name="kerb", low_obstacles=shapely.MultiPolygon([shapely.box(1.0, -1.0, 1.2, 1.0)]))


@pytest.mark.parametrize("name", ["gpu", "cuda:99", "", "CPU"])
def test_an_unknown_device_is_refused_with_those_there_are(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"device must be one of cpu.* on this machine, got '{name}'"):
        PlanarDrive(TaskConfig(), [FIELD], 1, device=name)


def test_cuda_is_refused_where_there_is_none() -> None:
    try:
        assert find_device("cuda") == "cuda:0"
    except ConfigError as error:
        assert "device must be one of cpu on this machine, got 'cuda'" in str(error)


def test_a_world_with_low_walls_is_refused_with_the_reason() -> None:
    with pytest.raises(WorldError, match=r"kerb: has walls under 0\.8 m .*drive it in PyBullet"):
        PlanarDrive(TaskConfig(), [LOW], 1)
    drive = PlanarDrive(TaskConfig(), [FIELD], 1)
    with pytest.raises(WorldError, match="kerb"):
        drive.add_worlds([LOW])
    assert len(drive.worlds) == len(drive.sim.origin) == 1


def test_a_world_without_walls_is_refused() -> None:
    with pytest.raises(WorldError, match="has no walls"):
        PlanarDrive(TaskConfig(), [box_world()], 1)


@pytest.mark.parametrize(
    "task",
    [with_reward(TaskConfig(), "wg"), TaskConfig(observation=ObservationConfig(waypoint=True))],
    ids=["reward", "observation"],
)
def test_a_guided_task_is_refused(task: TaskConfig) -> None:
    with pytest.raises(ConfigError, match="planar cars drive unguided"):
        PlanarDrive(task, [FIELD], 1)


def test_an_unknown_reward_term_is_refused_with_the_valid_ones() -> None:
    with pytest.raises(ConfigError, match="unknown reward term 'X'; valid terms are: F, O, M, T, W"):
        PlanarDrive(TaskConfig(reward=RewardConfig(weights={"X": 1.0})), [FIELD], 1)


def test_no_worlds_and_unknown_worlds_are_refused() -> None:
    with pytest.raises(ConfigError, match="a list with at least one, got"):
        PlanarVectorEnv(1, [])
    with pytest.raises(ConfigError, match="name at least one world"):
        PlanarDrive(TaskConfig(), [], 1)
    with pytest.raises(AssetError, match="track_99"):
        PlanarVectorEnv(1, "track_99")


@pytest.mark.parametrize("n_cars", [0, -3])
def test_fewer_than_one_car_is_refused(n_cars: int) -> None:
    with pytest.raises(ConfigError, match=f"n_cars must be at least 1, got {n_cars}"):
        PlanarDrive(TaskConfig(), [FIELD], n_cars)


@pytest.mark.parametrize("n_cars", [2.5, "3", True])
def test_a_number_of_cars_that_is_none_is_refused(n_cars: object) -> None:
    with pytest.raises(ConfigError, match=f"n_cars must be a whole number, .* got {n_cars!r}"):
        PlanarVectorEnv(n_cars, "track_2")  # type: ignore[arg-type]


def test_a_number_of_numpys_counts_as_cars_and_a_text_as_no_action() -> None:
    env = PlanarVectorEnv(np.int64(3), "track_2")
    assert type(env.num_envs) is int and env.reset(seed=0)[0].shape[0] == 3
    with pytest.raises(ActionError, match=r"actions must be \(3, 2\) numbers, got 'abc'"):
        env.step("abc")  # type: ignore[arg-type]


def test_worlds_and_tasks_that_are_none_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"a world must be a World, got 'track_2'; give load_world"):
        PlanarDrive(TaskConfig(), ["track_2"], 4)  # type: ignore[list-item]
    with pytest.raises(ConfigError, match=r"task must be a TaskConfig, got \{\}"):
        PlanarDrive({}, [FIELD], 4)  # type: ignore[arg-type]


@pytest.mark.parametrize("n_cars", [10**9, 10**13])
def test_more_cars_than_the_memory_holds_are_refused(n_cars: int) -> None:
    with pytest.raises(ConfigError, match=f"{n_cars} cars do not fit into the memory of 'cpu'"):
        planar(FIELD, n_cars)


@pytest.mark.parametrize("margin_m", [-0.01, 0.2, float("nan"), (0.03, 0.01), (0.0, 0.2), "a", [0.01], None])
def test_a_margin_out_of_range_is_refused(margin_m: float | tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match=r"margin_m must be in \[0, 0\.2\)"):
        PlanarDrive(TaskConfig(), [FIELD], 1, margin_m=margin_m)


@pytest.mark.parametrize(
    ("margin_m", "said"),
    [
        ({"corners": 0.01}, "needs 'other' for the rest"),
        ({"corner": 0.01, "other": 0.0}, "no family of tracks 'corner'"),
        ({"corners": 0.3, "other": 0.0}, r"margin_m must be in \[0, 0\.2\)"),
    ],
)
def test_margins_by_family_that_cannot_be_meant_are_refused(margin_m: dict[str, float], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        PlanarDrive(TaskConfig(), [FIELD], 1, margin_m=margin_m)


@pytest.mark.parametrize(
    ("task", "said"),
    [
        (
            TaskConfig(flatten=FlattenConfig(height_min_m=0.05, height_max_m=0.1)),
            "sees walls only beyond the car's outline .*from 2.43 m",
        ),
        (
            TaskConfig(
                lidar=LidarConfig(elevation_min_rad=-0.6, elevation_max_rad=0.6),
                flatten=FlattenConfig(height_min_m=0.81, height_max_m=2.0),
            ),
            "no lidar channel meets a wall of 0.8 m within the height band",
        ),
        (
            TaskConfig(
                lidar=LidarConfig(n_channels=3, elevation_min_rad=0.1, elevation_max_rad=0.2),
                flatten=FlattenConfig(height_max_m=0.7),
            ),
            "sees no wall at all",
        ),
    ],
    ids=["band-under-the-beams", "band-over-the-walls", "beams-over-the-band"],
)
def test_a_lidar_that_loses_walls_which_the_plane_would_see_is_refused(task: TaskConfig, said: str) -> None:
    with pytest.raises((ConfigError, RobotError), match=said):
        PlanarDrive(task, [FIELD], 1)


def test_a_lidar_mounted_at_a_tilt_is_refused(robot: RobotModel) -> None:
    tilted = replace(robot, lidar_rpy=np.array([0.0, 0.02, 0.0]))
    with pytest.raises(ConfigError, match=r"roll and pitch \[0\.0, 0\.02\] rad"):
        PlanarSimulation(tilted, TaskConfig(), np.arange(360), [FIELD], 1)
    PlanarSimulation(replace(robot, lidar_rpy=np.array([0.0, 0.0, 1.0])), TaskConfig(), np.arange(360), [FIELD], 1)


@pytest.mark.parametrize("weights", [[1.0, 1.0], [0.0], [-1.0], [np.nan], [np.inf], ["a"], 1.0, [[1.0]], "much"])
def test_weights_that_are_no_chances_of_the_worlds_are_refused_when_they_are_set(weights: object) -> None:
    drive = PlanarDrive(TaskConfig(), [FIELD], 4)
    with pytest.raises(ConfigError, match="weights must be 1 numbers, one for each world, none below 0 and one above"):
        drive.weights = weights  # type: ignore[assignment]
    assert drive.weights is None


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_non_finite_action_names_car_and_step_and_nothing_is_simulated(bad: float) -> None:
    drive = PlanarDrive(TaskConfig(), [FIELD], 4)
    good = np.full((4, 2), 0.5, np.float32)
    drive.step(good)
    before = drive.state()
    action = good.copy()
    action[2, 1] = bad
    with pytest.raises(ActionError, match=r"for car 2 in step 2; nothing was simulated"):
        drive.step(action)
    assert pickle.dumps(drive.state()) == pickle.dumps(before)


@pytest.mark.parametrize("shape", [(4,), (3, 2), (4, 3), (4, 2, 1)])
def test_actions_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    env = PlanarVectorEnv(4, "track_1")
    env.reset(seed=0)
    with pytest.raises(ActionError, match=r"actions must have the shape \(4, 2\), got \("):
        env.step(np.zeros(shape, np.float32))


def test_actions_beyond_the_limits_are_clipped() -> None:
    ends = []
    for action in ([1.0, -1.0], [9.0, -9.0]):
        drive = PlanarDrive(TaskConfig(), [FIELD], 1)
        drive.step(np.float32([action]))
        ends.append(drive.sim.motion.copy())
    assert np.array_equal(*ends)


WALL = box_world(((2.0, 3.0), (-2.0, 2.0), (0.0, 1.0)))
FREE = [(0.0, 0.0, 0.0), (-3.0, 1.0, 1.0)]


@pytest.mark.parametrize(
    ("worlds", "poses", "said"),
    [
        ([0, 2], FREE, "worlds must be 0 to 1, got 0 to 2"),
        ([-1, 0], FREE, "worlds must be 0 to 1, got -1 to 0"),
        ([0.7, 0.0], FREE, r"worlds must be 2 whole numbers, one for each car, got \[0.7, 0.0\]"),
        ([0], FREE, "worlds must be 2 whole numbers"),
        ([0, 0], FREE[:1], r"poses must be 2, one for each car, each a Pose2 or \(x, y, yaw\) in m and rad"),
        ([0, 0], [(0.0, 0.0), (1.0, 0.0)], "poses must be 2"),
        ([0, 0], [Pose2(0.0, 0.0, 0.0), "here"], "poses must be 2"),
        ([0, 0], [FREE[0], (np.nan, 0.0, 0.0)], "the pose of car 1 must be finite"),
        ([0, 0], [FREE[0], (1e9, 0.0, 0.0)], "the pose of car 1 .* lies outside 'boxes', x -21.00 to 21.00"),
        ([0, 1], [FREE[0], (2.5, 0.0, 0.0)], "the pose of car 1 .* puts it into a wall of 'boxes'; move it"),
    ],
)
def test_a_place_where_no_car_can_begin_is_refused_and_nothing_moves(
    worlds: list[float], poses: list[tuple[float, ...]], said: str
) -> None:
    drive = PlanarDrive(TaskConfig(), [FIELD, WALL], 2)
    before = pickle.dumps(drive.state())
    with pytest.raises(ConfigError, match=said):
        drive.begin_at(worlds, poses)
    assert pickle.dumps(drive.state()) == before
    drive.begin_at([0, 1], [Pose2(*FREE[0]), Pose2(*FREE[1])])


def test_cars_that_were_placed_may_drive_and_those_of_a_training_not_before_a_reset_or_after_the_end() -> None:
    actions = np.zeros((2, 2), dtype=np.float32)
    env = PlanarVectorEnv(2, "track_2")
    cars = PlanarVecEnv(env)
    with pytest.raises(EpisodeError, match="call reset first"):
        cars.step(actions)
    env.drive.begin_at([0, 0], [env.drive.worlds[0].start.pose] * 2)
    env.step(actions)
    cars.step(actions)
    cars.close()
    with pytest.raises(EpisodeError, match="this environment is closed; make a new one"):
        cars.step(actions)


def test_planar_cars_are_neither_stepped_before_a_reset_nor_copied() -> None:
    env = PlanarVectorEnv(2, "track_2")
    with pytest.raises(EpisodeError, match="call reset first"):
        env.step(np.zeros((2, 2), dtype=np.float32))
    env.reset(seed=0)
    env.step(np.zeros((2, 2), dtype=np.float32))
    for copied in (copy.deepcopy, pickle.dumps):
        with pytest.raises(EpisodeError, match="cannot be copied or pickled"):
            copied(env)


@pytest.mark.parametrize("options", [{"pose": (0.0, 0.0, 0.0)}, [{}, {"pose": (0.0, 0.0, 0.0)}]])
def test_options_of_sb3s_reset_are_refused_as_those_of_gymnasiums(options: dict | list) -> None:
    cars = PlanarVecEnv(PlanarVectorEnv(2, "track_2"))
    with pytest.raises(ConfigError, match=r"takes no options, got .*pose.*; drive.begin_at places cars"):
        cars.set_options(options)
    for none in (None, {}, [{}, {}]):
        cars.set_options(none)
    assert len(cars.reset()) == 2


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ({"discrete": True}, "no discrete=True; their actions are continuous"),
        (
            {"max_episode_steps": 5},
            "no max_episode_steps=5; say it in the task: task={'episode'",
        ),
        ({"wrld": "track_2"}, "no wrld='track_2'; they take worlds, start, goal"),
        ({"vectorization_mode": "sync"}, "planar cars are many at once: call gymnasium.make_vec"),
    ],
)
def test_settings_that_planar_cars_do_not_have_are_told_what_to_use_instead(
    setting: dict[str, object], said: str
) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        gymnasium.make_vec("ZebraT/Planar-v0", num_envs=2, **setting)
    with pytest.raises(ConfigError, match="planar cars are many at once"):
        gymnasium.make("ZebraT/Planar-v0")


def test_a_refused_seed_leaves_the_returns_of_the_episodes_under_way():
    cars = PlanarVecEnv(PlanarVectorEnv(2, "track_2"))
    cars.reset()
    cars.step(np.full((2, 2), 0.5, dtype=np.float32))
    before = cars._returns.copy()
    cars.seed(-1)
    with pytest.raises(ConfigError, match="seed"):
        cars.reset()
    assert before.any() and np.array_equal(cars._returns, before)
