"""Executors of this machine: threads and processes."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial

from dropo.core.services.daemon_threads import DaemonThreads
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import require
from dropo.executors.restarting import Restarting

LEFT_ALONE = (signal.signal, (signal.SIGINT, signal.SIG_IGN))
"""What a worker does first: Ctrl-C is for the process that waits for it, which ends it."""


@contextmanager
def threads(place: str) -> Iterator[Executor]:
    """Threads of this process; a number behind the name, or one for each core.

    Parameters
    ----------
    place : str
        How many; "" for one for each core.

    Yields
    ------
    concurrent.futures.Executor
        It is closed in the end.

    Raises
    ------
    BadArgument
        If the place is no whole number above 0.
    """
    pool = DaemonThreads(_number(place, "threads"), "executor")
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


@contextmanager
def processes(place: str) -> Iterator[Executor]:
    """Processes of this machine; a number behind the name, or one for each core.

    Parameters
    ----------
    place : str
        How many; "" for one for each core.

    Yields
    ------
    concurrent.futures.Executor
        A pool that is made anew when a worker dies; it is closed in the end.

    Raises
    ------
    BadArgument
        If the place is no whole number above 0.
    """
    number = _number(place, "processes")
    fresh = multiprocessing.get_context("spawn")
    with _closed(partial(ProcessPoolExecutor, number, fresh, *LEFT_ALONE)) as pool:
        yield pool


@contextmanager
def joblib(place: str) -> Iterator[Executor]:
    """Processes of joblib's pool, loky; a number behind the name, or one for each core.

    Parameters
    ----------
    place : str
        How many; "" for one for each core.

    Yields
    ------
    concurrent.futures.Executor
        A pool that is made anew when a worker dies; it is closed in the end.

    Raises
    ------
    MissingPackage
        If joblib is missing.
    BadArgument
        If the place is no whole number above 0.
    """
    need("joblib", extra="joblib", caller="The executor 'joblib'")
    from joblib.externals.loky import ProcessPoolExecutor as Loky

    initializer, what = LEFT_ALONE
    number = _number(place, "joblib")
    with _closed(partial(Loky, number, initializer=initializer, initargs=what)) as pool:
        yield pool


@contextmanager
def _closed(make: Callable[[], Executor]) -> Iterator[Executor]:
    """A pool that restarts; after an error or an interruption, its workers are ended."""
    pool = Restarting(make)
    try:
        yield pool
    except BaseException:
        pool.end_workers()
        raise
    pool.shutdown(wait=True, cancel_futures=True)


def _number(place: str, name: str) -> int:
    """The number of workers behind a name."""
    rule = f"a number of at least 1 behind its colon, such as {name}:4"
    is_number = place.isdecimal() and int(place) > 0
    require(not place or is_number, "--executor", rule, f"{name}:{place}", name)
    return int(place) if place else cores()


def cores() -> int:
    """Count this machine's cores.

    Returns
    -------
    int
    """
    return os.cpu_count() or 1
