"""Processes to spread independent jobs over: one a core, one thread each."""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

from threadpoolctl import threadpool_limits

from zebrat_bullet.notes import say_notes_in_a_line
from zebrat_bullet.processes import MOST_WORKERS, end_with_parent, telling_why_broken, usable_cores
from zebrat_bullet.values import whole_number


@contextmanager
def worker_pool(workers: int | None, n_jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of so many processes, one a core if None, and never more than there are jobs.

    A single one too is a process of its own: it takes its thread limits and a crash of the physics away with it. Each
    imports the caller's main module again, so a script needs its `if __name__ == "__main__":`.
    After an error or Ctrl-C the jobs that have not begun are dropped.

    Raises:
        ConfigError: not a whole number of processes, at least one.
        ZebratError: one was killed from outside, or could not begin.
    """
    if workers is not None:
        whole_number(workers, "workers", 1, MOST_WORKERS)
    n = min(workers or usable_cores(), max(n_jobs, 1))
    with telling_why_broken(), ProcessPoolExecutor(n, get_context("spawn"), _begin) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _begin() -> None:
    end_with_parent()
    say_notes_in_a_line()
    threadpool_limits(1)  # a process a core already: threads within would only fight for them
