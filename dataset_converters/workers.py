"""Worker processes on this machine: results in order, Ctrl-C left to the parent, none outlives it.

datatrove, which queues jobs on a cluster (`cluster.slurm`), has local workers too, but they are not used: it is an
optional extra; its workers and its manager outlive a parent that is killed; a failure is a traceback from each of them;
and there is no progress to show, and no shard to finish after Ctrl-C.
"""

import multiprocessing
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, connection, parent_process
from multiprocessing.process import BaseProcess as Process
from threading import Thread
from typing import Any

from tqdm import tqdm

from lerobot_lisa.errors import UserError


@contextmanager
def worker_pool(count: int, preload: Sequence[str], finish: bool = True) -> Iterator[ProcessPoolExecutor | None]:
    """Give worker processes.

    Args:
        count: number of processes; 1 gives None: the work is then done here.
        preload: modules to import once instead of once per worker.
        finish: after Ctrl-C or an error, wait for the calls under way (seconds each) until Ctrl-C again; otherwise end
            them at once.

    Raises:
        UserError: if a worker was killed.
    """
    if count == 1:
        yield None
        return
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    context.set_forkserver_preload(list(preload))
    others = set(active_children())
    pool = ProcessPoolExecutor(count, context, initializer=_follow_parent)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise UserError(
            "a worker process was killed (out of memory?); run the same command again with fewer --workers"
        ) from error
    except BaseException as error:
        if not finish:
            _kill(set(active_children()) - others)
        elif isinstance(error, KeyboardInterrupt):
            print("interrupted: finishing what is under way; Ctrl-C again to end at once", file=sys.stderr)
        raise
    finally:
        _wait(pool, set(active_children()) - others)


def _wait(pool: ProcessPoolExecutor, workers: set[Process]) -> None:
    """Let the workers end after what they are doing; another Ctrl-C kills them.

    Waiting in `shutdown` would not do: Python 3.12 takes its thread for dead when Ctrl-C interrupts that (bpo-45274).
    """
    pool.shutdown(wait=False, cancel_futures=True)
    try:
        for worker in workers:
            connection.wait([worker.sentinel])
    except KeyboardInterrupt:
        _kill(workers)
        raise


def _kill(workers: set[Process]) -> None:
    for worker in workers:
        worker.kill()


def results_in_order[Result](
    pool: ProcessPoolExecutor | None, work: Callable[..., Result], calls: Iterable[tuple], ahead: int
) -> Iterator[Result]:
    """Results of `work(*call)` for each call, in order, with at most `ahead` under way; no pool: one after the other.

    Args:
        pool: from `worker_pool`.
        work: a function of a module, or a method of something that can be pickled.
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


def progress(items: Iterable[Any] | None, total: int | None, what: str, unit: str = "episode") -> "tqdm[Any]":
    """A progress bar, on a terminal and in the parent process only."""
    return tqdm(items, what, total, unit=unit, disable=True if parent_process() else None)


def _follow_parent() -> None:
    """Start a worker process: it leaves Ctrl-C to its parent, and ends when its parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:

        def end_with_parent() -> None:
            connection.wait([parent.sentinel])
            os._exit(1)

        Thread(target=end_with_parent, daemon=True).start()
