"""A sweep on a real Ray cluster of two nodes on this machine, one of which is killed in the middle of its run."""

import fcntl
import shutil
import tempfile
import threading
import time

import psutil
import pytest
from test_sweep import TINY, episodes, holder

from zebrat_bullet.cli.main import main
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.training.run_folder import has_checkpoint, is_finished
from zebrat_bullet.training.sweep import Sweep, open_sweep
from zebrat_bullet.training.sweep_ray import _require_shared, connected, run_on_ray
from zebrat_bullet.training.sweep_run import lock

NODE = {"num_cpus": 1, "object_store_memory": 80 * 1024**2, "include_dashboard": False}
NOTICE_A_LOSS_SOON = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500}


@pytest.fixture
def cluster(monkeypatch):
    from ray.cluster_utils import Cluster

    home = tempfile.mkdtemp(
        prefix="ray-"
    )  # a socket's path takes at most 107 characters: pytest's folders are too deep
    monkeypatch.setenv("RAY_TMPDIR", home)
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    made = Cluster(True, head_node_args=NODE | {"_system_config": NOTICE_A_LOSS_SOON})
    yield made
    made.shutdown()
    shutil.rmtree(home, ignore_errors=True)


@pytest.mark.timeout(900)  # trains on two nodes: over 300 s beside other work
def test_a_sweep_outlives_a_node_and_runs_nothing_twice(cluster, tmp_path):
    raylet = psutil.Process(cluster.add_node(**NODE).all_processes["raylet"][0].process.pid)
    runs = open_sweep(Sweep(worlds=("track_2",), seeds=(0, 1, 2, 3), set=TINY), tmp_path / "sweep")
    killed = {}

    def kill_the_node_in_the_middle_of_a_run():
        while not killed:
            time.sleep(0.02)
            finished = {run: (run / "summary.json").stat().st_mtime for run in runs if is_finished(run)}
            on_node = {child.pid for child in raylet.children(recursive=True)}
            for run in runs:
                if finished and holder(run) in on_node and has_checkpoint(run) and not is_finished(run):
                    raylet.kill()
                    killed.update(run=run, at=time.time(), finished=finished)

    threading.Thread(target=kill_the_node_in_the_middle_of_a_run, daemon=True).start()
    with connected(cluster.address):
        run_on_ray(runs, retries=2)
    assert all(is_finished(run) and not (run / "error.txt").exists() for run in runs)
    assert all(episodes(run) == list(range(1, 21)) for run in runs)
    assert all((run / "summary.json").stat().st_mtime == before for run, before in killed["finished"].items())
    begun, ended = ((killed["run"] / name).stat().st_mtime for name in ("versions.json", "summary.json"))
    assert begun < killed["at"] < ended  # it went on from its checkpoint: a new beginning writes versions.json


def test_storage_that_a_node_does_not_share_or_whose_locks_it_does_not_see_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="does not see"):
        _require_shared(tmp_path)
    with (tmp_path / "lock").open("a") as held:
        with pytest.raises(ConfigError, match="mount the storage with shared locks"):
            _require_shared(tmp_path)
        assert lock(held.fileno(), fcntl.LOCK_SH)
        _require_shared(tmp_path)


def test_a_cluster_that_is_not_there_is_said_so_at_once():
    began = time.monotonic()
    with pytest.raises(ConfigError, match=r"no Ray cluster to use at '127\.0\.0\.1:1'"):
        connected("127.0.0.1:1").__enter__()
    assert time.monotonic() - began < 20


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("nonsense", "no Ray cluster to use at 'nonsense': Invalid address format"),
        ("127.0.0.1:99999", "port 99999 is impossible, there are 1 to 65535"),
        ("ray://127.0.0.1:1", "no Ray cluster to use at 'ray://127.0.0.1:1'"),
    ],
)
def test_a_sweep_without_its_cluster_writes_and_draws_nothing(address, said, tmp_path, capfd):
    assert main(["sweep", "--ray", address, "--out", str(tmp_path / "sweep")]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert said in line and "give HOST:PORT of its head node" in line
    assert not list(tmp_path.iterdir())
