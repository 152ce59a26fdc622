"""The trail: where a car was, reckoned from its commands alone; the same for one car, for thousands and on the road."""

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from exported import SPEC, way
from safetensors.numpy import load_file

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.export import export_policy
from zebrat_bullet.agents.policy import PolicyAgent, save_policy
from zebrat_bullet.config import EpisodeConfig, LidarConfig, ObservationConfig, TaskConfig
from zebrat_bullet.config_text import to_json
from zebrat_bullet.deploy import Driver
from zebrat_bullet.deploy.definition import DEFINITION_FILE
from zebrat_bullet.envs.planar_env import PlanarVectorEnv
from zebrat_bullet.envs.zebrat_env import ZebratEnv
from zebrat_bullet.errors import ConfigError, PolicyError
from zebrat_bullet.planar.drive import PlanarDrive
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.task.observation import observation_spec
from zebrat_bullet.task.trail import Trail
from zebrat_bullet.training.learner_settings import PPOConfig
from zebrat_bullet.training.learners import build_learner
from zebrat_bullet.training.planar_vec_env import PlanarVecEnv
from zebrat_bullet.training.presets import ALGORITHMS
from zebrat_bullet.training.run import train
from zebrat_bullet.training.settings import PlanarConfig, TrainConfig
from zebrat_bullet.training.tensors import begin_with
from zebrat_bullet.types import Command, Reading
from zebrat_bullet.world import load_world

STEP_S, WHEELBASE_M = 0.2, 0.65
TASK = TaskConfig(
    lidar=LidarConfig(caster="embree"),
    observation=ObservationConfig(trail_steps=(1, 4)),
    episode=EpisodeConfig(start="start"),
)
ROBOT = load_robot()
SEEN = observation_spec(TASK, make_region(ROBOT, TASK.region, 360), ROBOT)


def told(*cars: tuple[float, float]) -> np.ndarray:
    return np.array(cars, dtype=np.float32)


def trail(*steps: int, n_cars: int = 1) -> Trail:
    return Trail(steps, STEP_S, WHEELBASE_M, np.zeros((n_cars, 2), dtype=np.float32))


def test_a_car_that_went_straight_has_come_from_behind():
    kept = trail(1, 3)
    for _ in range(5):
        kept.follow(told((0.5, 0.0)))
    # 0.5 m/s for 0.2 s are 0.1 m a step
    assert kept.look()[0].tolist() == pytest.approx([-0.1, 0.0, 0.0, 1.0, -0.3, 0.0, 0.0, 1.0])


def test_before_its_episode_a_car_has_stood_where_it_began():
    kept = trail(10)
    kept.follow(told((-0.5, 0.0)))
    assert kept.look()[0].tolist() == pytest.approx([0.1, 0.0, 0.0, 1.0])


def test_a_car_that_turned_was_on_the_circle_of_its_wheels():
    steering, n = 0.4, 50
    radius = WHEELBASE_M / math.tan(steering)
    turned = 0.3 * STEP_S * n / radius
    kept = trail(n)
    for _ in range(n):
        kept.follow(told((0.3, steering)))
    # seen from where it stands now, it began on the circle about (0, radius), turned back by `turned`
    expected = [-radius * math.sin(turned), radius * (1.0 - math.cos(turned)), -math.sin(turned), math.cos(turned)]
    assert kept.look()[0].tolist() == pytest.approx(expected, abs=1e-3)


def test_left_and_right_are_mirrored():
    left, right = trail(5), trail(5)
    for _ in range(7):
        left.follow(told((0.6, 0.5)))
        right.follow(told((0.6, -0.5)))
    assert left.look()[0] == pytest.approx(right.look()[0] * [1, -1, -1, 1], abs=1e-6)


def test_an_episode_that_begins_forgets_its_own_car_only():
    kept = trail(2, n_cars=3)
    for _ in range(3):
        kept.follow(told((0.5, 0.0), (0.5, 0.0), (0.5, 0.0)))
    kept.begin(np.array([1]))
    assert kept.look()[:, 0].tolist() == pytest.approx([-0.2, 0.0, -0.2])


