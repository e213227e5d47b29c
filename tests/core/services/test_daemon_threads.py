"""Threads that nobody waits for: calls in order, cancelled, and abandoned with their process."""

import threading
from concurrent.futures import CancelledError

import pytest

from dropo.core.services.daemon_threads import DaemonThreads, calls_are_running


def test_calls_give_values_and_errors():
    """As any executor; threads end behind the last call."""
    pool = DaemonThreads(2, "test")
    answers = [pool.submit(pow, base, exp=2) for base in range(5)]
    failing = pool.submit(int, "x")
    assert [answer.result() for answer in answers] == [0, 1, 4, 9, 16]
    with pytest.raises(ValueError, match="invalid literal"):
        failing.result()
    pool.shutdown()
    assert not any(thread.is_alive() for thread in pool._threads)


def test_what_waits_is_cancelled_and_what_runs_is_left():
    """The shutdown does not wait; a process would end now."""
    begun, go = threading.Event(), threading.Event()
    pool = DaemonThreads(1, "test")
    running = pool.submit(lambda: (begun.set(), go.wait(30)))
    waiting = pool.submit(int, "1")
    assert begun.wait(30)
    pool.shutdown(wait=False, cancel_futures=True)
    with pytest.raises(CancelledError):
        waiting.result()
    assert calls_are_running()
    assert all(thread.daemon for thread in pool._threads)
    go.set()
    running.result()
    pool.shutdown()
    assert not calls_are_running()
