"""Threads that no process waits for at its end: what they simulate is abandoned."""

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from typing import Any

_running: set[Future[Any]] = set()
"""Calls of this process that are being made, of all pools."""


def calls_are_running() -> bool:
    """Tell whether calls are being made still, which an exit would have to wait for or end.

    Returns
    -------
    bool
    """
    return bool(_running)


class DaemonThreads(Executor):
    """Threads of this process, which end with it even while they simulate.

    Those of `concurrent.futures` are joined when the interpreter exits, so that an interrupted
    process lives on until the last of its simulations has ended.

    Parameters
    ----------
    workers : int
        How many, at most.
    name : str
        What the threads' names begin with.
    """

    def __init__(self, workers: int, name: str):
        self._max_workers = workers
        self._name = name
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None]
        self._calls = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []

    def submit(self, call: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        """Make a call in a thread.

        Returns
        -------
        Future
            Of what the call returns.
        """
        answer: Future[Any] = Future()
        self._calls.put((answer, partial(call, *args, **options)))
        if len(self._threads) < self._max_workers:
            name = f"{self._name}_{len(self._threads)}"
            thread = threading.Thread(target=self._work, name=name, daemon=True)
            self._threads.append(thread)
            thread.start()
        return answer

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads behind the calls that are left; with `cancel_futures`, these are not
        made.

        Parameters
        ----------
        wait : bool
            Whether to wait for the calls that are left.
        cancel_futures : bool
            Whether these are not made.
        """
        while cancel_futures:
            try:
                left = self._calls.get_nowait()
            except queue.Empty:
                break
            if left is not None:
                left[0].cancel()
        for _ in self._threads:
            self._calls.put(None)
        for thread in self._threads if wait else ():
            thread.join()

    def _work(self) -> None:
        """Make one call after the other."""
        while (next_call := self._calls.get()) is not None:
            answer, call = next_call
            if not answer.set_running_or_notify_cancel():
                continue
            _running.add(answer)
            try:
                value = call()
            except BaseException as error:  # handed to whoever waits for the answer
                answer.set_exception(error)
            else:
                answer.set_result(value)
            finally:
                _running.discard(answer)
