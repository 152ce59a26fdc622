"""The server behind both pages answers its own pages only; what was begun for a tab ends with it."""

import gc
import json
import math
import multiprocessing
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import urlopen

import pybullet
import pytest

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.play.server import PlayServer
from zebrat_bullet.play.stage import Stage
from zebrat_bullet.teleop.hub import MOST_SEATS, Hub
from zebrat_bullet.teleop.local_server import LocalServer
from zebrat_bullet.teleop.server import TeleopServer

TASK = replace(TaskConfig(), lidar=replace(TaskConfig().lidar, caster="embree"))
RIGHT_ANGLE = {"points": [(0, 0), (3, 0), (3, 3)], "widths": [1.4, 1.4], "radii": [0]}


def eventually(condition: Callable[[], bool], what: str, seconds: float = 90.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.05)


def right_angle(width_m: float) -> dict[str, Any]:
    return RIGHT_ANGLE | {"widths": [width_m, width_m]}


OTHERS: set[int] = set()
"""Clients of PyBullet that other tests of this process have left open."""


def clients() -> set[int]:
    return {i for i in range(50) if pybullet.isConnected(i)}


@pytest.fixture(scope="module", autouse=True)
def others() -> None:
    """Note them before anything is begun here."""
    gc.collect()
    OTHERS.update(clients())


def has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return False
    return True


def simulations() -> int:
    return len(clients() - OTHERS)


def ask(
    server: LocalServer, path: str, body: object = None, timeout: float = 60.0, **headers: str
) -> tuple[int, str, dict[str, str]]:
    """GET, or POST where there is a body; header names are written with _ for -."""
    host, port = server.server_address[:2]
    connection = HTTPConnection(str(host), port, timeout=timeout)
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    text = body if isinstance(body, str) or body is None else json.dumps(body)
    connection.request("GET" if body is None else "POST", path, text, named)
    answer = connection.getresponse()
    got = answer.status, answer.read().decode(), dict(answer.getheaders())
    connection.close()
    return got


class Tab:
    """A tab without a browser."""

    def __init__(self, server: LocalServer) -> None:
        self.server = server
        host, port = server.server_address[:2]
        self.stream = HTTPConnection(str(host), port, timeout=10)
        self.stream.request("GET", "/views")
        self.views = self.stream.getresponse()
        self.status = self.views.status
        self.seat = self.event()["seat"] if self.status == 200 else ""

    def event(self) -> dict[str, Any]:
        while not (line := self.views.readline()).startswith(b"data: "):
            pass
        return json.loads(line[6:])

    def post(self, path: str, **body: object) -> tuple[int, Any]:
        status, text, _ = ask(self.server, path, {"seat": self.seat} | body)
        return status, json.loads(text) if status == 200 else text

    def close(self) -> None:
        self.stream.close()
        self.views.close()


@pytest.fixture(scope="module")
def stage_server(others: None) -> Iterator[PlayServer]:
    hub = Hub()
    stage = Stage(TASK, hub, ["shipped", "random"], seed=0, limit_s=60.0)
    server = PlayServer("127.0.0.1", 0, hub, stage, {"first": "shipped"})
    yield server
    folder = Path(stage._folder.name)
    server.close()
    stage.close()
    assert not folder.exists() and not multiprocessing.active_children() and simulations() == 0


@pytest.fixture
def tab(stage_server: PlayServer) -> Iterator[Tab]:
    """The only tab of the page, with nothing drawn."""
    tab = Tab(stage_server)
    eventually(lambda: tab.event()["drives"], "the last test's tab is found gone")
    assert tab.post("/clear")[0] == 200
    yield tab
    tab.close()


@pytest.fixture(params=["play", "teleop"])
def server(request: pytest.FixtureRequest) -> Iterator[LocalServer]:
    if request.param == "play":
        yield request.getfixturevalue("stage_server")
        return
    server = TeleopServer("127.0.0.1", 0, Hub(), "{}")
    yield server
    server.close()


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:8765"},
        {"Host": ""},
        {"Host": "[half"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
    ids=lambda headers: "{}={}".format(*next(iter(headers.items()))),
)
def test_a_foreign_page_or_name_is_answered_nothing(server, headers):
    for path, body in (("/views", None), ("/scene.js", None), ("/keys", {"seat": "x", "keys": [], "restart": False})):
        status, text, answered = ask(server, path, body, **headers)
        assert status == 403 and "open the address that zebrat printed" in text
        assert "Access-Control-Allow-Origin" not in answered


def test_a_name_that_is_not_this_machines_is_told_with_those_that_are_taken(server):
    status, text, _ = ask(server, "/", Host="lab-pc.example:8766")
    assert status == 403 and "asked for 'lab-pc.example:8766'; localhost, this machine's number, name and" in text
    assert socket.gethostname() not in text.partition("asked for")[2].split()
    assert "asked for" not in ask(server, "/scene.js", Origin="http://evil.example")[1]


@pytest.mark.parametrize("name", ["lab-pc", "LAB-PC", "lab-pc.local", "127.0.0.1", "[::1]"])
def test_this_machine_goes_by_its_own_name_too(name, server, monkeypatch):
    monkeypatch.setattr(socket, "gethostname", lambda: "Lab-PC")
    own = f"{name}:{server.server_address[1]}"
    assert ask(server, "/scene.js", Host=own, Origin=f"http://{own}", Sec_Fetch_Site="same-origin")[0] == 200
    assert ask(server, "/scene.js", Host=f"lab-pc.evil.example:{server.server_address[1]}")[0] == 403


