"""What the driving node makes of stamps: its methods called with real messages, at times that the test sets."""

import math
import re
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'zebrat-bullet[ros]'")

from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from ros_probe import Domain, cloud, corridor

from zebrat_bullet.agents.export import export_policy
from zebrat_bullet.deploy.decision import Decision
from zebrat_bullet.deploy.driver import Driver, Limits
from zebrat_bullet.deploy.supervisor import Supervisor
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.ros import drive_node
from zebrat_bullet.ros.parameters import DriveSettings, make_node, read_parameters
from zebrat_bullet.ros.publish import scan_message, time_of
from zebrat_bullet.ros.runtime import ros
from zebrat_bullet.types import Command, FlatScan

WATCHDOG_S = 0.4
TICK_S = WATCHDOG_S / 10.0
BEGIN_S = 1000.0
CORRIDOR = corridor()


def _exported(folder: Path, policy: str = "shipped", robot: str | None = None) -> Driver:
    export_policy(policy, folder, robot)
    return Driver.load(folder, limits=Limits(stale_s=WATCHDOG_S))


@pytest.fixture(scope="module")
def driver(tmp_path_factory) -> Driver:
    return _exported(tmp_path_factory.mktemp("shipped"))


class Run:
    """A node whose time is the test's, and what it has sent: when, and the speed."""

    def __init__(self, driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
        node = make_node("zebrat_drive")
        self.settings, self.now_s = read_parameters(node, DriveSettings), BEGIN_S
        self.sent: list[tuple[float, float]] = []
        self.refusals: list[str] = []
        self.ages: list[float] = []
        self.holds: list[float | None] = []
        self.since: list[float | None] = []
        driver.reset()
        supervisor = Supervisor(driver.car, driver.definition.control_step_s, self.settings.margin_m, WATCHDOG_S)
        self.node = drive_node.DriveNode(node, self.settings, driver, supervisor)
        monkeypatch.setattr(drive_node, "time", SimpleNamespace(monotonic=lambda: self.now_s))
        monkeypatch.setattr(self.node, "_now_s", lambda: self.now_s)
        send, check = self.node._send, supervisor.check

        def sent(decision):
            self.sent.append((self.now_s, decision.command.speed_mps))
            self.refusals.append(decision.refusal)
            send(decision)

        def checked(command, scan, speed, steering, age_s=0.0, hold_s=None, since_s=None):
            self.ages.append(age_s)
            self.holds.append(hold_s)
            self.since.append(since_s)
            return check(command, scan, speed, steering, age_s, hold_s, since_s)

        monkeypatch.setattr(self.node, "_send", sent)
        monkeypatch.setattr(supervisor, "check", checked)

    def scan(self, stamp_s: float) -> None:
        self.node._on_scan(cloud(CORRIDOR, stamp_s=stamp_s))

    def until(self, end_s: float, stamp_s, period_s: float = 0.1) -> None:
        """Let time go on, a scan each period with the stamp that is told for its time; the watchdog looks each tick."""
        n = 0
        begin_s = self.now_s
        while (at_s := begin_s + 0.02 * n) < end_s - 1e-6:
            self.now_s = at_s
            if n % round(period_s / 0.02) == 0:
                self.scan(stamp_s(at_s))
            if n % round(TICK_S / 0.02) == 0:
                self.node._watch()
            n += 1
        self.now_s = end_s


@pytest.fixture
def run(driver, monkeypatch, request):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain = Domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain.id))
    with closing(domain), ros([word for each in getattr(request, "param", ()) for word in ("-p", each)]):
        yield Run(driver, monkeypatch)


def _drives(run: Run) -> None:
    """Drive by a good lidar at 10 Hz for 2 s."""
    run.until(BEGIN_S + 2.0, lambda now_s: now_s)
    assert len(run.sent) == 10 and all(speed != 0.0 for _, speed in run.sent[2:]) and not any(run.refusals)


def _stopped(run: Run, last_s: float) -> None:
    """Check that a stop was sent by the watchdog's time after a scan, and that the car is not driven again later."""
    stops = [at_s for at_s, speed in run.sent if at_s > last_s and speed == 0.0]
    assert stops and stops[0] <= last_s + WATCHDOG_S + TICK_S + 1e-6, run.sent
    assert all(speed == 0.0 for at_s, speed in run.sent if at_s > last_s + WATCHDOG_S + 3 * TICK_S), run.sent