def test_the_trail_comes_last_scaled_by_how_far_the_car_could_have_come():
    kept = SEEN.new_trail(told((0.0, 0.0)))
    for _ in range(4):
        kept.follow(told((0.6, 0.0)))
    obs = np.full((1, SEEN.n_rays), 3.0, np.float32)
    encoded = SEEN.encode_cars(obs, told((0.6, 0.0)), trail=kept.look())[0]
    assert len(encoded) == SEEN.size == SEEN.n_rays + 2 + 8
    assert encoded[-8:].tolist() == pytest.approx([-1.0, 0.0, 0.0, 1.0] * 2, abs=1e-6)
    assert (SEEN.bounds[0] <= encoded).all() and (encoded <= SEEN.bounds[1]).all()
    raw = replace(SEEN, raw=True).encode_cars(obs, told((0.6, 0.0)), trail=kept.look())[0]
    assert raw[-4] == pytest.approx(-4 * 0.12)


def test_one_car_in_pybullet_and_planar_ones_reckon_alike():
    env = ZebratEnv("track_2", task=TASK)
    env.reset(seed=0)
    planar = PlanarDrive(TASK, [load_world("track_2")], 2)
    planar.begin_at(np.zeros(2, np.int32), [env.drive.state.pose] * 2)
    for action in np.random.default_rng(0).uniform(-0.5, 0.5, (8, 2)).astype(np.float32):
        ours = env.step(action)[0]
        theirs = planar.step(np.stack([action, action])).observation
        assert ours[-8:] == pytest.approx(theirs[1, -8:], abs=1e-5)
    assert np.abs(ours[-4:-2]).max() > 0.02
    first, _ = env.reset(seed=0)
    assert first[-8:].tolist() == [0.0, 0.0, 0.0, 1.0] * 2
    env.close()


def follower(folder: Path) -> Path:
    """Save a policy that steers by where it was four steps ago, and drives ahead."""
    weight = np.zeros((2, SEEN.size), np.float32)
    weight[1, -4:-2] = 0.9, -0.7
    agent = PolicyAgent(
        "follower",
        [(weight, np.array([0.8, 0.5], np.float32))],
        SEEN,
        {"config": {"task": json.loads(to_json(TASK))}},
        head="clip",
    )
    save_policy(agent, folder / "follower.safetensors")
    return folder / "follower.safetensors"


def test_a_policy_remembers_within_an_episode_and_forgets_at_the_next(tmp_path):
    agent = load_agent(str(follower(tmp_path)), TASK)
    region = make_region(ROBOT, TASK.region, 360)
    scan = way().scans[0]

    def drive() -> list[float]:
        agent.reset(0)
        last, steered = Command(0.0, 0.0), []
        for _ in range(6):
            last = agent.act(Reading(scan, region.measure(scan), last, 0.0, 0.0))
            steered.append(last.steering_rad)
        return steered

    first = drive()
    assert len(set(first)) == 6  # the scan is the same, what it remembers is not
    assert drive() == first


def test_on_the_road_it_reckons_as_its_agent_does_also_over_a_lost_scan(tmp_path):
    path = str(follower(tmp_path))
    definition = export_policy(path, tmp_path / "out")
    assert definition.observation == SEEN
    driver, agent = Driver.load(tmp_path / "out"), load_agent(path, TASK)
    region, last = make_region(ROBOT, TASK.region, 360), Command(0.0, 0.0)
    agent.reset(0)
    for i, scan in enumerate(way().scans[:12]):
        if i == 5:
            stop = driver.drive_scan(np.full(360, np.nan, np.float32))
            assert stop.refusal
            agent.act(Reading(scan, region.measure(scan), last, 0.0, 0.0))
            last = stop.command
            continue
        given = driver.drive_scan(scan.ranges_m).command
        last = agent.act(Reading(scan, region.measure(scan), last, 0.0, 0.0))
        assert (given.speed_mps, given.steering_rad) == pytest.approx((last.speed_mps, last.steering_rad), abs=1e-5)
    driver.reset()
    agent.reset(0)
    scan = way().scans[0]
    again = agent.act(Reading(scan, region.measure(scan), Command(0.0, 0.0), 0.0, 0.0))
    assert driver.drive_scan(scan.ranges_m).command.steering_rad == pytest.approx(again.steering_rad, abs=1e-5)


