"""An exported policy decides as the package's own agent does, and its folder says all there is to know of it."""

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import onnx
import pytest
from exported import SPEC, random_policy, way

from zebrat_bullet.agents import load_agent, trained_task
from zebrat_bullet.agents.export import export_policy
from zebrat_bullet.agents.policy import PolicyAgent, save_policy
from zebrat_bullet.cli import main
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.deploy import Driver
from zebrat_bullet.deploy.network import OPERATIONS
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.safety_region import make_region
from zebrat_bullet.types import Command, FlatScan, Reading

N_READINGS = 10_000
SHIPPED = ("shipped", "allround", "fomt", "il", "dagger")


@cache
def readings() -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 360) scans and (N, 2) last commands: the way's scans by turns, noisy, rays lost, after anything."""
    rng, scans = np.random.default_rng(1), np.stack([scan.ranges_m for scan in way().scans])
    ranges = np.tile(scans, (N_READINGS // len(scans) + 1, 1))[:N_READINGS]
    ranges = np.clip(ranges + rng.normal(0.0, 0.02, ranges.shape), 0.01, 6.0).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.01] = 6.0
    return ranges, rng.uniform(-0.6, 0.6, (N_READINGS, 2)).astype(np.float32)


@pytest.mark.parametrize("policy", SHIPPED)
def test_a_shipped_policy_commands_what_its_agent_does(policy, tmp_path):
    export_policy(policy, tmp_path)
    driver, task = Driver.load(tmp_path), trained_task(policy) or TaskConfig()
    agent, region = load_agent(policy, task), make_region(load_robot(task.robot), task.region, task.lidar.n_bearings)
    expected, given = [], []
    for ranges, last in zip(*readings(), strict=True):
        scan, driver.last_command = FlatScan(ranges, 6.0), Command(*last.tolist())
        expected.append(agent.act(Reading(scan, region.measure(scan), driver.last_command, 0.0, 0.0)))
        given.append(driver.drive_scan(ranges))
    assert not any(decision.refusal for decision in given)
    off = np.array([[d.command.speed_mps, d.command.steering_rad] for d in given])
    off -= [[command.speed_mps, command.steering_rad] for command in expected]
    assert np.abs(off).max() < 1e-5
    assert np.ptp([command.steering_rad for command in expected]) > 0.5  # it did steer


@pytest.mark.parametrize("activation", ["relu", "tanh", "elu", "clip tanh"])
@pytest.mark.parametrize("head", ["tanh", "clip", "argmax", "grid"])
def test_every_head_and_activation_acts_as_its_agent_does(head, activation, tmp_path):
    policy = str(random_policy(head, activation, tmp_path))
    export_policy(policy, tmp_path / "out")
    driver, agent = Driver.load(tmp_path / "out"), load_agent(policy, TaskConfig())
    assert isinstance(agent, PolicyAgent)
    ranges, last = readings()
    seen = agent.observation.encode_cars(ranges[:, list(driver.definition.indices)], last)
    actions = agent.action(seen)
    assert np.abs(driver._network(seen) - actions).max() < 1e-5
    assert (np.ptp(actions, axis=0) > 0.1).all()
    driver.last_command = Command(*last[0].tolist())
    command = agent.observation.decode(actions[0])
    decided = driver.drive_scan(ranges[0]).command
    assert (decided.speed_mps, decided.steering_rad) == pytest.approx(
        (command.speed_mps, command.steering_rad), abs=1e-5
    )


def test_the_folder_holds_plain_layers_a_definition_and_a_card(tmp_path):
    made = export_policy("allround", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["README.md", "policy.json", "policy.onnx"]
    model = onnx.load(tmp_path / "policy.onnx")
    assert {node.op_type for node in model.graph.node} <= set(OPERATIONS)
    says = json.loads((tmp_path / "policy.json").read_text(encoding="utf-8"))
    assert says["format"] == "zebrat-deploy-1" and says["model"]["sha256"] == made.model_sha256
    region = says["safety_region"]
    assert region["bearings_rad"][region["indices"].index(180)] == 0.0 and len(region["range_m"]) == 152
    assert region["range_m"][region["indices"].index(180)] == pytest.approx(0.1)  # from the lidar to the nose
    assert [part["n"] for part in says["observation"]["parts"]] == [152, 152, *[1] * 22]  # command, and a trail of five
    assert [part["times"] for part in says["action"]["parts"]] == [0.6, 0.6]
    assert says["car"]["wheelbase_m"] == 0.56 and says["control_step_s"] == 0.2
    card = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "15 million more from the best of these, with a" in card and "judged in simulation only" in card


def test_the_same_policy_gives_the_same_bytes(tmp_path):
    for name in ("one", "two"):
        export_policy("shipped", tmp_path / name)
    assert (tmp_path / "one/policy.onnx").read_bytes() == (tmp_path / "two/policy.onnx").read_bytes()
    assert (tmp_path / "one/policy.json").read_bytes() == (tmp_path / "two/policy.json").read_bytes()


def test_a_run_folder_is_exported_by_its_own_name_and_no_folder_of_this_machine_is_told(tmp_path):
    run = tmp_path / "my_run"
    run.mkdir()
    worlds = [str(tmp_path / "world.yaml")]
    random_policy("tanh", "relu", run, config={"worlds": worlds}).rename(run / "best.safetensors")
    assert export_policy(str(run), tmp_path / "out").name == "my_run"
    for path in (tmp_path / "out").iterdir():
        assert str(tmp_path).encode() not in path.read_bytes()
    assert '"world.yaml"' in (tmp_path / "out/README.md").read_text(encoding="utf-8")


def test_a_car_that_is_a_file_is_told_by_its_name(tmp_path):
    (tmp_path / "mine.urdf").write_bytes(load_robot("zebrat").urdf_path.read_bytes())
    policy = random_policy("tanh", "relu", tmp_path)
    made = export_policy(str(policy), tmp_path / "out", robot=str(tmp_path / "mine.urdf"))
    assert made.car.name == "mine" and str(tmp_path) not in (tmp_path / "out/policy.json").read_text(encoding="utf-8")


def test_a_policy_exported_for_a_car_that_it_was_not_trained_for_says_so(tmp_path, capfd):
    urdf = tmp_path / "higher.urdf"
    text = (Path(__file__).parent.parent / "urdf" / "zebrat.urdf").read_text(encoding="utf-8")
    urdf.write_text(text.replace('<origin xyz="0.4 0 0.75"/>', '<origin xyz="0.4 0 0.5"/>'), encoding="utf-8")
    assert main(["export", "shipped", "--robot", str(urdf), "--out", str(tmp_path / "higher")]) == 0
    told = "lidar_xyz_base (0.4, 0.0, 0.5) instead of (0.4, 0.0, 0.75)"
    said = capfd.readouterr().out
    assert told in said and "judge it on this one" in said
    assert f"- **It was trained for another car**, not judged on this one: {told}." in (
        tmp_path / "higher" / "README.md"
    ).read_text(encoding="utf-8")
    assert main(["export", "shipped", "--robot", "zebrat", "--out", str(tmp_path / "same")]) == 0
    assert "trained for another car" not in capfd.readouterr().out + (tmp_path / "same" / "README.md").read_text(
        encoding="utf-8"
    )


def test_what_is_no_network_or_was_guided_or_has_another_car_is_not_exported(tmp_path):
    with pytest.raises(PolicyError, match="'teb' is no trained network"):
        export_policy("teb", tmp_path)
    with pytest.raises(PolicyError, match="was trained on the robot 'zebrat', whose bearings lie otherwise"):
        export_policy("shipped", tmp_path, robot="hexagon")
    unsaid = str(random_policy("tanh", "relu", tmp_path))
    with pytest.raises(PolicyError, match=r"was trained with 32 bearings and limits .* 'long' has 50 bearings"):
        export_policy(unsaid, tmp_path, robot="long")
    guided = replace(SPEC, waypoint=True)
    layers = [(np.zeros((2, guided.size), np.float32), np.zeros(2, np.float32))]
    save_policy(PolicyAgent("guided", layers, guided, {}), tmp_path / "guided.safetensors")
    with pytest.raises(PolicyError, match="observes the next waypoint, which nobody tells a car on the road"):
        export_policy(str(tmp_path / "guided.safetensors"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_commands_say_where_the_folder_is_and_how_long_a_decision_takes(tmp_path):
    zebrat = Path(sys.executable).parent / "zebrat"
    told = [zebrat, "export", "shipped", "--out", tmp_path / "here", "--json"]
    done = subprocess.run(told, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["folder"] == str(tmp_path / "here") and Driver.load(tmp_path / "here")
    timed = subprocess.run(
        [zebrat, "bench", "--deploy", "--world", "track_2", "--steps", "20", "--json"], capture_output=True, check=True
    )
    times = json.loads(timed.stdout)["shipped"]
    assert times["points"] == 5760 and times["cloud_cpu_p50_ms"] > times["network_cpu_p50_ms"] > 0.0
    wrong = subprocess.run([zebrat, "export", "nobody"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2 and "no agent 'nobody'" in wrong.stderr
