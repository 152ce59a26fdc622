"""Processes for independent jobs: as many as there are cores to use, and one that is killed is told."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.evaluation.workers import worker_pool
from zebrat_bullet.processes import MOST_WORKERS, in_order, usable_cores


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


def where(at: int) -> int:
    """Return the process that this runs in."""
    return os.getpid()


def test_things_that_go_to_one_process_at_a_time_stay_here():
    assert set(in_order(where, range(8), 2, batch=8)) == {os.getpid()}
    assert os.getpid() not in set(in_order(where, range(2), 2))
    assert list(in_order(where, [], 2)) == []


@pytest.mark.parametrize(
    "work",
    [
        "from zebrat_bullet.processes import in_order; list(in_order(abs, range(2), 2))",
        "from zebrat_bullet.evaluation.workers import worker_pool\n"
        "with worker_pool(1, 1) as pool: pool.submit(abs, 1).result()",
    ],
    ids=["in order", "pool"],
)
def test_a_script_without_its_guard_is_told_what_it_lacks(work: str, tmp_path: Path):
    script = tmp_path / "mine.py"
    script.write_text(work, encoding="utf-8")
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    last = ran.stderr.strip().splitlines()[-1]
    assert last.startswith("zebrat_bullet.errors.ZebratError: a worker process was killed")
    assert 'must stand under `if __name__ == "__main__":`' in last
