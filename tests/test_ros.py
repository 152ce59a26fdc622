"""Two processes, real ROS 2 between them: the car drives out, and stands where one of them is gone."""

import json
import math
import re
import signal
import sys
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'zebrat-bullet[ros]'")

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist
from ros_probe import Probe, Processes, answered, cloud, corridor, said
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan, PointCloud2

from zebrat_bullet.agents.export import export_policy
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.deploy.driver import Driver
from zebrat_bullet.errors import ConfigError, PolicyError, SensorError
from zebrat_bullet.ros.drive import drive
from zebrat_bullet.ros.drive_node import DriveNode
from zebrat_bullet.ros.messages import cloud_points, scan_ranges, steering_of, yaw_rate
from zebrat_bullet.ros.parameters import DriveSettings, SimSettings, make_node, read_parameters
from zebrat_bullet.ros.publish import cloud_message, scan_message, time_of
from zebrat_bullet.ros.runtime import check_ros, ros
from zebrat_bullet.ros.sim import simulate
from zebrat_bullet.types import FlatScan, PointCloud

DOCS = Path(__file__).parent.parent / "docs"
STEP_S = 0.2
STANDS_MPS = 0.02


@pytest.fixture(scope="module")
def policy(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("shipped")
    export_policy("shipped", folder)
    return folder


@pytest.fixture
def processes(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    made = Processes(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(made.domain))
    yield made
    made.close()


@pytest.fixture
def probe(processes):
    made = Probe(processes)
    yield made
    made.close()


# --- The loop, closed


@pytest.mark.parametrize("world, sensor", [("track_2", "cloud"), ("real_3", "scan")])
def test_a_node_without_simulator_drives_the_car_out(processes, policy, world, sensor):
    driver = processes.drive(policy, f"input:={sensor}")
    ended = json.loads(answered(processes.sim("--world", world, "--lockstep", "30")))
    driver.send_signal(signal.SIGTERM)
    told = json.loads(answered(driver))
    assert ended["outcome"] == "success" and ended["braked"] == ended["unanswered"] == 0
    assert told["commands"] >= ended["steps"]
    print(f"{world}: {ended['time_s']} s; scan to command {ended['latency_ms']}; of that work {told['work_ms']}")


# --- Something dies


def test_the_car_stands_when_the_driving_node_is_killed(processes, policy, probe):
    """The command is held until 0.4 s old; braking takes a control step: 0.4 s after the first that is missing."""
    processes.sim("--world", "big_track", "--lockstep", "1")
    probe.until(lambda: probe.hears("odom"))  # without a driver the car waits; with one the drive is over in seconds
    driver = processes.drive(policy)
    probe.until(lambda: _drives(probe))
    driver.kill()
    driver.wait()
    heard = len(probe.speeds)
    probe.until(lambda: len(probe.speeds) > heard + 6)
    missing_s = probe.commands[-1][0] + STEP_S
    _stands_from(probe, missing_s + 0.4)


def test_the_car_stands_when_the_lidar_is_killed(processes, policy, probe):
    """The robot itself would obey old commands for long; it is the node that must stop it."""
    lidar = processes.start(str(Path(__file__).parent / "ros_relay.py"))
    processes.sim("--world", "big_track", "--lockstep", "1", parameters=("timeout_s:=10.0",))
    probe.until(lambda: probe.hears("odom"))
    processes.drive(policy, "cloud_topic:=points_relayed")
    probe.until(lambda: _drives(probe))
    lidar.kill()
    lidar.wait()
    heard = len(probe.speeds)
    probe.until(lambda: len(probe.speeds) > heard + 6)
    stops = [stamp for stamp, speed in probe.commands if speed == 0.0]
    moves = [stamp for stamp, speed in probe.commands if speed != 0.0]
    missing_s = moves[-1] + STEP_S
    assert stops and stops[0] <= missing_s + STEP_S + 0.01
    _stands_from(probe, missing_s + 0.4)


def test_the_node_commands_a_stop_when_the_simulator_is_killed(processes, policy, probe):
    driver = processes.drive(policy, sim_time=False)
    robot = processes.sim("--world", "track_2")
    probe.until(lambda: len(probe.commands) > 8 and probe.commands[-1][1] > 0.4)
    robot.kill()
    robot.wait()
    probe.until(lambda: probe.commands[-1][1] == 0.0)
    print(f"stop {probe.commands[-1][0] - probe.commands[-2][0]:.3f} s after the last command")
    probe.until(lambda: "no scan on /points" in said(driver))  # it says so after it has acted
    assert driver.poll() is None


def _drives(probe: Probe) -> bool:
    """Return whether the car was heard to drive, by commands that were heard too."""
    return len(probe.commands) > 4 and len(probe.speeds) > 8 and probe.speeds[-1][1] > 0.4


def _stands_from(probe: Probe, time_s: float) -> None:
    before = [speed for stamp, speed in probe.speeds if stamp < time_s - 0.5]
    after = [speed for stamp, speed in probe.speeds if stamp > time_s - 0.01]
    assert max(before) > 0.4, "it never drove"
    assert len(after) >= 2 and max(map(abs, after)) < STANDS_MPS, probe.speeds[-10:]


# --- What is wrong is told


def test_a_reliable_subscriber_tells_that_it_cannot_hear_a_best_effort_lidar(processes, policy, probe):
    lidar = probe.publisher(PointCloud2, "points", reliable=False)
    driver = processes.drive(policy, "reliability:=reliable", sim_time=False)

    def warned() -> bool:
        lidar.publish(cloud(corridor()))
        return "publishes best_effort, this node asks for reliable" in said(driver)

    probe.until(warned)
    assert not probe.commands


def test_a_lidar_of_another_type_and_a_missing_one_are_told(processes, policy, probe):
    probe.publisher(LaserScan, "points")
    probe.publisher(PointCloud2, "velodyne_points")
    one = processes.drive(policy, sim_time=False)
    two = processes.drive(policy, "cloud_topic:=lidar", sim_time=False)
    probe.until(lambda: "publishes sensor_msgs/msg/LaserScan, this node wants" in said(one))
    probe.until(lambda: "nobody publishes /lidar" in said(two) and "; there are /velodyne_points." in said(two))


def test_scans_that_cannot_be_relied_on_stop_the_car_and_say_why(processes, policy, probe):
    lidar = probe.publisher(PointCloud2, "points")
    driver = processes.drive(policy, sim_time=False)

    def drives(message) -> None:
        heard = len(probe.commands)
        probe.until(lambda: _sent(lidar, message) and len(probe.commands) > heard and probe.commands[-1][1] != 0.0)

    def stops(message, why: str) -> None:
        heard = len(probe.commands)
        probe.until(lambda: _sent(lidar, message) and why in said(driver) and len(probe.commands) > heard)
        probe.until(lambda: probe.commands[-1][1] == 0.0)

    good = corridor()
    drives(lambda: cloud(good))
    stops(lambda: cloud(good, frame="velodyne"), "in the frame 'velodyne', expected 'lidar'")
    drives(lambda: cloud(good))
    stops(lambda: cloud(good, stamp_s=time.time() - 100.0), "s old by its stamp")
    stops(lambda: cloud(good, stamp_s=time.time() + 100.0), "s in the future: the lidar's clock")
    stops(lambda: cloud(good[:0]), "0 of 0 points are returns")
    stops(lambda: cloud(np.full_like(good, np.nan)), "points are returns within 6 m")
    stops(lambda: _without_fields(cloud(good)), "must have the fields x, y and z, got none")
    stops(lambda: _cut(cloud(good)), "bytes, got 100")
    drives(lambda: cloud(good))
    driver.send_signal(signal.SIGTERM)
    probe.until(lambda: probe.commands[-1][1] == 0.0)  # its last word
    assert json.loads(answered(driver))["refused"] >= 7


def test_a_scan_that_comes_again_and_again_is_none(processes, policy, probe):
    """A lidar that hangs, its driver sending the last revolution."""
    lidar = probe.publisher(PointCloud2, "points")
    driver = processes.drive(policy, "trust_stamps:=true", sim_time=False)
    probe.until(lambda: _sent(lidar, lambda: cloud(corridor())) and len(probe.commands) > 2)
    last = cloud(corridor())
    probe.until(lambda: _sent(lidar, lambda: last) and "no scan on /points" in said(driver))
    probe.until(lambda: probe.commands[-1][1] == 0.0)


def test_of_a_lidar_at_10_hz_every_second_scan_is_driven(processes, policy, probe):
    lidar, clock = probe.publisher(PointCloud2, "points"), probe.publisher(Clock, "/clock")
    processes.drive(policy)
    probe.until(
        lambda: lidar.get_subscription_count() == clock.get_subscription_count() == 1 and probe.hears("cmd_vel")
    )
    for _ in range(5):  # a scan before its clock would be refused, and the next one driven at once
        clock.publish(Clock(clock=time_of(1000.0)))
        time.sleep(0.1)
    for scan in range(21):
        stamp_s = 1000.0 + 0.1 * scan
        clock.publish(Clock(clock=time_of(stamp_s)))
        lidar.publish(cloud(corridor(), stamp_s=stamp_s))
        probe.until(lambda n=scan // 2 + 1: len(probe.commands) >= n)
    assert len(probe.commands) == 11


def test_a_turned_lidar_is_understood_once_its_yaw_is_told(processes, policy, probe):
    """Its cable to the right: what is ahead of the car it calls left."""
    points = corridor() + np.array([0.0, 0.15, 0.0], np.float32)  # nearer to the right wall, so that it steers
    lidar = probe.publisher(PointCloud2, "points")
    processes.drive(policy, "lidar_yaw_rad:=-1.5707963", sim_time=False)
    x, y, z = points.T
    turned = np.stack([-y, x, z], axis=1)
    probe.until(lambda: _sent(lidar, lambda: cloud(turned)) and any(probe.yaw_rates))
    heard = next(
        filter(None, probe.yaw_rates)
    )  # the first that was heard; the probe may find the node later than it drives
    driver = Driver.load(policy)
    commands = [driver.drive_cloud(points).command for _ in range(10)]
    expected = [yaw_rate(command.speed_mps, command.steering_rad, driver.car.wheelbase_m) for command in commands]
    assert min(map(abs, expected)) > 0.1
    assert any(heard == pytest.approx(one, rel=0.05) for one in expected), (heard, expected)


def test_without_a_clock_a_node_in_simulated_time_says_so(processes, policy, probe):
    lidar = probe.publisher(PointCloud2, "points")
    driver = processes.drive(policy, sim_time=True)
    probe.until(lambda: _sent(lidar, lambda: cloud(corridor())) and "nothing publishes /clock" in said(driver))


def _sent(publisher, message) -> bool:
    publisher.publish(message())
    time.sleep(0.05)
    return True


def _without_fields(message: PointCloud2) -> PointCloud2:
    message.fields = []
    return message


def _cut(message: PointCloud2) -> PointCloud2:
    message.data = message.data[:100]
    return message


@pytest.mark.parametrize(
    "arguments, told",
    [
        (["-p", "margin:=0.1"], "no parameter 'margin'; did you mean margin_m"),
        (["-p", "margin_m:=wide"], "margin_m must be a float, got 'wide'"),
        (["-p", "margin_m:=-1"], "margin_m must be 0 to 10, got -1.0"),
        (["-p", "input:=camera"], "input must be cloud or scan, got 'camera'"),
        (["-p", "lidar_yaw_rad:=90.0"], "must be -2 pi to 2 pi (-6.283 to 6.283), got 90.0; it is in radians"),
        (["-p", "lidar_yaw_rad:=.inf"], "lidar_yaw_rad must be -2 pi to 2 pi"),
        (["-p", "reliability:=sure"], "reliability must be best_effort or reliable"),
        (["-p", "max_speed_mps:=0.0"], "max_speed_mps must be above 0"),
        (["-p", "max_speed_mps:=300.0"], "max_speed_mps is 300, above the policy's own limit of 0.6"),
        (["-p", "max_steering_rad:=30.0"], "max_steering_rad is 30, above the policy's own limit of 0.6"),
        (["-p", "deceleration_mps2:=-1.0"], "deceleration_mps2 must be 0 to 100, got -1.0"),
        (["-p", "delay_s:=200.0"], "delay_s must be 0 to 10, got 200.0"),
        (["-p", "least_sector_points:=-1"], "least_sector_points must be 0 to"),
        (["-p", "driver:max_speed_mps:=0.3"], "is for another node, this one is zebrat_drive; leave its name out"),
        (["-p", "watchdog_s:=0.1"], "watchdog_s must be above the policy's control step of 0.2 s"),
        (["-p", "watchdog_s:=.nan"], "watchdog_s must be 0.05 to 10, got nan"),
        (["-p", "supervised:=maybe"], "supervised must be a bool"),
        (["-p", "cloud_topic:=my lidar"], "'my lidar' is no topic"),
        (["-p", "command_topic:=''"], "command_topic must name a topic"),
        (["-p", "margin_m"], "ROS does not take --ros-args -p margin_m"),
        (["--params-file", "/no/such.yaml"], "Error opening YAML file"),
        (["--fly"], "--fly"),
    ],
)
def test_a_wrong_parameter_is_refused(processes, policy, arguments, told):
    with pytest.raises(ConfigError, match=re.escape(told)):
        drive(str(policy), arguments)


@pytest.mark.parametrize(
    "renamed, first_line, told",
    [
        ((), "zebrat_driver:", "files are of zebrat_driver and none is of zebrat_drive"),
        (("-r", "__node:=front"), "zebrat_drive:", "files are of zebrat_drive and none is of front"),
        ((), "zebrat_drive:", ""),
        ((), "/zebrat_drive:", ""),
        ((), '"/**":', ""),
        (("-r", "__node:=front"), "front:", ""),
        (("-r", "__ns:=/car"), "/car/zebrat_drive:", ""),
        (("-r", "__ns:=/car"), "car:\n  zebrat_drive:", ""),
        (("-r", "__ns:=/fleet/car"), "fleet:\n  car:\n    zebrat_drive:", ""),
    ],
)
def test_a_parameter_file_for_other_nodes_alone_is_refused(processes, tmp_path, renamed, first_line, told):
    path = tmp_path / "drive.yaml"
    indent = "  " * (1 + first_line.count("\n"))
    lines = [f"{indent}ros__parameters:", f"{indent}  margin_m: 0.25  # wide: yes"]
    path.write_text("\n".join(["# of the car", first_line, *lines]) + "\n", encoding="utf-8")
    arguments = ["--params-file", str(path), *renamed]
    with ros(arguments):
        if told:
            with pytest.raises(ConfigError, match=told):
                make_node("zebrat_drive", arguments)
        else:
            node = make_node("zebrat_drive", arguments)
            assert read_parameters(node, DriveSettings).margin_m == 0.25
            node.destroy_node()
    # Beside one that is meant another may be of other nodes; a -p of another is told all the same.
    other = tmp_path / "other.yaml"
    other.write_text("camera:\n  ros__parameters:\n    rate: 5\n", encoding="utf-8")
    if not told:
        with ros(both := [*arguments, "--params-file", str(other)]):
            make_node("zebrat_drive", both).destroy_node()
            with pytest.raises(ConfigError, match="is for another node"):
                make_node("zebrat_drive", [*both, "-p", "camera:rate:=6"])


def test_a_terminal_that_is_closed_ends_in_a_stop(processes, policy, probe):
    lidar, good = probe.publisher(PointCloud2, "points"), corridor()
    driver = processes.drive(policy, sim_time=False)
    probe.until(lambda: _sent(lidar, lambda: cloud(good)) and probe.commands and probe.commands[-1][1] != 0.0)
    driver.send_signal(signal.SIGHUP)
    probe.until(lambda: probe.commands[-1][1] == 0.0)
    assert driver.wait(60.0) == 0, said(driver)
    assert "at up to 0.6 m/s and 0.6 rad, supervised at 0.01 m" in said(driver)


HANGING_BASE = """
import rclpy
from geometry_msgs.msg import TwistStamped
rclpy.init()
node = rclpy.create_node("base")
node.create_subscription(TwistStamped, "cmd_vel", lambda message: print("heard", flush=True), 1)
rclpy.spin(node)
"""


def test_the_last_stop_is_waited_for_until_it_is_acknowledged(processes, policy, probe):
    """Else it may be lost: what is on its way when a publisher ends is not sent again."""
    lidar, good = probe.publisher(PointCloud2, "points"), corridor()
    base = processes.start("-c", HANGING_BASE)
    driver = processes.drive(policy, sim_time=False)
    heard = Path(f"{base.name}.out")
    probe.until(lambda: _sent(lidar, lambda: cloud(good)) and "heard" in heard.read_text(encoding="utf-8"))
    base.send_signal(signal.SIGSTOP)
    driver.send_signal(signal.SIGTERM)
    probe.until(lambda: probe.commands and probe.commands[-1][1] == 0.0)
    answered(driver)
    assert "the last stop on /cmd_vel was not acknowledged within 1 s" in said(driver)


@pytest.mark.parametrize("end", [RuntimeError("unsupported"), KeyboardInterrupt()])
def test_where_it_cannot_be_waited_for_the_result_is_there_all_the_same(end, processes, policy, monkeypatch, capfd):
    def fails(publisher, timeout):
        raise end

    monkeypatch.setattr("rclpy.publisher.Publisher.wait_for_all_acked", fails)
    with ros([]):
        node = make_node("zebrat_drive", [])
        made = DriveNode(node, read_parameters(node, DriveSettings), Driver.load(policy), None).end()
        node.destroy_node()
    assert made["commands"] == 0
    told = "was not acknowledged as far as ROS can tell (unsupported)" in capfd.readouterr().err
    assert told == isinstance(end, RuntimeError)


def test_the_car_s_own_braking_and_delay_reach_the_supervisor(processes, policy, monkeypatch):
    made = []
    monkeypatch.setattr("zebrat_bullet.ros.drive_node.DriveNode", lambda *given: made.append(given) or _stop_here())
    with pytest.raises(KeyboardInterrupt):
        drive(str(policy), ["-p", "deceleration_mps2:=0.5", "-p", "delay_s:=0.1", "-p", "least_sector_points:=0"])
    (_, _, driver, supervisor) = made[0]
    assert (supervisor.car.deceleration_mps2, supervisor.delay_s) == (0.5, 0.1)
    assert driver._limits.least_sector_points == 0


def _stop_here() -> None:
    raise KeyboardInterrupt


def test_a_policy_that_is_none_is_refused(processes, policy, tmp_path):
    with pytest.raises(ConfigError, match=re.escape(f"name its folder, {policy}")):
        drive(str(policy / "policy.onnx"), [])
    with pytest.raises(ConfigError, match="no policy; give --policy"):
        drive("", [])
    with pytest.raises(PolicyError, match=r"policy\.json"):
        drive(str(tmp_path / "missing"), [])


def test_the_page_and_its_parameter_file_are_true(processes):
    page, example = (DOCS / "ros.md").read_text(encoding="utf-8"), DOCS / "ros" / "drive.yaml"
    for settings in (DriveSettings, SimSettings):
        for each in fields(settings):
            assert f"`{each.name}`" in page, each.name
    assert example.read_text(encoding="utf-8").split("\n", 1)[1] in page
    with ros(["--params-file", str(example), "-p", "margin_m:=1"]):
        node = make_node("zebrat_drive")
        read = read_parameters(node, DriveSettings)
        assert (read.lidar_frame, read.max_speed_mps, read.margin_m) == ("velodyne", 0.3, 1.0)
        assert node.describe_parameter("margin_m").description
        node.destroy_node()


@pytest.mark.parametrize(
    "options, told",
    [
        ({"rate": 0.0}, "--rate must be 0.01 to 100"),
        ({"rate": math.nan}, "--rate must be 0.01 to 100"),
        ({"lockstep_s": -1.0}, "--lockstep must be"),
        ({"wait_s": 0.3}, "no command on /cmd_vel within 0.3 s"),
        ({"ros_arguments": ["-p", "timeout_s:=0"]}, "timeout_s must be 0.05 to 10, got 0.0"),
        ({"ros_arguments": ["-p", "rate:=2"]}, "no parameter 'rate'"),
    ],
)
def test_a_wrong_option_of_the_simulator_is_refused(processes, options, told):
    with pytest.raises(ConfigError, match=re.escape(told)):
        simulate("track_2", TaskConfig(), **options)


@pytest.mark.parametrize(
    "options, told", [({}, False), ({"rate": 2.0}, True), ({"lockstep_s": 0.1}, True), ({"rate": 1.0}, False)]
)
def test_the_simulator_says_when_its_driver_needs_simulated_time(processes, capfd, options, told):
    with pytest.raises(ConfigError, match="no command"):
        simulate("track_2", TaskConfig(), wait_s=0.1, **options)
    assert ("the driver needs --ros-args -p use_sim_time:=true" in capfd.readouterr().err) is told


@pytest.mark.parametrize(
    "name, value, told",
    [
        ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", "the wheels of ROS hold rmw_fastrtps_cpp alone"),
        ("ROS_DOMAIN_ID", "999", "ROS_DOMAIN_ID must be a whole number from 0 to 232, got '999'"),
    ],
)
def test_an_environment_in_which_ros_would_die_is_told(monkeypatch, name, value, told):
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=told):
        check_ros()


def test_where_ros_is_not_installed_the_extra_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "rclpy.node")
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(ConfigError, match=re.escape("pip install 'zebrat-bullet[ros]'")):
        check_ros()


# --- The simulator obeys


def test_the_simulator_obeys_a_twist_without_stamp_and_none_that_is_not_finite(processes, probe):
    commands = probe.publisher(Twist, "drive")
    robot = processes.sim("--lockstep", "0.3", parameters=("stamped:=false", "command_topic:=drive"))
    probe.until(lambda: probe.hears("odom"))
    good, bad = Twist(), Twist()
    good.linear.x, bad.linear.x = 0.3, math.nan
    probe.until(lambda: _sent(commands, lambda: good) and len(probe.speeds) > 3 and probe.speeds[-1][1] > 0.29)
    probe.until(lambda: _sent(commands, lambda: bad) and "not finite is not obeyed" in said(robot))
    probe.until(lambda: _sent(commands, lambda: bad) and abs(probe.speeds[-1][1]) < STANDS_MPS)


# --- Messages

VELODYNE = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "time"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
        "offsets": [0, 4, 8, 12, 16, 18],
        "itemsize": 22,
    }
)
VELODYNE_PADDED = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "ring", "time"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u2", "<f4"],
        "offsets": [0, 4, 8, 16, 20, 24],
        "itemsize": 32,
    }
)
OUSTER = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "t", "reflectivity", "ring", "ambient", "range"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u4", "<u2", "<u2", "<u2", "<u4"],
        "offsets": [0, 4, 8, 16, 20, 24, 26, 28, 32],
        "itemsize": 48,
    }
)
BIG_ENDIAN = np.dtype({"names": list("xyz"), "formats": [">f4"] * 3, "offsets": [4, 8, 12], "itemsize": 20})
DOUBLES = np.dtype({"names": list("zyx"), "formats": ["<f8"] * 3, "offsets": [0, 8, 16], "itemsize": 24})
POINTS = np.random.default_rng(0).normal(size=(64, 3)).astype(np.float32)


