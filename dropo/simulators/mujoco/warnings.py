"""MuJoCo without its log file."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

_LOCK = threading.Lock()
_handlers: list[
    Any
] = []  # what was set when each `quiet` now open began; the first is the user's own


@contextmanager
def quiet() -> Iterator[None]:
    """Keeps MuJoCo from writing MUJOCO_LOG.TXT into the working directory; failures are found in
    the states.

    The handler is the whole process's: of overlapping ones on several threads, the last to end puts
    the user's own back.
    """
    with _LOCK:
        _handlers.append(mujoco.get_mju_user_warning())
        mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        with _LOCK:
            mujoco.set_mju_user_warning(_handlers.pop())
