"""Executors of clusters that run already, or that start on this machine: Dask and Ray."""

import importlib
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager
from typing import Any

from dropo.core.services.errors import DropoError
from dropo.core.services.optional_dependencies import need
from dropo.executors.machine import cores

WAIT = 20
"""How long a cluster has for its first answer [s]."""


@contextmanager
def dask(place: str) -> Iterator[Executor]:
    """A Dask scheduler, as in dask://host:8786; without an address, processes of this machine.

    Parameters
    ----------
    place : str
        Address of a scheduler, such as "host:8786"; "" for processes of this machine.

    Yields
    ------
    concurrent.futures.Executor
        Of a client that is closed in the end.

    Raises
    ------
    MissingPackage
        If the package distributed is missing.
    DropoError
        If no scheduler answers at the address.
    """
    need("distributed", extra="dask", caller="The executor 'dask'")
    distributed: Any = importlib.import_module("distributed")
    with ExitStack() as opened:
        if place:
            cluster = f"tcp://{place}"
        else:
            workers = {"n_workers": cores(), "threads_per_worker": 1, "processes": True}
            local = distributed.LocalCluster(**workers, dashboard_address=None)
            cluster = opened.enter_context(local)
        try:
            client = opened.enter_context(distributed.Client(cluster, timeout=WAIT))
        except OSError as error:
            raise DropoError(f"No Dask scheduler answers at {place} in {WAIT} s.") from error
        yield client.get_executor()


@contextmanager
def ray(place: str) -> Iterator[Executor]:
    """A Ray cluster, as in ray://host:10001; without an address, processes of this machine.

    Parameters
    ----------
    place : str
        Address of a cluster, such as "host:10001"; "" for processes of this machine.

    Yields
    ------
    concurrent.futures.Executor
        Ray is shut down in the end.

    Raises
    ------
    MissingPackage
        If the package ray is missing.
    DropoError
        If no cluster answers at the address.
    """
    need("ray", extra="ray", caller="The executor 'ray'")
    import ray as package

    address = f"ray://{place}" if place else "local"
    try:
        package.init(address, include_dashboard=False, log_to_driver=False)
    except (OSError, RuntimeError) as error:
        raise DropoError(f"No Ray cluster answers at {place}.") from error
    try:
        yield RayExecutor(package)
    finally:
        package.shutdown()


class RayExecutor(Executor):
    """Each call a task of Ray, which starts those of lost workers again.

    Parameters
    ----------
    package : module
        `ray`, connected.
    """

    def __init__(self, package: Any):
        self._task = package.remote(max_retries=3)(_called)
        self._max_workers = int(package.cluster_resources().get("CPU", 1))

    def submit(self, call: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        """Run a call on a worker of the cluster.

        Parameters
        ----------
        call : callable
            What runs there; Ray pickles it.
        *args : Any
            Its arguments.
        **options : Any
            Its arguments by name.

        Returns
        -------
        concurrent.futures.Future
            What the call gives, or the error that it ends in.
        """
        future: Future[Any] = self._task.remote(call, args, options).future()
        return future


def _called(call: Callable[..., Any], args: tuple[Any, ...], options: dict[str, Any]) -> Any:
    """What a call gives."""
    return call(*args, **options)
