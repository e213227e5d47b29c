"""MuJoCo without its log file."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

_LOCK = threading.Lock()
# the handlers that were set when each context now open began; the first is the user's own
_handlers: list[Any] = []


@contextmanager
def suppress_mujoco_warnings() -> Iterator[list[str]]:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT into the working directory.

    Failures are found in the states, or in what MuJoCo said. The handler belongs to the whole
    process: of overlapping contexts on several threads, the last to end puts the user's own back.

    Yields
    ------
    list of str
        What MuJoCo has said so far; what it says to overlapping contexts is in the latest one's.
    """
    messages: list[str] = []
    with _LOCK:
        _handlers.append(mujoco.get_mju_user_warning())
        mujoco.set_mju_user_warning(messages.append)
    try:
        yield messages
    finally:
        with _LOCK:
            mujoco.set_mju_user_warning(_handlers.pop())
