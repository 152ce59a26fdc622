"""A policy is judged under the task that it was trained on, and what differs from the default is said."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from own_cars import ROS_JOINTS, OwnCar

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.policy import PolicyAgent, load_policy, save_policy
from zebrat_bullet.assets import asset_folder
from zebrat_bullet.cli import main
from zebrat_bullet.config import LidarConfig, PhysicsConfig, SafetyRegionConfig, TaskConfig
from zebrat_bullet.config_text import from_json, to_json
from zebrat_bullet.errors import ConfigError, PolicyError
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.evaluation.records import load_record
from zebrat_bullet.notes import Note
from zebrat_bullet.robot import fitted, load_robot, named_robot
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.task.observation import observation_spec

OWN = TaskConfig(
    region=SafetyRegionConfig(kind="firect"),
    lidar=LidarConfig(range_max_m=3.0, caster="embree", bearings="region"),
    physics=PhysicsConfig(max_speed_mps=0.4),
)


def policy_of(task: TaskConfig, path: Path) -> Path:
    """Write a policy that always gives full speed ahead, trained on a task."""
    robot = load_robot(task.robot)
    spec = observation_spec(task, make_region(robot, task.region, task.lidar.n_bearings), robot)
    layer = np.zeros((2, spec.size), np.float32), np.array([1.0, 0.0], np.float32)
    save_policy(PolicyAgent("p", [layer], spec, {"config": {"task": json.loads(to_json(task))}}, head="clip"), path)
    return path


def judged_task(arguments: list[str], out: Path) -> TaskConfig:
    """Return the task in the record of an episode that `zebrat evaluate` drove."""
    given = ["--worlds", "track_2", "--episodes", "1", "--workers", "1", "--caster", "embree", "--out", str(out)]
    assert main(["evaluate", *arguments, *given]) == 0
    return from_json(TaskConfig, load_record(out / "records" / "track_2" / "episode_0000.npz").task)


def test_region_lidar_and_limits_are_those_of_training_and_said(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    policy = policy_of(OWN, tmp_path / "own.safetensors")
    task = judged_task(["--agent", str(policy)], tmp_path / "a")
    assert (task.region.kind, task.lidar.range_max_m, task.physics.max_speed_mps) == ("firect", 3.0, 0.4)
    assert task.lidar.bearings == "all" and task.reward == TaskConfig().reward
    said = capfd.readouterr().err
    for words in ('task.region.kind="firect" (default "sr")', "task.lidar.range_max_m=3.0 (default 6.0)"):
        assert words in said


def test_set_goes_before_the_task_of_training(tmp_path: Path) -> None:
    policy = policy_of(OWN, tmp_path / "own.safetensors")
    task = judged_task(["--agent", str(policy), "--set", "task.lidar.range_max_m=4"], tmp_path / "a")
    assert (task.region.kind, task.lidar.range_max_m) == ("firect", 4.0)


def test_a_setting_that_is_none_of_the_task_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--agent", "shipped", "--set", "lidar.range_max_m=4"]) == 2
    assert "task.KEY=VALUE" in capfd.readouterr().err


@pytest.mark.parametrize("agent", ["shipped", "fomt", "il", "dagger", "teb", "random"])
def test_shipped_agents_are_judged_under_the_default_task(agent: str) -> None:
    assert as_trained(TaskConfig(), agent, own_robot=True) == (TaskConfig(), [])


def test_the_car_of_training_is_judged_unless_another_is_named_and_replayed_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    OwnCar(names=dict(ROS_JOINTS)).write(tmp_path, "mine.urdf")
    monkeypatch.chdir(tmp_path)
    name = named_robot("mine.urdf", [f"{role}={joint}" for role, joint in ROS_JOINTS.items()])
    policy = policy_of(replace(OWN, robot=name), tmp_path / "own.safetensors")
    task = judged_task(["--agent", str(policy)], tmp_path / "a")
    assert task.robot == name and Path(name.partition(":")[0]).is_absolute()
    monkeypatch.chdir("/")
    capfd.readouterr()
    assert main(["replay", str(tmp_path / "a" / "records" / "track_2" / "episode_0000.npz"), "--json"]) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["exact"]
    assert load_policy(str(policy)).provenance["config"]["task"]["robot"] == name


def test_a_record_whose_car_has_moved_replays_where_it_lies_now_and_with_no_other_car(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    mine = OwnCar().write(tmp_path, "mine.urdf")
    judged_task(["--agent", "random", "--robot", str(mine)], tmp_path / "a")
    record = str(tmp_path / "a" / "records" / "track_2" / "episode_0000.npz")
    moved = mine.rename(tmp_path / "moved.urdf")
    capfd.readouterr()
    assert main(["replay", record]) == 2
    assert "--robot says where it lies" in capfd.readouterr().err
    assert main(["replay", record, "--robot", str(moved)]) == 0
    assert main(["replay", record, "--robot", "long"]) == 2
    assert "left the recorded path" in capfd.readouterr().err


def test_what_has_changed_of_the_car_since_the_training_is_noted(tmp_path: Path) -> None:
    mine = OwnCar().write(tmp_path, "mine.urdf")
    task = fitted(replace(TaskConfig(), robot=str(mine)))
    policy = str(policy_of(task, tmp_path / "own.safetensors"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_agent(policy, task)
    OwnCar(hinge_limit='<limit lower="-0.3" upper="0.3" effort="5" velocity="6"/>').write(tmp_path, "mine.urdf")
    with pytest.warns(Note, match=r"now max_steering_rad 0\.2\d+ instead of 0\.\d+"):
        load_agent(policy, task)


@pytest.mark.parametrize("agent", ["shipped", "il"])  # il does not say its car
def test_that_another_car_has_other_limits_than_that_of_the_training_is_noted_once(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], agent: str
) -> None:
    text = (asset_folder("urdf") / "zebrat.urdf").read_text(encoding="utf-8")
    assert 'upper="0.85"' in text
    stiff = tmp_path / "stiff.urdf"
    stiff.write_text(text.replace('"-0.85"', '"-0.3"').replace('"0.85"', '"0.3"'), encoding="utf-8")
    said = f"policy '{agent}' observes something else than this car: max_steering_rad 0.6 for 0.2"
    with pytest.warns(Note, match=said):
        judged_task(["--agent", agent, "--robot", str(stiff)], tmp_path / "a")
    assert said not in capfd.readouterr().err, "a worker says it again"


def test_a_policy_that_its_own_car_alone_can_drive_says_which(tmp_path: Path) -> None:
    mine = OwnCar().write(tmp_path, "mine.urdf")
    policy = str(policy_of(fitted(replace(TaskConfig(), robot=str(mine))), tmp_path / "own.safetensors"))
    with pytest.raises(PolicyError, match=f"let it drive its own car, --robot {mine}, or train one for this: zebrat"):
        load_agent(policy, TaskConfig())


def test_a_study_of_an_agent_drives_the_car_of_its_training_and_says_so(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    mine = OwnCar().write(tmp_path, "mine.urdf")
    policy = str(policy_of(fitted(replace(TaskConfig(), robot=str(mine))), tmp_path / "own.safetensors"))
    options = ["--agent", policy, "--axes", "mass=1.3", "--worlds", "track_2", "--episodes", "1", "--workers", "1"]
    assert main(["robustness", *options, "--caster", "embree", "--out", str(tmp_path / "out")]) == 0
    assert f"the car is that which {policy} was trained on: {mine}" in capfd.readouterr().err
    assert json.loads((tmp_path / "out" / "study.json").read_text(encoding="utf-8"))["task"]["robot"] == str(mine)


@pytest.mark.parametrize("command", ["robustness", "width", "families"])
def test_a_study_of_agents_of_several_cars_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], command: str
) -> None:
    mine = OwnCar().write(tmp_path, "mine.urdf")
    policy = str(policy_of(fitted(replace(TaskConfig(), robot=str(mine))), tmp_path / "own.safetensors"))
    assert main([command, "--agent", "shipped", policy, "il", "--out", str(tmp_path / "out")]) == 2
    assert f"trained on several cars, shipped on zebrat, {policy} on {mine}; measure one" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


def test_networks_of_another_car_are_refused_in_our_words(tmp_path: Path) -> None:
    import gymnasium
    from stable_baselines3 import PPO

    from zebrat_bullet.training.tensors import begin_with

    class Car(gymnasium.Env):
        def __init__(self, size: int) -> None:
            self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (size,))
            self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))

    models = {size: PPO("MlpPolicy", Car(size), device="cpu", n_steps=8, batch_size=8) for size in (34, 40)}
    models[34].save(tmp_path / "best.zip")
    begin_with(models[34], tmp_path / "best.zip")
    with pytest.raises(ConfigError, match=r"other networks.*\(64, 34\), here \(64, 40\).*same car") as refused:
        begin_with(models[40], tmp_path / "best.zip")
    assert "state_dict" not in str(refused.value)
