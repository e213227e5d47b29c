"""MuJoCo without its log file.

With `dropo.mjmodel` imported, what MuJoCo says goes to Python's logging, not into MUJOCO_LOG.TXT in
the working directory, unless someone else listens.
"""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

LOGGER = logging.getLogger("dropo.mujoco")
"""What MuJoCo says outside of `suppress_mujoco_warnings`, at the level of debugging."""
_LOCK = threading.Lock()
# the handlers that were set when each context now open began; the first is the user's own
_handlers: list[Any] = []


@contextmanager
def suppress_mujoco_warnings() -> Iterator[list[str]]:
    """Listen to MuJoCo, in place of whoever else listens.

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


def leave_no_log_file() -> None:
    """Send MuJoCo's warnings to Python's logging, where no one listens to them yet."""
    with _LOCK:
        if mujoco.get_mju_user_warning() is None:
            mujoco.set_mju_user_warning(LOGGER.debug)
