"""Executors of this machine: threads and processes."""

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial

from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import require
from dropo.executors.restarting import Restarting


@contextmanager
def threads(place: str) -> Iterator[Executor]:
    """Threads of this process; a number behind the name, or one for each core.

    Parameters
    ----------
    place : str
        Number of threads; empty for one for each core.

    Yields
    ------
    concurrent.futures.Executor
        Open until the block ends.

    Raises
    ------
    BadArgument
        If what stands behind the name is no number of at least 1.
    """
    with ThreadPoolExecutor(_number(place, "threads"), thread_name_prefix="executor") as pool:
        yield pool


@contextmanager
def processes(place: str) -> Iterator[Executor]:
    """Processes of this machine; a number behind the name, or one for each core.

    Parameters
    ----------
    place : str
        Number of processes; empty for one for each core.

    Yields
    ------
    concurrent.futures.Executor
        Open until the block ends.

    Raises
    ------
    BadArgument
        If what stands behind the name is no number of at least 1.
    """
    number = _number(place, "processes")
    fresh = multiprocessing.get_context("spawn")
    with _closed(partial(ProcessPoolExecutor, number, mp_context=fresh)) as pool:
        yield pool


@contextmanager
def joblib(place: str) -> Iterator[Executor]:
    """Processes of joblib's pool, loky; a number behind the name, or one for each core.

    Parameters
    ----------
    place : str
        Number of processes; empty for one for each core.

    Yields
    ------
    concurrent.futures.Executor
        Open until the block ends.

    Raises
    ------
    MissingPackage
        If joblib is not installed (extra `joblib`).
    BadArgument
        If what stands behind the name is no number of at least 1.
    """
    need("joblib", extra="joblib", caller="The executor 'joblib'")
    from joblib.externals.loky import ProcessPoolExecutor as Loky

    with _closed(partial(Loky, _number(place, "joblib"))) as pool:
        yield pool


@contextmanager
def _closed(make: Callable[[], Executor]) -> Iterator[Executor]:
    """A pool that restarts, closed without waiting for what was not asked for any more."""
    pool = Restarting(make)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _number(place: str, name: str) -> int:
    """The number of workers behind a name."""
    rule = f"a number of at least 1 behind its colon, such as {name}:4"
    is_number = place.isdecimal() and int(place) > 0
    require(not place or is_number, "--executor", rule, f"{name}:{place}", name)
    return int(place) if place else cores()


def cores() -> int:
    """The number of this machine's cores."""
    return os.cpu_count() or 1