@pytest.mark.parametrize(("host", "wildcard"), [("127.0.0.1", False), ("0.0.0.0", True), ("::1", False), ("::", True)])
def test_the_address_that_is_told_is_one_that_a_browser_can_open(host, wildcard):
    if ":" in host and not has_ipv6():
        pytest.skip("this machine has no IPv6")
    server = TeleopServer(host, 0, Hub(), "{}")
    told = urlsplit(server.url)
    with urlopen(server.url, timeout=10) as answer:
        assert b"<!DOCTYPE html>" in answer.read()
    server.close()
    assert told.port == server.server_address[1] and (told.hostname != host) == wildcard


def test_where_there_is_no_network_the_machine_is_told_by_its_name(monkeypatch):
    server = TeleopServer("0.0.0.0", 0, Hub(), "{}")
    monkeypatch.setattr(socket.socket, "connect", lambda *_: (_ for _ in ()).throw(OSError("unreachable")))
    assert server.url == f"http://{socket.gethostname()}:{server.server_address[1]}/"
    monkeypatch.undo()
    server.close()


def test_the_page_itself_may_be_followed_to_and_is_in_nobodys_frame(server):
    status, text, headers = ask(server, "/", Sec_Fetch_Site="cross-site")
    assert status == 200 and "<!DOCTYPE html>" in text
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    own = f"127.0.0.1:{server.server_address[1]}"
    assert ask(server, "/scene.js", Host=own, Origin=f"http://{own}")[0] == 200
    assert ask(server, "/scene.js", Host=f"localhost:{server.server_address[1]}")[0] == 200


def test_nonsense_is_refused_and_serves_on(tab, stage_server):
    for path, body in [
        *(("/draw", text) for text in ("", "{", "[]", '"x"', '{"seat": 1', "[" * 5000, '{"a": ' + "9" * 5000 + "}")),
        *(("/draw", body) for body in ({}, {"seat": tab.seat}, {"seat": tab.seat, "drawing": 3})),
        ("/draw", {"seat": tab.seat, "drawing": RIGHT_ANGLE | {"points": [(0, 0), (math.nan, 0), (3, 3)]}}),
        ("/fit", {"seat": tab.seat, "stroke": [[0, 0], [1, 1]], "width": "wide"}),
        ("/drive", {"seat": tab.seat, "agents": 3, "pace": 1}),
        ("/nowhere", {}),
    ]:
        assert ask(stage_server, path, body)[0] == 400, (path, body)
    giant = {"seat": tab.seat, "drawing": {"points": [(i, 0) for i in range(20_000)], "widths": [], "radii": []}}
    assert ask(stage_server, "/draw", giant)[0] == 400
    assert ask(stage_server, "/draw", None, Content_Length="9" * 50)[0] == 404
    assert ask(stage_server, "/../session.py")[0] == 404
    assert tab.post("/draw", drawing=RIGHT_ANGLE)[1]["world"] is not None


@pytest.mark.parametrize("width", [-1, "nan", 1e308])
def test_a_width_that_is_none_is_told_in_one_line(tab, width):
    status, answer = tab.post("/fit", stroke=[[0, 0], [3, 0]], width=width)
    assert status == 200 and answer["problem"]["text"].startswith("this is no drawing: widths.0: Input should be ")
    assert "\n" not in answer["problem"]["text"] and "pydantic" not in answer["problem"]["text"]


def test_only_the_tab_that_has_been_there_longest_draws_and_drives(tab, stage_server):
    other = Tab(stage_server)
    for path in ("/draw", "/open", "/clear", "/fit", "/drive", "/stop", "/cancel"):
        assert other.post(path) == (409, "another tab draws")
    tab.close()
    eventually(lambda: other.event()["drives"], "the seat has passed on")
    assert other.post("/draw", drawing=RIGHT_ANGLE)[0] == 200
    other.close()


def test_more_tabs_than_seats_are_told_so_and_the_driver_is_still_heard(tab, stage_server):
    crowd = [Tab(stage_server) for _ in range(MOST_SEATS)]
    assert [each.status for each in crowd].count(503) == 1
    assert tab.post("/draw", drawing=RIGHT_ANGLE)[0] == 200
    for each in crowd:
        each.close()
    eventually(lambda: len(stage_server.hub._seats) == 1, "their seats are free again")


def test_cars_are_taken_off_when_their_only_tab_vanishes_or_another_track_is_drawn(tab, stage_server):
    tab.post("/draw", drawing=RIGHT_ANGLE)
    assert tab.post("/drive", agents=["shipped", "random"], pace=1.0)[0] == 200
    eventually(lambda: simulations() == 2, "both simulations run")
    eventually(lambda: any(lane["phase"] == "driving" for lane in tab.event()["view"]["lanes"]), "they drive")
    tab.post("/draw", drawing=right_angle(1.5))
    eventually(lambda: simulations() == 0, "both simulations are closed")
    eventually(lambda: tab.event()["view"]["lanes"] == [], "the page is told so")

    tab.post("/drive", agents=["random"], pace=1.0)
    eventually(lambda: simulations() == 1, "the simulation runs")
    tab.close()
    eventually(lambda: simulations() == 0, "it is closed")


@pytest.mark.parametrize(
    ("agents", "pace", "says"),
    [
        ([], 1, "one or two different drivers"),
        (["shipped"] * 2, 1, "one or two different drivers"),
        (["/etc/passwd"], 1, "one or two different drivers"),
        (["shipped"], 1000, "the pace is one of 1, 2, 4"),
        (["shipped"], 1, "draw one first"),
    ],
)
def test_a_race_that_cannot_be_run_says_why(agents, pace, says, tab):
    status, text = tab.post("/drive", agents=agents, pace=pace)
    assert status == 422 and says in text
