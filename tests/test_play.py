"""A passage is drawn in a real Chromium, by mouse and by finger; it is checked, searched, driven, and shared."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise

import pytest
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select

FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--window-size=1200,800"),
)
PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
pytestmark = pytest.mark.skipif(
    not (shutil.which("chromium") and shutil.which("chromedriver")),
    reason="needs Chromium: apt-get install chromium chromium-driver",
)
COMMAND = [sys.executable, "-c", "import sys; from zebrat_bullet.cli import main; sys.exit(main())"]
L_SHAPE = [(0.25, 0.75), (0.5, 0.75), (0.7, 0.75), (0.7, 0.5), (0.7, 0.25)]
"""Of the canvas."""


def eventually(condition: Callable[[], bool], what: str, seconds: float = 90.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.1)


@contextmanager
def playing(port: str = "0") -> Iterator[str]:
    """Run `zebrat play`, and yield the address of its page."""
    process = subprocess.Popen([*COMMAND, "play", "--port", port], stderr=subprocess.PIPE, text=True)
    try:
        yield next(found.group(1) for line in process.stderr if (found := re.search(r"draw at (\S+)", line)))
    finally:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 0 and "Traceback" not in errors


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    """Where a `zebrat play` runs that several tests draw on, one after the other."""
    with playing() as address:
        yield address


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    downloads = tmp_path_factory.mktemp("downloads")
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"):
        options.add_argument(flag)
    options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    browser.downloads = downloads
    yield browser
    browser.quit()


class Page:
    """The page, empty; after the test nothing may have gone wrong in its scripts."""

    def __init__(self, browser: webdriver.Chrome, url: str, fragment: str = "") -> None:
        self.browser = browser
        browser.get("about:blank")
        browser.get(url + fragment)
        if not fragment:
            eventually(lambda: self.check() not in ("Connecting…", "Another tab draws; you watch."), "the tab may draw")
            self.click("clear")
            eventually(lambda: self.check() == "Nothing is drawn yet.", "the page is empty")

    def element(self, name: str):
        return self.browser.find_element(By.ID, name)

    def text(self, name: str) -> str:
        return self.element(name).text

    def check(self) -> str:
        return self.text("check")

    def click(self, name: str) -> None:
        self.element(name).click()

    def slide(self, name: str, value: float) -> None:
        script = "arguments[0].value = arguments[1]; arguments[0].oninput(); arguments[0].onchange();"
        self.browser.execute_script(script, self.element(name), value)

    def choose(self, name: str, value: str) -> None:
        Select(self.element(name)).select_by_value(value)

    def draw(self, points: list[tuple[float, float]]) -> None:
        """Drag the mouse over the canvas."""
        canvas = self.element("view")
        size, chain = canvas.size, ActionChains(self.browser, duration=100)
        for i, (x, y) in enumerate(points):
            chain.move_to_element_with_offset(canvas, int((x - 0.5) * size["width"]), int((y - 0.5) * size["height"]))
            if i == 0:
                chain.click_and_hold()
        chain.release().perform()

    def touch(self, points: list[tuple[float, float]]) -> None:
        """Drag a finger over the canvas."""
        box = self.element("view").rect
        places = [(box["x"] + x * box["width"], box["y"] + y * box["height"]) for x, y in points]
        self._touch("touchStart", places[:1])
        for (ax, ay), (bx, by) in pairwise(places):
            for part in (0.25, 0.5, 0.75, 1.0):
                self._touch("touchMove", [(ax + part * (bx - ax), ay + part * (by - ay))])
        self._touch("touchEnd", [])

    def _touch(self, kind: str, places: list[tuple[float, float]]) -> None:
        points = [{"x": x, "y": y} for x, y in places]
        self.browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def drive(self) -> list[str]:
        """Press Drive, wait until every car is through, and return how each fared."""
        eventually(lambda: self.element("drive").is_enabled(), "the track may be driven")
        self.click("drive")
        rows = lambda: [row.text for row in self.element("lanes").find_elements(By.TAG_NAME, "li")]  # noqa: E731
        eventually(lambda: bool(rows()) and all(" after " in row for row in rows()), "the cars are through")
        return rows()

    def errors(self) -> list[str]:
        return [entry["message"] for entry in self.browser.get_log("browser") if entry["level"] == "SEVERE"]


@pytest.fixture
def page(chromium: webdriver.Chrome, url: str) -> Iterator[Page]:
    page = Page(chromium, url)
    yield page
    assert page.errors() == []


def test_a_drawn_right_angle_is_certified_and_driven_out_of_and_its_file_judged_anywhere(page, tmp_path):
    page.draw(L_SHAPE)
    eventually(lambda: page.check().startswith("✔"), "the passage is found good")
    eventually(lambda: "Can be driven" in page.text("finding"), "a way out is found")
    page.choose("pace", "4")
    (row,) = page.drive()
    assert "shipped" in row and "out in the open" in row

    page.click("download")
    path = page.browser.downloads / "my_track.yaml"
    eventually(path.exists, "the world file is downloaded")
    judging = ["evaluate", "--agent", "shipped", "--worlds", path, "--episodes", "1", "--caster", "embree"]
    quietly = ["--quiet", "--json", "--workers", "1", "--out", tmp_path / "judged"]
    judged = subprocess.run([*COMMAND, *judging, *quietly], capture_output=True, text=True)
    assert judged.returncode == 0, judged.stderr
    (score,) = json.loads(judged.stdout).values()
    assert score["success"] == 1.0, score


def test_what_cannot_be_driven_says_why_and_no_way_is_proven(page):
    page.slide("width", 0.5)
    page.draw(L_SHAPE)
    eventually(lambda: "Too narrow here: the passage is 0.50 m wide and the car 0.60 m" in page.check(), "it says so")
    assert not page.element("drive").is_enabled()
    page.slide("width", 0.7)  # wide enough for the car, but not round the corner
    page.slide("radius", 0)
    eventually(lambda: page.text("finding").startswith("✖ Proven: no drive leads out"), "there is shown to be no way")
    page.click("undo")
    page.click("undo")
    eventually(lambda: page.check().startswith("Too narrow here"), "the last drawings are back")
    page.slide("width", 1.4)
    page.draw([(0.2, 0.5), (0.7, 0.5), (0.7, 0.2), (0.45, 0.2), (0.45, 0.9)])
    eventually(lambda: page.check() == "The passage runs into itself here: lead it around", "it says so")


def test_on_a_phone_a_finger_draws_two_cars_race_and_the_link_carries_the_track(page, url):
    page.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", PHONE)
    page.browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    try:
        page = Page(page.browser, url)
        assert page.browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        page.touch([(0.2, 0.8), (0.5, 0.8), (0.75, 0.8), (0.75, 0.3)])
        eventually(lambda: "Can be driven" in page.text("finding"), "a way out is found")
        page.choose("pace", "4")
        page.choose("beside", "fomt")
        first, second = page.drive()
        assert "shipped" in first and "out in the open" in first and "fomt" in second

        address = page.browser.current_url
        again = Page(page.browser, address.partition("#")[0], "#" + address.partition("#")[2])
        eventually(lambda: again.check().startswith("✔"), "the track of the link is there")
        assert again.browser.current_url == address
    finally:
        page.browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        page.browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})


def test_a_tab_that_outlives_its_server_draws_again_on_the_next_and_shows_what_that_knows(chromium):
    with playing() as url:
        page = Page(chromium, url)
        page.choose("examples", "drawing:Right angle")
        eventually(lambda: page.check().startswith("✔"), "the passage is found good")
    with playing(url.strip("/").rpartition(":")[2]):
        known = lambda: page.browser.execute_script("return fetch('/track').then((answer) => answer.json())")  # noqa: E731
        eventually(lambda: known()["world"] is not None, "the drawing is sent again")
        page.choose("examples", "drawing:No way out")
        eventually(lambda: known()["drawing"]["widths"] == [0.7, 0.7], "another drawing is sent")
        eventually(lambda: page.browser.execute_script("return track.drawing.widths[0]") == 0.7, "the page shows that")
    page.errors()  # of the time between; the next test reads its own
