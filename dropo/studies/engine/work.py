"""Runs a study's tasks on threads or on any executor, each of them once.

Tasks that an interrupted study had finished are not run again.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dropo._version import __version__
from dropo.core.contracts.estimator import Progress, silent
from dropo.core.services.blas_threads import one_blas_thread
from dropo.core.services.daemon_threads import DaemonThreads
from dropo.core.services.files.journal import Journal
from dropo.core.services.plugin_files import plugin_sums

ANSWERS = "the finished tasks of a study, one JSON line each"
"""What the file is, for messages."""

Task = Callable[[Any], dict[str, Any]]
"""A function of an item that JSON can hold; its answer depends on the item alone."""


class Interrupted(KeyboardInterrupt):
    """A study was interrupted.

    Parameters
    ----------
    kept : int
        How many answers its journal holds.
    """

    def __init__(self, kept: int):
        super().__init__(f"{kept} answers are kept")
        self.kept = kept


class Work:
    """Runs tasks on an executor's workers or on threads.

    A task's answer depends on its item alone, so results are the same on any executor.
    Answers are kept by task and item, so that runs of other settings may share a journal: each uses
    those that are its own, and leaves the others where they are.

    Parameters
    ----------
    executor : concurrent.futures.Executor or None
        Where tasks run; None for threads.
    threads : int
        Number of threads without an executor; 0 for as many as there are cores.
    progress : callable
        Called with the finished fraction and a text.
    path : Path or None
        File that keeps the answers of finished tasks, a journal; an interrupted study is resumed
        from it.

    Raises
    ------
    BadFile
        If another version, or other plug-in files, wrote the journal.
    """

    def __init__(
        self,
        executor: Executor | None = None,
        *,
        threads: int = 0,
        progress: Progress = silent,
        path: Path | None = None,
    ):
        self.executor = executor
        self.threads = threads or os.cpu_count() or 1
        self.progress = progress
        self.path = path
        plugins = plugin_sums()
        header = {"version": __version__, **({"plugins": plugins} if plugins else {})}
        self._journal = None if path is None else Journal(path, header, ANSWERS)
        kept = [] if self._journal is None else self._journal.entries
        self._answers: dict[str, str] = dict(kept)
        self._unused = set(self._answers)

    def map(self, task: Task, items: Iterable[Any]) -> list[dict[str, Any]]:
        """Run a task on every item.

        Parameters
        ----------
        task : callable
            A function of a module (executors send it to other processes by its name) that
            simulates on one thread and returns a dict of numbers, strings, lists and dicts.
        items : iterable
            Numbers, strings, or lists and dicts of them.

        Returns
        -------
        list of dict
            `task(item)` of every item, in order, as JSON gives it back.

        Raises
        ------
        Exception
            That of the first task that fails; finished tasks are kept.
        """
        keyed = [(_key(task, item), item) for item in items]
        self._unused.difference_update(key for key, _ in keyed)
        missing = [(key, item) for key, item in keyed if key not in self._answers]
        if self.executor is not None:
            self._run(self.executor, task, missing, len(keyed))
        elif missing:
            pool = DaemonThreads(min(self.threads, len(missing)), "study")
            try:
                self._run(pool, task, missing, len(keyed))
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
        return [json.loads(self._answers[key]) for key, _ in keyed]

    def kept(self, key: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Give the answer that is kept under a key, or make it in this thread and keep it.

        Parameters
        ----------
        key : str
            What identifies the answer among all of the study.
        make : callable
            Makes a dict that JSON can hold, and that depends on the key alone.

        Returns
        -------
        dict
            As JSON gives it back.
        """
        self._unused.discard(key)
        if key not in self._answers:
            self._add(key, json.dumps(make()))
        answer: dict[str, Any] = json.loads(self._answers[key])
        return answer

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Say with an interruption of a block how many answers are kept.

        Raises
        ------
        Interrupted
            In place of `KeyboardInterrupt`.
        """
        try:
            yield
        except KeyboardInterrupt:
            raise Interrupted(len(self._answers)) from None

    def release(self) -> None:
        """Remove the journal of a study that is written, unless it holds what another run made."""
        if self.path is not None and not self._unused:
            self.path.unlink(missing_ok=True)

    def _run(
        self, executor: Executor, task: Task, missing: list[tuple[str, Any]], total: int
    ) -> None:
        """Runs the tasks that are missing of `total`, and keeps every answer as it comes."""
        title = task.__name__.strip("_").replace("_", " ")
        with one_blas_thread():
            keys = {executor.submit(_on_one_thread, task, item): key for key, item in missing}
            try:
                for done, future in enumerate(as_completed(keys), total - len(missing) + 1):
                    self._keep(keys[future], future)
                    self.progress(done / total, f"{title}, {done} of {total}")
            finally:
                # After a failure: start no more tasks, and keep what others have finished.
                for future, key in keys.items():
                    is_finished = not future.cancel() and future.done()
                    if is_finished and key not in self._answers and future.exception() is None:
                        self._keep(key, future)

    def _keep(self, key: str, future: Future[dict[str, Any]]) -> None:
        """Keeps a finished task's answer, in the file too."""
        self._add(key, json.dumps(future.result()))

    def _add(self, key: str, answer: str) -> None:
        """Keeps an answer, in the file too."""
        if self._journal is not None:
            self._journal.append([key, answer])
        self._answers[key] = answer


def _on_one_thread(task: Task, item: Any) -> dict[str, Any]:
    """Runs the task with BLAS on one thread, since more would change the last digits."""
    with one_blas_thread():
        return task(item)


def _key(task: Task, item: Any) -> str:
    """What identifies a task's answer: the function and the item."""
    return json.dumps([f"{task.__module__}.{task.__qualname__}", item])
