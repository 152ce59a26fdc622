"""Processes for independent jobs: as many as there are cores to use, and one that is killed is told."""

import os
import signal
import time

import pytest

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.workers import worker_pool
from zebrat_bullet.processes import MOST_WORKERS, usable_cores


def end(at: int) -> None:
    """Kill this process, as a kernel that runs out of memory does."""
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(at)


def test_by_itself_a_pool_takes_the_cores_that_it_may_use_and_no_more_than_a_pool_can(monkeypatch: pytest.MonkeyPatch):
    for n_cores, n in ((3, 3), (384, MOST_WORKERS)):
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid, n=n_cores: set(range(n)))
        assert usable_cores() == n
        with worker_pool(None, 1000) as pool:
            assert pool._max_workers == n


def test_a_worker_that_is_killed_is_told_as_that_and_not_as_a_bug():
    said = "killed, most often for want of memory; ask for fewer --workers"
    with pytest.raises(ZebratError, match=said), worker_pool(1, 1) as pool:
        list(pool.map(end, [60]))
