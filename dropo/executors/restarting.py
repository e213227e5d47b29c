"""A pool that is made anew when a worker of it dies."""

import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from functools import partial
from typing import Any

from dropo.core.services.errors import DropoError

MOST_LOSSES = 3
"""How many pools in a row may break without any call having ended between them."""


class Restarting(Executor):
    """Runs calls on a pool; when a worker dies, on a new one.

    A pool breaks as a whole when one of its processes is killed, for example because memory ran
    out. Calls that had not ended are then run again, on a pool made anew, until `MOST_LOSSES` pools
    in a row have broken without any call having ended.

    Parameters
    ----------
    make : callable
        Makes a pool: an executor whose calls end in `BrokenExecutor` when it breaks.

    Raises
    ------
    DropoError
        By the calls that are left after `MOST_LOSSES`.
    """

    def __init__(self, make: Callable[[], Executor]):
        self._make = make
        self._lock = threading.Lock()
        self._pool = make()
        self._losses = 0
        self._open: set[Future[Any]] = set()
        self._max_workers = getattr(self._pool, "_max_workers", 0)

    def submit(self, call: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        """Run a call on a worker, and once more where the worker dies.

        Parameters
        ----------
        call : callable
            One that may run twice.
        *args : Any
            Its arguments.
        **options : Any
            Its arguments by name.

        Returns
        -------
        concurrent.futures.Future
            What the call gives, or the error that it ends in.
        """
        answer: Future[Any] = Future()
        self._start(answer, partial(call, *args, **options))
        return answer

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Close the pool.

        Parameters
        ----------
        wait : bool
            Whether to wait until its workers have ended.
        cancel_futures : bool
            Whether calls that have not begun are not made.
        """
        self._losses = MOST_LOSSES
        for future in list(self._open) if cancel_futures else ():
            future.cancel()
        self._pool.shutdown(wait=wait)

    def end_workers(self) -> None:
        """Close the pool without waiting: calls are cancelled, and processes at work ended."""
        workers = list((getattr(self._pool, "_processes", None) or {}).values())
        self.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.terminate()

    def _start(self, answer: Future[Any], call: Callable[[], Any]) -> None:
        """Hand a call to the pool of the moment."""
        with self._lock:
            pool = self._pool
            try:
                future = pool.submit(call)
            except BrokenExecutor as error:
                future = Future()
                future.set_exception(error)
        self._open.add(future)
        answer.add_done_callback(lambda done: done.cancelled() and future.cancel())
        future.add_done_callback(partial(self._end, answer, call, pool))

    def _end(
        self, answer: Future[Any], call: Callable[[], Any], pool: Executor, future: Future[Any]
    ) -> None:
        """Pass on what a call ended in, or run it again where its pool broke."""
        self._open.discard(future)
        if future.cancelled() or answer.cancelled():
            answer.cancel()
            return
        error = future.exception()
        if isinstance(error, BrokenExecutor) and self._renewed(pool):
            self._start(answer, call)
        elif isinstance(error, BrokenExecutor):
            said = f"{MOST_LOSSES} times in a row a worker died: out of memory, or killed. {error}"
            answer.set_exception(DropoError(said))
        elif error is not None:
            answer.set_exception(error)
        else:
            self._losses = 0
            answer.set_result(future.result())

    def _renewed(self, broken: Executor) -> bool:
        """Whether there is another pool than the one that is `broken`; makes it where needed."""
        with self._lock:
            if self._pool is broken and self._losses < MOST_LOSSES:
                self._losses += 1
                broken.shutdown(wait=False)
                self._pool = self._make()
            return self._pool is not broken
