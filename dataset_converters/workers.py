"""Worker processes that make shards: results in order, Ctrl-C left to the parent, none outlives it."""

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, parent_process
from threading import Thread

from lerobot_lisa.errors import UserError


@contextmanager
def worker_pool(count: int, preload: Sequence[str]) -> Iterator[ProcessPoolExecutor | None]:
    """Give worker processes; an interruption waits for the shards under way (seconds each), which are then kept.

    Args:
        count: number of processes; 1 gives None: the work is then done here.
        preload: modules to import once instead of once per worker.

    Raises:
        UserError: if a worker was killed.
    """
    if count == 1:
        yield None
        return
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    context.set_forkserver_preload(list(preload))
    pool = ProcessPoolExecutor(count, context, initializer=_follow_parent)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise UserError(
            "a worker process was killed (out of memory?); run the same command again with fewer --workers"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


def results_in_order[Result](
    pool: ProcessPoolExecutor | None, work: Callable[..., Result], calls: Iterable[tuple], ahead: int
) -> Iterator[Result]:
    """Results of `work(*call)` for each call, in order, with at most `ahead` under way; no pool: one after the other.

    Args:
        pool: from `worker_pool`.
        work: a function of a module.
        calls: its arguments, which must be picklable.
        ahead: bound on what waits.
    """
    if pool is None:
        for call in calls:
            yield work(*call)
        return
    waiting: deque[Future[Result]] = deque()
    for call in calls:
        waiting.append(pool.submit(work, *call))
        if len(waiting) == ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def _follow_parent() -> None:
    """Start a worker process: it leaves Ctrl-C to its parent, and ends when its parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:

        def end_with_parent() -> None:
            connection.wait([parent.sentinel])
            os._exit(1)

        Thread(target=end_with_parent, daemon=True).start()