@pytest.mark.parametrize(
    "layout", [VELODYNE, VELODYNE_PADDED, OUSTER, BIG_ENDIAN, DOUBLES], ids=lambda d: str(d.itemsize)
)
def test_the_clouds_of_real_lidars_are_read(layout):
    read = cloud_points(cloud(POINTS, layout))
    assert read.dtype == np.float32 and np.array_equal(read, POINTS)


@pytest.mark.parametrize("layout", [VELODYNE_PADDED, OUSTER], ids=["32", "48"])
def test_a_cloud_is_read_without_a_copy(layout):
    message = cloud(POINTS, layout)
    assert np.shares_memory(cloud_points(message), np.frombuffer(message.data, np.uint8))


def test_an_organised_cloud_with_padded_rows_and_missing_returns_is_read():
    message = cloud(POINTS, OUSTER)
    rows = np.frombuffer(message.data, np.uint8).reshape(4, 16 * 48)
    padded = np.concatenate([rows, np.full((4, 10), 255, np.uint8)], axis=1)
    message.height, message.width, message.row_step, message.is_dense = 4, 16, 16 * 48 + 10, False
    message.data = padded.ravel().tolist()
    assert np.array_equal(cloud_points(message), POINTS)


def test_what_we_publish_is_read_back():
    valid = np.arange(64) % 5 != 0
    message = cloud_message(PointCloud(POINTS, valid, np.eye(3), 0.75), 4, time_of(1.25), "lidar")
    read = cloud_points(message)
    assert (message.height, message.width) == (4, 16) and message.header.stamp == Time(sec=1, nanosec=250_000_000)
    assert np.array_equal(read[valid], POINTS[valid]) and np.isnan(read[~valid]).all()
    scan = scan_message(FlatScan(np.array([1, 6, 2, 3], np.float32), 6.0), np.eye(3), time_of(0.0), "lidar", 0.2)
    assert scan_ranges(scan).tolist() == [1.0, math.inf, 2.0, 3.0]
    assert scan.angle_min + 3 * scan.angle_increment == pytest.approx(scan.angle_max) == pytest.approx(math.pi / 2)


