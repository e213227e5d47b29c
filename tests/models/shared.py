"""What takes long is made once for a run of pytest, whichever of its workers asks first."""

import os
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import pytest

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None


@contextmanager
def locked(path):
    """One process at a time; where there are no locks, every worker has a folder of its own."""
    with path.open("w") as file:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder that `make` fills, for all workers; they read it, and copy it to change it."""
    root = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ and fcntl is not None:
        root = root.parent
    folder = root / name
    done = root / f"{name}.done"
    with locked(root / f"{name}.lock"):
        if not done.exists():
            folder.mkdir(exist_ok=True)
            make(folder)
            done.touch()
    return folder
