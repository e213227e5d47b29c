"""Runs a study's tasks: on threads or on any executor, each of them once, and those of an
interrupted study not again.
"""

import json
import os
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from dropo.core.contracts.estimator import Progress, silent
from dropo.core.services.atomic_write import write_text

Task = Callable[[Any], dict[str, Any]]


class Work:
    """Spreads tasks over an executor's workers; without one, over `threads` threads (0: as many as
    there are cores).

    path: a file that keeps what finished tasks found, one JSON line each; a study that was
    interrupted goes on from it. A task's answer depends on its item alone, so results are the same
    on any executor.
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
        self._known = _read(path) if path is not None else {}

    def map(self, task: Task, items: Iterable[Any]) -> list[dict[str, Any]]:
        """task(item) of every item, in order, as JSON gives it back.

        task: a function of a module (executors send it to other processes by its name), that
        simulates on one thread and returns a dict of numbers, strings, lists and dicts; items:
        numbers, strings, or lists of them.
        """
        questions = [(_key(task, item), item) for item in items]
        missing = [(key, item) for key, item in questions if key not in self._known]
        if self.executor is not None:
            self._run(self.executor, task, missing, len(questions))
        elif missing:
            pool = ThreadPoolExecutor(min(self.threads, len(missing)), thread_name_prefix="study")
            try:
                self._run(pool, task, missing, len(questions))
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
        return [json.loads(self._known[key]) for key, _ in questions]

    def _run(
        self, executor: Executor, task: Task, missing: list[tuple[str, Any]], total: int
    ) -> None:
        with threadpool_limits(1, user_api="blas"):
            waiting = {executor.submit(_alone, task, item): key for key, item in missing}
            try:
                for done, future in enumerate(as_completed(waiting), total - len(missing) + 1):
                    self._keep(waiting[future], future)
                    self.progress(
                        done / total,
                        f"{task.__name__.strip('_').replace('_', ' ')}, {done} of {total}",
                    )
            finally:
                for future, key in waiting.items():
                    if (
                        not future.cancel()
                        and future.done()
                        and key not in self._known
                        and future.exception() is None
                    ):
                        self._keep(key, future)

    def _keep(self, key: str, future: Future[dict[str, Any]]) -> None:
        answer = self._known[key] = json.dumps(future.result())
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a") as file:
                file.write(json.dumps([key, answer]) + "\n")


def _alone(task: Task, item: Any) -> dict[str, Any]:
    """The task with BLAS on one thread, in whichever process: more threads would change last
    digits.
    """
    with threadpool_limits(1, user_api="blas"):
        return task(item)


def _key(task: Task, item: Any) -> str:
    return json.dumps([f"{task.__module__}.{task.__qualname__}", item])


def _read(path: Path) -> dict[str, str]:
    """The whole lines of the file; a half-written last one is cut off."""
    if not path.is_file():
        return {}
    text = path.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        write_text(path, whole)
    return dict(json.loads(line) for line in whole.splitlines())