@pytest.mark.parametrize("period_s", [0.04, 0.1, 0.16, 0.2])
def test_stamps_that_creep_end_in_a_stop(run, period_s):
    """A lidar whose clock goes a hundred times too slow: after its last true scan it stamps each 1 ms later."""
    _drives(run)
    last_s = run.now_s - 0.1
    stamps = iter(last_s + 1e-3 * n for n in range(1, 1000))
    run.until(run.now_s + 3.0, lambda _: next(stamps), period_s)
    _stopped(run, last_s)
    assert any("s old by its stamp" in each for each in run.refusals)


@pytest.mark.parametrize("run", [["trust_stamps:=true"], ["trust_stamps:=false"]], ids=["true", "false"], indirect=True)
def test_one_scan_again_and_again_ends_in_a_stop_whether_stamps_are_trusted_or_not(run):
    _drives(run)
    last_s = run.now_s - 0.1
    run.until(run.now_s + 2.0, lambda _: last_s)
    _stopped(run, last_s)
    assert "one stamp again and again" in run.refusals[-1]


@pytest.mark.parametrize("run", [["trust_stamps:=false"]], ids=["false"], indirect=True)
def test_a_lidar_with_a_clock_of_its_own_is_driven_by_where_stamps_are_not_trusted(run):
    run.until(BEGIN_S + 2.0, lambda now_s: now_s - 900.0)
    assert len(run.sent) == 10 and not any(run.refusals) and run.sent[-1][1] != 0.0


@pytest.mark.parametrize("ahead_s, taken", [(0.005, True), (0.015, True), (0.03, False), (0.35, False)])
def test_a_stamp_in_the_future_is_taken_for_some_milliseconds_alone(run, ahead_s, taken):
    _drives(run)
    heard = len(run.sent)
    run.until(run.now_s + 1.0, lambda now_s: now_s + ahead_s)
    assert all((speed != 0.0) is taken for _, speed in run.sent[heard:]), run.sent[heard:]
    told = [f"stamped {ahead_s:.3f} s in the future: the lidar's clock is ahead" in each for each in run.refusals]
    assert any(told) is not taken and min(run.ages) >= 0.0


@pytest.mark.parametrize("run", [["use_sim_time:=true"]], ids=["sim"], indirect=True)
def test_in_simulated_time_a_scan_may_be_heard_before_its_clock(run):
    _drives(run)
    heard = len(run.sent)
    run.until(run.now_s + 1.0, lambda now_s: now_s + 0.2)
    assert len(run.sent) > heard and not any(run.refusals) and min(run.ages) >= 0.0


def test_a_lidar_that_is_set_back_is_driven_by_at_once(run):
    _drives(run)
    heard = len(run.sent)
    run.scan(run.now_s - 0.25)
    assert len(run.sent) == heard + 1 and run.sent[-1][1] != 0.0


def test_the_age_of_the_measured_speed_counts_from_its_arrival(run):
    odometry = Odometry()  # its stamp is 0
    odometry.twist.twist.linear.x = 0.5
    run.node._on_odometry(odometry)
    run.now_s += WATCHDOG_S - 0.01
    assert run.node._measured_speed() == 0.5
    run.now_s += 0.02
    assert run.node._measured_speed() is None


def test_a_stamp_some_milliseconds_before_the_last_is_no_clock_that_was_set(run):
    """A lidar at 20 Hz whose every second stamp is 30 ms early is driven by five times a second, not ten."""
    stamps = (BEGIN_S + 0.05 * n - 0.08 * (n % 2) for n in range(1000))
    run.until(BEGIN_S + 4.0, lambda _: next(stamps), 0.06)
    assert 14 <= len(run.sent) <= 20, len(run.sent)


# --- How far ahead the supervisor looks, and what a policy with a memory is told


def test_the_supervisor_looks_as_far_ahead_as_a_slow_lidar_s_next_scan_and_the_log_says_so(run, capfd):
    run.until(BEGIN_S + 2.0, lambda now_s: now_s, 0.2)
    assert set(run.holds) == {None}
    run.until(BEGIN_S + 4.0, lambda now_s: now_s, 0.34)
    assert run.holds[-1] == pytest.approx(0.34, abs=1e-6)
    assert run.since[-1] == pytest.approx(0.34, abs=1e-6)
    told = "the last scans driven by came up to 0.34 s apart, the policy has learned to decide every 0.2 s"
    assert told in capfd.readouterr().err
    run.until(BEGIN_S + 8.0, lambda now_s: now_s, 0.2)
    assert run.holds[-1] is run.since[-1] is None


def test_simulated_time_that_jumps_is_no_way_that_was_driven(run):
    _drives(run)
    run.node._since_s(run.now_s)
    assert run.node._since_s(run.now_s + 1.7e9) == 2.0 * WATCHDOG_S


