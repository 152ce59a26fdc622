"""A sweep on a Ray cluster: each run a task, restarted from its checkpoint on another node when its own is lost."""

import fcntl
import logging
import os
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown
from zebrat_bullet.training.run_folder import is_finished
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep_run import LOCK, Outcome, cores_of, lock, perform, record_failure

TICK_S = 1.0
MOST_PORT = 65535


@contextmanager
def connected(address: str) -> Iterator[None]:
    """Connect this process to a cluster, for as long as the block takes.

    Args:
        address: of the cluster, as `ray.init` takes it.

    Raises:
        ConfigError: ray is not installed, or there is no such cluster.
    """
    try:
        import ray
    except ImportError as error:
        raise ConfigError("--ray needs the extra `cluster`: pip install 'zebrat-bullet[cluster]'") from error
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    try:
        _require_reachable(address)
        ray.init(address, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(
            f"no Ray cluster to use at {address!r}: {error}; give HOST:PORT of its head node, or ray://HOST:PORT"
        ) from error
    try:
        yield
    finally:
        ray.shutdown()


def run_on_ray(runs: Mapping[Path, TrainConfig], retries: int, on_tick: Callable[[], None] = lambda: None) -> None:
    """Take every run to its end on the cluster that is `connected`; all nodes have the sweep's folder at one path.

    Args:
        runs: the settings of each run by its folder; all folders in one.
        retries: how often a run whose process or node is lost is taken up again.
        on_tick: called about once a second.

    Raises:
        ConfigError: a node does not share the sweep's folder.
    """
    import ray

    folder = next(iter(runs)).parent.resolve()
    pending: dict[Any, Path] = {}
    task = ray.remote(_perform_on_node)

    def submit(run: Path) -> None:
        settings = task.options(num_cpus=cores_of(runs[run]), max_retries=retries, name=run.name)
        pending[settings.remote(runs[run], folder / run.name)] = run

    with (folder / LOCK).open("a+") as held:
        lock(held.fileno(), fcntl.LOCK_SH)
        for run in runs:
            if not is_finished(run):
                submit(run)
        while pending:
            ready, _ = ray.wait(list(pending), num_returns=len(pending), timeout=TICK_S)
            for ref in ready:
                run = pending.pop(ref)
                try:
                    if ray.get(ref) == Outcome.BUSY:
                        submit(run)
                except ray.exceptions.RayTaskError as error:
                    raise error.cause from None
                except ray.exceptions.RayError as error:
                    record_failure(run, f"its process or node was lost {retries + 1} times: {error}")
            on_tick()


def _require_reachable(address: str) -> None:
    """Try what `ray.init` would otherwise try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdecimal():
        if not 1 <= int(port[:9]) <= MOST_PORT:
            raise ValueError(f"port {shown(port)} is impossible, there are 1 to {MOST_PORT}")
        socket.create_connection((host, int(port)), timeout=10.0).close()


def _perform_on_node(config: TrainConfig, run: Path) -> Outcome:
    _require_shared(run.parent)
    return perform(config, run)


def _require_shared(folder: Path) -> None:
    """Refuse a node whose storage would let two processes write to one run: it must see the sweep's folder and lock.

    Some clusters mount their shared storage with locks that hold within one machine only.
    """
    node = socket.gethostname()
    if not (folder / LOCK).is_file():
        raise ConfigError(f"node {node} does not see {folder}; name a folder on storage that every node mounts there")
    with (folder / LOCK).open("a+") as file:
        if lock(file.fileno(), fcntl.LOCK_EX):
            raise ConfigError(
                f"on node {node} the lock on {folder}, held by the sweep, is not seen, so two nodes could write to one "
                "run; mount the storage with shared locks (NFSv4, Lustre with -o flock) or name another folder"
            )