def test_its_definition_names_the_trails_parts_and_another_wheelbase_is_refused(tmp_path):
    export_policy(str(follower(tmp_path)), tmp_path / "out")
    path = tmp_path / "out" / DEFINITION_FILE
    data = json.loads(path.read_text(encoding="utf-8"))
    parts = data["observation"]["parts"]
    assert sum(part["n"] for part in parts) == SEEN.size
    assert parts[-1]["what"] == "trail: cosine of yaw 4 steps ago"
    assert "8 x where it was 1, 4 steps ago" in (tmp_path / "out" / "README.md").read_text(encoding="utf-8")
    export_policy("shipped", tmp_path / "without")
    without = json.loads((tmp_path / "without" / DEFINITION_FILE).read_text(encoding="utf-8"))["observation"]
    assert "trail_steps" not in without  # those exported before there were trails stay as they are
    other = PolicyAgent(
        "other",
        load_agent(str(tmp_path / "follower.safetensors"), TASK).layers,
        replace(SEEN, wheelbase_m=SEEN.wheelbase_m + 0.1),
        {"config": {"task": json.loads(to_json(TASK))}},
        head="clip",
    )
    save_policy(other, tmp_path / "other.safetensors")
    with pytest.raises(PolicyError, match="reckoned for another control step or wheelbase"):
        export_policy(str(tmp_path / "other.safetensors"), tmp_path / "refused")


@pytest.mark.parametrize("steps", [(0,), (5, 2000), (float("nan"),)])
def test_steps_that_cannot_be_meant_are_refused(steps):
    with pytest.raises(ConfigError, match="trail_steps must be 1 to 1000"):
        ObservationConfig(trail_steps=steps)


def test_where_no_trail_is_kept_such_a_policy_is_refused():
    with pytest.raises(ConfigError, match="no trail is kept here"):
        SEEN.encode_cars(np.ones((3, SEEN.n_rays), np.float32), np.zeros((3, 2), np.float32))
    with pytest.raises(ConfigError, match="wheelbase_m must be"):
        replace(SPEC, trail_steps=(1,), control_step_s=0.2)
    assert asdict(SPEC)["wheelbase_m"] == 0.0


def tiny(algo: str, **changes: object) -> TrainConfig:
    learner = replace(ALGORITHMS[algo], hidden=(8,), batch_size=16)
    learner = replace(learner, n_steps=16) if isinstance(learner, PPOConfig) else replace(learner, warmup_steps=32)
    planar = PlanarConfig(n_cars=16, n_tracks=4, n_eval_tracks=2, n_eval_starts=2, eval_every_steps=10**6)
    return TrainConfig(learner=learner, planar=planar, worlds=(), steps=512, **changes)


def test_a_policy_without_a_memory_goes_on_learning_with_one_and_drives_as_before_at_first(tmp_path):
    train(tiny("ppo"), tmp_path / "without")
    init = tmp_path / "without" / "best.zip"
    train(tiny("ppo", init=str(init), task=TASK), tmp_path / "with")
    before, learned = (load_file(tmp_path / name / "best.safetensors")["0.weight"] for name in ("without", "with"))
    assert learned.shape[1] == before.shape[1] + 8 and learned[:, -8:].any()

    cars = [PlanarVecEnv(PlanarVectorEnv(4, [load_world("track_2")], task=task)) for task in (TaskConfig(), TASK)]
    old, new = (build_learner(tiny("ppo"), at) for at in cars)
    begin_with(old, init)
    begin_with(new, init, n_new=8)
    seen = torch.rand((5, SEEN.size))
    assert torch.allclose(new.policy.predict_values(seen), old.policy.predict_values(seen[:, :-8]))
    own, theirs = (at.policy.get_distribution(obs).distribution.mean for at, obs in ((new, seen), (old, seen[:, :-8])))
    assert torch.allclose(own, theirs)
    moments = new.policy.optimizer.state_dict()["state"]
    assert [len(at) for at in moments.values()] == [3] * len(list(new.policy.parameters()))


def test_only_ppo_takes_up_a_policy_without_a_memory(tmp_path):
    train(tiny("sac"), tmp_path / "without")
    config = tiny("sac", init=str(tmp_path / "without" / "best.zip"), task=TASK)
    with pytest.raises(ConfigError, match="other networks than the settings of this run name"):
        train(config, tmp_path / "with")