def _driven_m(run: Run) -> float:
    """Return how far straight commands have taken a car that does what it is told, until the last of them."""
    return sum(speed * (b - a) for (a, speed), (b, _) in zip(run.sent, run.sent[1:], strict=False))


@pytest.mark.parametrize("period_s", [0.06, 0.1, 0.14, 0.16, 0.2, 0.24, 0.34])
def test_the_memory_of_a_policy_goes_by_time_at_any_rate_of_the_lidar(tmp_path, monkeypatch, period_s):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain = Domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain.id))
    with closing(domain), ros(()):
        run = Run(_exported(tmp_path, "allround"), monkeypatch)
        monkeypatch.setattr(run.node, "_checked", lambda decision, *times: _straight(run, decision))
        run.until(BEGIN_S + 3.0, lambda now_s: now_s, period_s)
        for refused in (True, False, True, False):  # none for some time, in which the watchdog stops the car
            if refused:
                run.node._on_scan(cloud(CORRIDOR, frame="another", stamp_s=run.now_s))
            for _ in range(20):
                run.now_s += TICK_S
                run.node._watch()
            run.until(run.now_s + 1.0, lambda now_s: now_s, period_s)
        poses = run.node._driver._trail.state()["trail"]
        assert poses[0, 0, 0] == pytest.approx(_driven_m(run), abs=0.02)


def _straight(run: Run, decision: Decision) -> Decision:
    command = Command(0.0 if decision.refusal else 0.5, 0.0)
    run.node._driver.last_command = command
    return replace(decision, command=command)


# --- A lidar that is mounted otherwise


MOUNTS = {"turned": (0.0, 0.0, math.pi), "to the left": (0.0, 0.0, 1.3), "upside down": (math.pi, 0.0, 0.4)}


@pytest.mark.parametrize("rpy", MOUNTS.values(), ids=MOUNTS)
def test_clouds_and_scans_of_a_lidar_mounted_otherwise_say_the_same_as_of_a_level_one(driver, tmp_path, run, rpy):
    """What stands to the left ahead is there, whichever way the lidar's frame is turned and whichever sensor it is."""
    wall = np.array([[2.0 + 0.2 * math.sin(a), a, z] for a in np.linspace(-2.0, 1.0, 300) for z in (-0.4, 0.0)])
    behind = np.array([[-3.0, a, 0.0] for a in np.linspace(-3.0, 3.0, 300)])
    floor = np.array([[math.cos(a), math.sin(a), -0.75] for a in np.linspace(0.0, 6.2, 64)])
    points = np.concatenate([wall, behind, floor])
    driver.drive_cloud(points)
    expected = driver.last_scan.ranges_m.copy()
    urdf = tmp_path / "mine.urdf"
    text = (Path(__file__).parent.parent / "urdf" / "zebrat.urdf").read_text(encoding="utf-8")
    level = re.search(r'<joint name="lidar_mount".*?<origin xyz="[^"]*"()', text, re.DOTALL)
    assert level and 'rpy="' not in text[level.end() : level.end() + 5], "the mount in zebrat.urdf"
    urdf.write_text(f'{text[: level.end()]} rpy="{rpy[0]} {rpy[1]} {rpy[2]}"{text[level.end() :]}', encoding="utf-8")
    rotation = rotation_from_rpy(*rpy)
    turned = _exported(tmp_path / "policy", robot=str(urdf))
    assert np.allclose(turned.car.lidar_rotation_base, rotation)
    with pytest.raises(PolicyError, match="lidar_rotation_base"):
        Driver.load(tmp_path / "policy", car=driver.car)
    run.node._driver, run.node._rotation = turned, np.array(turned.car.lidar_rotation_base)

    def seen(kind: str, message: Any) -> NDArray:
        run.node._settings = replace(run.settings, input=kind)
        assert not run.node._decide(message, 0.0, None).refusal
        return turned.last_scan.ranges_m

    message = cloud((points @ rotation).astype(np.float32), stamp_s=BEGIN_S)
    assert np.abs(seen("cloud", message) - expected).max() < 0.05
    scan = scan_message(FlatScan(expected, 6.0), rotation, time_of(BEGIN_S), "lidar", 0.2)
    # Its first ray looks straight back: there the lidar's own frame has it at that bearing.
    ahead = rotation.T @ np.array([-1.0, 0.0, 0.0])
    assert math.cos(scan.angle_min - math.atan2(ahead[1], ahead[0])) == pytest.approx(1.0, abs=1e-6)
    assert np.abs(seen("scan", scan) - expected).max() < 0.05
