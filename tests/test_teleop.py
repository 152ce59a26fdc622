"""A person drives: real Chromium, real key presses, the real simulation at its own pace."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from zebrat_bullet.config import PhysicsConfig, TaskConfig
from zebrat_bullet.config_text import from_json
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.evaluation.records import load_record
from zebrat_bullet.evaluation.rollout import replay_episode
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.teleop.hub import DEAD_MAN_S, Hub
from zebrat_bullet.teleop.person import key_command
from zebrat_bullet.teleop.server import TeleopServer
from zebrat_bullet.types import Command
from zebrat_bullet.world import load_world

ZEBRAT = Path(sys.executable).parent / "zebrat"
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--window-size=1000,700"),
)
needs_chromium = pytest.mark.skipif(
    not (shutil.which("chromium") and shutil.which("chromedriver")),
    reason="needs Chromium: apt-get install chromium chromium-driver",
)


def eventually(condition: Callable[[], bool], seconds: float = 15.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


class Teleop:
    """A running `zebrat teleop`, and where its page and its records are."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder
        command = [
            ZEBRAT,
            "teleop",
            "--world",
            "track_2",
            "--caster",
            "embree",
            "--port",
            "0",
            "--out",
            folder,
            "--json",
        ]
        self.process = subprocess.Popen(
            [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for line in self.process.stderr:
            if found := re.search(r"drive at (\S+)", line):
                self.url = found.group(1)
                return
        raise AssertionError("zebrat teleop did not start")

    def end(self) -> dict:
        """Press Ctrl-C and return the JSON that it prints."""
        self.process.send_signal(signal.SIGINT)
        output, self.errors = self.process.communicate(timeout=90)
        assert self.process.returncode == 0, self.errors
        return json.loads(output)

    def records(self) -> list[Path]:
        return sorted(self.folder.rglob("*.npz"))


class Page:
    """One browser tab with the teleoperation page."""

    def __init__(self, browser: webdriver.Chrome, url: str, window: str = "") -> None:
        self.browser = browser
        if window:
            browser.switch_to.new_window(window)
        self.handle = browser.current_window_handle
        browser.get(url)
        eventually(lambda: self.status() != "connecting")

    def front(self) -> webdriver.Chrome:
        if self.browser.current_window_handle != self.handle:
            self.browser.switch_to.window(self.handle)
        return self.browser

    def text(self, name: str) -> str:
        return self.front().find_element(By.ID, name).text

    def status(self) -> str:
        return self.text("status")

    def number(self, name: str) -> float:
        return float(re.match(r"-?[\d.]+", self.text(name)).group())

    def hold(self, *keys: str) -> None:
        chain = ActionChains(self.front())
        for key in keys:
            chain.key_down(key)
        chain.perform()

    def press(self, key: str) -> None:
        ActionChains(self.front()).send_keys(key).perform()

    def release(self, *keys: str) -> None:
        chain = ActionChains(self.front())
        for key in keys:
            chain.key_up(key)
        chain.perform()


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(flag)
    browser = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    yield browser
    browser.quit()


@pytest.fixture
def browser(chromium: webdriver.Chrome) -> Iterator[webdriver.Chrome]:
    """Yield the browser and leave it with one empty tab and no key down."""
    yield chromium
    for handle in chromium.window_handles[1:]:
        chromium.switch_to.window(handle)
        chromium.close()
    chromium.switch_to.window(chromium.window_handles[0])
    ActionChains(chromium).w3c_actions.clear_actions()
    chromium.get("about:blank")


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Teleop]:
    """A sitting that several tests drive in, one after the other; it ends by Ctrl-C."""
    running = Teleop(tmp_path_factory.mktemp("shared") / "person")
    yield running
    outcomes = running.end()["outcomes"]
    assert len(outcomes) == len(running.records())


@needs_chromium
def test_a_person_drives_by_keys_and_the_record_holds_what_they_pressed(browser, tmp_path):
    running = Teleop(tmp_path / "person", "--episodes", "1")
    page = Page(browser, running.url)
    assert page.status() == "Ready: the first key starts the clock" and page.number("time") == 0.0
    page.hold(Keys.ARROW_UP)
    eventually(lambda: page.number("time") > 1.0)
    assert page.status() == "Driving" and page.number("speed") == pytest.approx(0.6, abs=0.05)
    page.hold("a")
    eventually(lambda: page.number("steering") > 20)
    browser.save_screenshot(str(tmp_path / "driving.png"))
    eventually(lambda: page.status().startswith("Collision: episode 1 saved"))
    output, _ = running.process.communicate(timeout=90)
    assert json.loads(output) == {"folder": str(running.folder), "outcomes": ["collision"]}

    (path,) = running.records()
    record = load_record(path)
    assert record.agent == "person" and set(record.privileged) == {"map", "pose"}
    assert record.command[:3, 0] == pytest.approx([0.3, 0.6, 0.6])  # full speed in two control steps
    turning = record.command[np.flatnonzero(record.command[:, 1])[0] :, 1]
    assert turning[:4] == pytest.approx([0.2, 0.4, 0.6, 0.6])  # full lock, to the left, in three
    assert np.hypot(*(record.pose[-1] - record.pose[0])[:2]) > 0.5
    world = load_world(record.world)
    drive = Drive(from_json(TaskConfig, record.task), world)
    replay_episode(drive, record, world)  # raises where a pose differs
    drive.close()

    picture = np.asarray(Image.open(tmp_path / "driving.png").convert("RGB")).reshape(-1, 3)
    for colour in ("#596273", "#e8eaed", "#7cc4ff"):  # walls, car, scan
        rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        assert (picture == rgb).all(axis=1).sum() > 200, colour


def begin(browser: webdriver.Chrome, running: Teleop) -> Page:
    """Open the page at the start of an episode, wherever the last test left the car."""
    page = Page(browser, running.url)
    eventually(lambda: not page.status().startswith("Another"))  # until the last test's tab is found gone
    page.press("r")
    eventually(lambda: page.status().startswith("Ready"))
    return page


@needs_chromium
def test_r_gives_an_attempt_up_and_nothing_of_it_is_kept(browser, shared):
    before = shared.records()
    page = begin(browser, shared)
    page.hold("w")
    eventually(lambda: page.number("time") > 0.5)
    page.release("w")
    page.press("r")
    eventually(lambda: page.status().startswith("Ready") and page.number("time") == 0.0)
    assert shared.records() == before


@needs_chromium
def test_space_stops_the_car_though_a_drive_key_is_held(browser, shared):
    page = begin(browser, shared)
    page.hold("w")
    eventually(lambda: page.number("speed") > 0.5)
    page.hold(Keys.SPACE)
    eventually(lambda: abs(page.number("speed")) < 0.02)
    page.release(Keys.SPACE, "w")


@needs_chromium
def test_a_key_held_while_another_tab_is_looked_at_moves_nothing(browser, shared):
    page = begin(browser, shared)
    page.hold("w")
    eventually(lambda: page.number("speed") > 0.5)
    browser.switch_to.new_window("tab")
    time.sleep(2 * DEAD_MAN_S)
    assert page.number("speed") == pytest.approx(0.0, abs=0.02)
    assert page.status() == "Driving"


@needs_chromium
def test_of_two_tabs_the_first_drives_and_the_second_watches_until_it_leaves(browser, shared):
    first = begin(browser, shared)
    second = Page(browser, shared.url, "tab")
    eventually(lambda: second.status() == "Another tab drives; you watch")
    second.hold("w")
    time.sleep(0.6)
    assert first.number("time") == 0.0
    second.release("w")
    first.front().get("about:blank")
    eventually(lambda: second.status().startswith("Ready"))
    second.hold("w")
    eventually(lambda: second.number("time") > 0.3)


@needs_chromium
def test_the_clock_stands_while_nobody_drives_and_the_next_tab_goes_on(browser, shared):
    first = begin(browser, shared)
    first.hold("w")
    eventually(lambda: first.number("time") > 0.7)
    first.release("w")
    left_at = first.number("time")
    browser.get("about:blank")
    time.sleep(2.0)
    again = Page(browser, shared.url)
    assert again.number("time") < left_at + 1.5 and again.status() == "Driving"
    eventually(lambda: again.number("time") > left_at + 1.5)


@needs_chromium
def test_a_tab_that_outlives_its_server_shows_the_world_of_the_next(browser, tmp_path):
    running = Teleop(tmp_path / "first")
    page = Page(browser, running.url)
    eventually(lambda: page.text("world") == "track_2" and page.status().startswith("Ready"))
    running.end()
    eventually(lambda: page.status().startswith("Connection lost"))
    port = running.url.strip("/").rpartition(":")[2]
    running = Teleop(tmp_path / "second", "--world", "track_1", "--port", port)
    eventually(lambda: page.text("world") == "track_1" and page.status().startswith("Ready"))
    page.hold("w")
    eventually(lambda: page.number("time") > 0.3)
    page.release("w")
    running.end()


class Tab:
    """A tab without a browser: it does what the page's script does, or less."""

    def __init__(self, running: Teleop) -> None:
        self.address = running.url.removeprefix("http://").strip("/")
        self.stream = HTTPConnection(self.address, timeout=5)
        self.stream.request("GET", "/views")
        self.views = self.stream.getresponse()
        self.seat = self.event()["seat"]

    def event(self) -> dict:
        while not (line := self.views.readline()).startswith(b"data: "):
            pass
        return json.loads(line[6:])

    def post(self, body: object) -> int:
        connection = HTTPConnection(self.address, timeout=5)
        connection.request("POST", "/keys", body if isinstance(body, str) else json.dumps(body))
        status = connection.getresponse().status
        connection.close()
        return status

    def press(self, *keys: str, restart: bool = False) -> int:
        return self.post({"seat": self.seat, "keys": keys, "restart": restart})

    def close(self) -> None:
        self.stream.close()
        self.views.close()


@pytest.fixture
def tab(shared: Teleop) -> Iterator[Tab]:
    tab = Tab(shared)
    eventually(lambda: tab.event()["drives"])
    yield tab
    tab.close()


def test_the_car_stops_half_a_second_after_the_last_that_was_heard_of_the_keys(tab):
    tab.press(restart=True)
    eventually(lambda: tab.event()["view"]["phase"] == "ready")
    assert tab.press("forward") == 200
    speeds = {}
    while max(speeds, default=0.0) < 1.2:
        view = tab.event()["view"]
        speeds[view["time_s"]] = view["speed_mps"]
    assert max(speeds.values()) > 0.2  # one key state counts for two control steps, one on a busy machine
    assert speeds[max(speeds)] == pytest.approx(0.0, abs=0.02)


def test_only_the_drivers_seat_is_obeyed_and_nonsense_is_refused(tab, shared):
    watcher = Tab(shared)
    assert not watcher.event()["drives"] and watcher.press("forward") == 409
    watcher.close()
    assert tab.post({"seat": "guessed", "keys": ["forward"], "restart": False}) == 409
    for nonsense in ("", "[]", '{"seat": 1}', "x" * 2000, '{"seat": "a", "keys": 3, "restart": 0}'):
        assert tab.post(nonsense) == 400
    assert tab.press("forward", "warp") == 200


@pytest.mark.parametrize(
    ("port", "message"), [(None, "another program listens there.*another --port, 0"), (70000, "0 to 65535")]
)
def test_a_port_that_cannot_be_had_says_what_to_do(port, message):
    first = TeleopServer("127.0.0.1", 0, Hub(), "{}")
    with pytest.raises(ConfigError, match=message):
        TeleopServer("127.0.0.1", first.server_address[1] if port is None else port, Hub(), "{}")
    first.close()


@pytest.mark.parametrize("host", ["nosuch.invalid", "8.8.8.8", "2001:db8::1"])
def test_an_address_that_is_not_this_machines_says_to_name_another_host(host):
    with pytest.raises(ConfigError, match=r"cannot listen on .* name another --host: 127\.0\.0\.1") as refused:
        TeleopServer(host, 0, Hub(), "{}")
    assert "--port" not in str(refused.value)


def test_held_keys_ramp_and_released_keys_return():
    limits = PhysicsConfig()
    command = Command(0.0, 0.0)
    seen = []
    for keys in ({"forward", "left"}, {"forward"}, {"reverse"}, {"reverse"}, {"reverse", "stop"}, {"left", "right"}):
        command = key_command(command, keys, limits)
        seen.append((command.speed_mps, command.steering_rad))
    expected = [(0.3, 0.2), (0.6, 0.0), (0.3, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)]
    assert np.array(seen) == pytest.approx(np.array(expected))


def test_the_seat_passes_on_with_all_keys_up():
    hub = Hub()
    first, second = hub.join(), hub.join()
    assert hub.press(first, ["forward"], restart=False) and hub.keys() == {"forward"}
    assert not hub.press(second, ["reverse"], restart=False)
    hub.leave(first)
    assert hub.drives(second) and hub.keys() == {"stop"}
