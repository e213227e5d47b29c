"""Units that a mapping file may name, as factors on SI units."""

import math
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array
from dropo.mjmodel.sensors import G

TICKS = r"tick/(\d+(?:\.\d+)?)(/s)?"
"""Counts of an encoder of so many a turn, such as "tick/4096", and their speed "tick/4096/s"."""
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of time."""

_BY_SI: dict[str, dict[str, float]] = {
    "rad": {
        "rad": 1.0,
        "deg": math.pi / 180,
        "rev": 2 * math.pi,
        "tick/4096": 2 * math.pi / 4096,
    },
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30, "rev/s": 2 * math.pi},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "m/s^2": {"m/s^2": 1.0, "g": G, "mg": 1e-3 * G, "cm/s^2": 1e-2, "mm/s^2": 1e-3},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": math.pi / 180},
    "T": {"T": 1.0, "mT": 1e-3, "uT": 1e-6},
    "N m": {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "mNm": 1e-3, "N mm": 1e-3},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "A": {"A": 1.0, "mA": 1e-3},
    "V": {"V": 1.0, "mV": 1e-3},
    "": {"": 1.0, "1": 1.0, "%": 1e-2},
}
UNITS: dict[str, tuple[str, float]] = {
    name: (si, factor) for si, names in _BY_SI.items() for name, factor in names.items()
}
"""For each unit its SI unit, and the factor to it; of ticks one for all."""


def unit_named(name: str) -> tuple[str, float] | None:
    """Find a unit by its name.

    Parameters
    ----------
    name : str
        One of `UNITS`, or counts of an encoder by `TICKS`.

    Returns
    -------
    si : str
        The SI unit.
    factor : float
        The factor to it; None where there is no such unit.
    """
    ticks = re.fullmatch(TICKS, name)
    if ticks is None:
        return UNITS.get(name)
    turn = float(ticks[1])
    return ("rad/s" if ticks[2] else "rad", 2 * math.pi / turn) if turn >= 1 else None


def known_unit(name: str) -> tuple[str, float]:
    """Find a unit that is known to exist.

    Parameters
    ----------
    name : str
        As of `unit_named`.

    Returns
    -------
    si : str
        The SI unit.
    factor : float
        The factor to it.

    Raises
    ------
    KeyError
        If there is no such unit.
    """
    found = unit_named(name)
    if found is None:
        raise KeyError(name)
    return found


def units_of(si: tuple[str, ...]) -> list[str]:
    """List the units that may stand for quantities of SI units.

    Parameters
    ----------
    si : tuple of str
        The SI units.

    Returns
    -------
    list of str
    """
    return [name for name, (base, _) in UNITS.items() if base in si]


def seconds(stamps: NDArray[Any], unit: str, origin: Any = None) -> Array:
    """Convert time stamps to seconds.

    Parameters
    ----------
    stamps : (n,) array
        Numbers in a unit, or dates.
    unit : str
        Of numbers: "s", "ms", "us" or "ns".
    origin : object, optional
        A stamp of the same kind, from which on seconds count; by default the value 0, or 1970 for
        dates.

    Returns
    -------
    (n,) float64 array
        Whole numbers and dates are subtracted before they are rounded.
    """
    if stamps.dtype.kind == "M":
        stamps = _nanoseconds(stamps)
        unit = "ns"
        origin = None if origin is None else _nanoseconds(np.asarray(origin))
    since = stamps if origin is None else stamps - origin
    return np.asarray(since, dtype=np.float64) * SECONDS[unit]


def _nanoseconds(dates: NDArray[Any]) -> NDArray[np.int64]:
    """Dates as whole nanoseconds since 1970."""
    return dates.astype("datetime64[ns]").astype(np.int64)
