"""What the driving node makes of stamps: its methods called with real messages, at times that the test sets."""

from contextlib import closing
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'zebrat-bullet[ros]'")

from nav_msgs.msg import Odometry
from ros_probe import Domain, cloud, corridor

from zebrat_bullet.agents.export import export_policy
from zebrat_bullet.deploy.driver import Driver, Limits
from zebrat_bullet.deploy.supervisor import Supervisor
from zebrat_bullet.ros import drive_node
from zebrat_bullet.ros.parameters import DriveSettings, make_node, read_parameters
from zebrat_bullet.ros.runtime import ros

WATCHDOG_S = 0.4
TICK_S = WATCHDOG_S / 10.0
BEGIN_S = 1000.0
CORRIDOR = corridor()


@pytest.fixture(scope="module")
def driver(tmp_path_factory) -> Driver:
    folder = tmp_path_factory.mktemp("shipped")
    export_policy("shipped", folder)
    return Driver.load(folder, limits=Limits(stale_s=WATCHDOG_S))


class Run:
    """A node whose time is the test's, and what it has sent: when, and the speed."""

    def __init__(self, driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
        node = make_node("zebrat_drive")
        self.settings, self.now_s = read_parameters(node, DriveSettings), BEGIN_S
        self.sent: list[tuple[float, float]] = []
        self.refusals: list[str] = []
        self.ages: list[float] = []
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

        def checked(command, scan, speed, steering, age_s=0.0):
            self.ages.append(age_s)
            return check(command, scan, speed, steering, age_s)

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
