"""BLAS on one thread, and which BLAS it is."""

import sys
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

from threadpoolctl import ThreadpoolController


def one_blas_thread() -> AbstractContextManager[Any]:
    """Keep BLAS on one thread: products of small matrices gain nothing from more, but other digits.

    Returns
    -------
    context manager
        What BLAS had before is back behind it.
    """
    return _controller(len(sys.modules)).limit(limits=1, user_api="blas")


def blas_kernels() -> list[str]:
    """Return which kernels BLAS has chosen for this processor.

    Returns
    -------
    list of str
        Sorted.
    """
    pools = _controller(len(sys.modules)).info()
    kernels = {pool.get("architecture") or "" for pool in pools if pool["user_api"] == "blas"}
    return sorted(filter(None, kernels))


@lru_cache(maxsize=1)
def _controller(modules: int) -> ThreadpoolController:
    """The controller of the libraries that are loaded, looked for again with more modules."""
    return ThreadpoolController()
