"""The search for a way out tells a way, a proof that there is none, and giving up apart; and ends when it must."""

import multiprocessing
import time
from collections.abc import Callable

import pytest

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.play.check import drawn
from zebrat_bullet.play.search import Finding, Search


def eventually(condition: Callable[[], bool], what: str, seconds: float = 90.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.05)


RIGHT_ANGLE = {"points": [(0, 0), (3, 0), (3, 3)], "radii": [0]}


class Searched:
    """A search, and what it has reported."""

    def __init__(self, limit_s: float) -> None:
        self.findings: dict[int, Finding] = {}
        self.search = Search("zebrat", PhysicsConfig(), limit_s, self.findings.__setitem__)

    def until(self, number: int) -> Finding:
        eventually(lambda: getattr(self.findings.get(number), "state", "searching") != "searching", "it is known")
        return self.findings[number]


def test_a_way_a_proof_and_giving_up_are_told_apart_and_a_search_ends_when_it_must(robot, tmp_path):
    wide, hard, closed = (
        drawn(RIGHT_ANGLE | {"widths": [width, width]}, robot, tmp_path).world for width in (1.4, 0.83, 0.7)
    )
    searched = Searched(limit_s=60.0)
    searched.search.ask(1, wide)
    found = searched.until(1)
    assert found.state == "drivable" and found.n_reversals == 0 and found.path[0] == pytest.approx((0.73, 0), abs=0.01)
    searched.search.ask(2, closed)
    assert searched.until(2).state == "no_way"
    searched.search.ask(3, hard)
    assert searched.until(3).state == "gave_up" and "none is proven" in searched.until(3).text
    searched.search.ask(4, hard)
    eventually(lambda: 4 in searched.findings, "it searches")
    searched.search.cancel()
    assert searched.until(4).state == "cancelled"
    searched.search.ask(5, wide)
    assert searched.until(5).state == "drivable"
    searched.search.close()

    hasty = Searched(limit_s=0.1)
    hasty.search.ask(1, hard)
    assert hasty.until(1) == Finding(
        state="gave_up", text="Gave up after 0.1 s: no way found, but none is proven not to exist"
    )
    hasty.search.close()
    assert not multiprocessing.active_children()
