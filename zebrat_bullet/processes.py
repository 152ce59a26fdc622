"""The same work on one thing after another, spread over processes and answered in order."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import chain, islice
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TypeVar

from zebrat_bullet.errors import ZebratError
from zebrat_bullet.values import whole_number

MOST_WORKERS = 256
T = TypeVar("T")
R = TypeVar("R")

# So many batches wait for each process.
_WAITING = 3


def usable_cores() -> int:
    """Return how many processes keep busy all cores that this one may use, as many as a pool takes at most."""
    return min(len(os.sched_getaffinity(0)), MOST_WORKERS)


def in_order(work: Callable[[T], R], things: Iterable[T], workers: int, batch: int = 1) -> Iterator[R]:
    """Yield the result of each thing, in their order; a consumer that stops early stops the processes too.

    Args:
        work: what to do; it and the things travel to other processes.
        things: taken as they are needed; there may be no end of them.
        workers: 1 works here, as do any for a single batch; more work in so many processes, which import the caller's
            main module again, so a script needs its `if __name__ == "__main__":`.
        batch: so many things go to a process at a time.

    Raises:
        ConfigError: fewer than one worker.
        ZebratError: when it is a thing's turn, and the process that it went to was killed or could not begin.
    """
    whole_number(workers, "workers", 1, MOST_WORKERS)
    return map(work, things) if workers == 1 else _in_processes(work, iter(things), workers, batch)


@contextmanager
def telling_why_broken() -> Iterator[None]:
    """Say of a process of a pool that ended by itself what ends them.

    Raises:
        ZebratError: instead of the pool's own error.
    """
    try:
        yield
    except BrokenProcessPool as error:
        raise ZebratError(
            "a worker process was killed, most often for want of memory; ask for fewer --workers or more memory. If a "
            "script of yours began this, each worker runs its top level again first, so what it does must stand under "
            '`if __name__ == "__main__":`'
        ) from error


def end_with_parent() -> None:
    """Let a process of a pool end when the one that waits for it is gone: a pool that is killed leaves none behind."""
    parent = parent_process()
    if parent is not None:
        Thread(target=_outlive, args=(parent.join,), daemon=True).start()


def _outlive(wait: Callable[[], None]) -> None:
    wait()
    os._exit(1)


def _in_processes(work: Callable[[T], R], things: Iterator[T], workers: int, batch: int) -> Iterator[R]:
    batches = iter(lambda: list(islice(things, batch)), [])
    begun = list(islice(batches, 2))
    if len(begun) < 2:
        yield from map(work, chain(*begun))
        return
    with telling_why_broken(), ProcessPoolExecutor(workers, get_context("spawn"), end_with_parent) as pool:
        waiting: deque[Future[list[R]]] = deque()
        try:
            for some in chain(begun, batches):
                waiting.append(pool.submit(_all_of, work, some))
                if len(waiting) > workers * _WAITING:
                    yield from waiting.popleft().result()
            while waiting:
                yield from waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


def _all_of(work: Callable[[T], R], things: list[T]) -> list[R]:
    return [work(thing) for thing in things]
