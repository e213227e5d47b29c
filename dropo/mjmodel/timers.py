"""MuJoCo without its timers, which read the clock some thirty times in every physics step."""

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco


def _clock() -> ctypes.c_void_p:
    """MuJoCo's pointer to what reads the time, which its own bindings cannot set to none.

    Where its library is elsewhere than in its wheels, it is one without consequence.
    """
    folder = Path(mujoco.__file__).parent
    for library in [*folder.glob("libmujoco.*"), *folder.glob("mujoco.dll")]:
        return ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time")
    return ctypes.c_void_p()


_CLOCK = _clock()
_LOCK = threading.Lock()
# what read the time when each context now open began; the first is the user's own
_clocks: list[int | None] = []


@contextmanager
def without_timers() -> Iterator[None]:
    """Simulate without timers: the same states, a fifth sooner for a small robot.

    `MjData.timer` stays as it was. The clock belongs to the whole process: of overlapping contexts
    on several threads, the last to end puts it back.
    """
    with _LOCK:
        _clocks.append(_CLOCK.value)
        _CLOCK.value = None
    try:
        yield
    finally:
        with _LOCK:
            _CLOCK.value = _clocks.pop()
