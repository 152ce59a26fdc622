"""Processes to spread independent jobs over: one a core, one thread each."""

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from threadpoolctl import threadpool_limits


def worker_pool(workers: int | None, n_jobs: int) -> ProcessPoolExecutor:
    """Return a pool of so many processes, one a core if None, and never more than there are jobs."""
    return ProcessPoolExecutor(min(workers or os.cpu_count() or 1, max(n_jobs, 1)), get_context("spawn"), _one_thread)


def _one_thread() -> None:
    threadpool_limits(1)  # a process a core already: threads within would only fight for them
