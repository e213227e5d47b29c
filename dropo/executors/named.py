"""The executor that a text such as "processes:4", "dask://host:8786" or "slurm:cpu" names."""

import hashlib
import pickle
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from dropo.core.services.plugin_files import is_loaded, load_plugins, loaded_files
from dropo.core.services.registry import find


@contextmanager
def executor_named(text: str | None) -> Iterator[Executor | None]:
    """Open the executor of a name, and close it in the end.

    Parameters
    ----------
    text : str or None
        "NAME" or "NAME:PLACE", such as "processes:4", "dask://host:8786" or "slurm:cpu,time=60";
        `dropo list executors` lists the names. None for no executor.

    Yields
    ------
    concurrent.futures.Executor or None
        Its workers know the plug-in files of this process.

    Raises
    ------
    UnknownName
        If there is no such executor; the message gives the nearest name.
    BadArgument
        If the place is none of that executor's.
    MissingPackage
        If a package is missing; the message says how to install it.
    DropoError
        If the cluster does not answer.
    """
    if text is None:
        yield None
        return
    name, _, place = text.partition(":")
    with find("executors", name)(place.removeprefix("//")) as executor:
        yield WithPlugins(executor)


class WithPlugins(Executor):
    """Runs calls on another executor, whose workers import this process' plug-in files first.

    Parameters
    ----------
    executor : concurrent.futures.Executor
    """

    def __init__(self, executor: Executor):
        self.executor = executor
        self._max_workers = getattr(executor, "_max_workers", 0)

    def submit(self, call: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        """Run a call on a worker; what it needs of plug-ins is there before it is unpickled.

        Parameters
        ----------
        call : callable
            What runs there; it is pickled with its arguments.
        *args : Any
            Its arguments.
        **options : Any
            Its arguments by name.

        Returns
        -------
        concurrent.futures.Future
            What the call gives, or the error that it ends in.
        """
        files = {str(path): path.read_bytes() for path in loaded_files()}
        return self.executor.submit(_run, files, pickle.dumps((call, args, options)))


def _run(files: dict[str, bytes], pickled: bytes) -> Any:
    """Run a pickled call in a worker that knows the plug-in `files`."""
    for path, content in files.items():
        if not is_loaded(path):
            load_plugins(_place(path, content))
    call, args, options = pickle.loads(pickled)
    return call(*args, **options)


@cache
def _place(path: str, content: bytes) -> Path:
    """Where a worker reads a file: in its own place, or from a copy where that is another."""
    there = Path(path)
    if there.is_file() and _sum(there.read_bytes()) == _sum(content):
        return there
    copied = Path(tempfile.mkdtemp(prefix="dropo_plugin_")) / there.name
    copied.write_bytes(content)
    return copied


def _sum(content: bytes) -> str:
    """The SHA-256 of bytes."""
    return hashlib.sha256(content).hexdigest()