def test_ranges_outside_of_what_a_lidar_measures_are_discarded():
    message = LaserScan(range_min=0.2, range_max=5.0, ranges=[0.1, 0.2, 5.0, 5.5, math.inf, -math.inf, math.nan, 0.0])
    expected = [math.nan, 0.2, 5.0, math.inf, math.inf, -math.inf, math.nan, math.nan]
    assert np.array_equal(scan_ranges(message), np.array(expected, np.float32), equal_nan=True)


@pytest.mark.parametrize(
    "wrong, told",
    [
        ({"width": 65}, "needs"),
        ({"height": 2, "row_step": 10}, "in rows of 10 needs"),
        ({"height": 0}, "all must be above 0"),
        ({"point_step": 0}, "all must be above 0"),
        ({"point_step": 8, "row_step": 512}, "do not lie within a point of 8 bytes"),
        ({"fields": []}, "fields x, y and z, got none"),
    ],
)
def test_a_cloud_that_contradicts_itself_is_refused(wrong, told):
    message = cloud(POINTS)
    for name, value in wrong.items():
        setattr(message, name, value)
    with pytest.raises(SensorError, match=told):
        cloud_points(message)


def test_coordinates_that_are_no_floats_and_ranges_without_limits_are_refused():
    message = cloud(POINTS)
    message.fields[1].datatype = 6
    with pytest.raises(SensorError, match="y of a cloud must be one float32"):
        cloud_points(message)
    with pytest.raises(SensorError, match="range_min must be at least 0 and below range_max"):
        scan_ranges(LaserScan(range_min=1.0, range_max=1.0, ranges=[1.0]))


def test_a_twist_says_the_steering_of_a_moving_car_and_loses_that_of_a_standing_one():
    assert yaw_rate(0.6, 0.6, 0.56) == pytest.approx(0.6 * math.tan(0.6) / 0.56)
    for speed in (0.6, -0.3, 0.001):
        assert steering_of(speed, yaw_rate(speed, 0.4, 0.56), 0.56) == pytest.approx(0.4)
    assert yaw_rate(0.0, 0.4, 0.56) == steering_of(0.0, 0.0, 0.56) == 0.0
