"""Logged numbers at other instants.

Akima splines serve for sensors, the last value for commands, and great arcs for rotations.
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import Akima1DInterpolator
from scipy.spatial.transform import Rotation, Slerp

from dropo.core.services.validation import Array, float_array, known, require

Method = Literal["akima", "linear", "previous"]


def resample(
    time: ArrayLike, values: ArrayLike, at: ArrayLike, *, method: Method = "akima"
) -> Array:
    """Interpolate logged values at other instants.

    Parameters
    ----------
    time : (n,) array
        Strictly increasing stamps [s].
    values : (n, p) array
        The logged values.
    at : (m,) array
        The instants [s], within the log; only "previous" goes on behind its end.
    method : "akima", "linear" or "previous"
        A spline that does not overshoot between measurements, as the thesis takes for sensors; a
        straight line; or each value held until the next, as commands are, and the last one for
        good.

    Returns
    -------
    (m, p) array

    Raises
    ------
    BadArgument
        If an array has another shape or is not finite, there are fewer than two stamps, `time` does
        not increase, or `at` lies outside the log.
    UnknownName
        If there is no such method.

    References
    ----------
    Akima, Journal of the ACM 17 (1970), 589.
    """
    known("method", method, ("akima", "linear", "previous"))
    stamps, instants = _check_times(time, at, caller="resample", beyond=method == "previous")
    rows = float_array("values", values, (len(stamps), None), "resample")
    if method == "previous":
        return rows[np.searchsorted(stamps, instants, side="right") - 1]
    if method == "akima" and len(stamps) > 2:
        return np.asarray(Akima1DInterpolator(stamps, rows)(instants), dtype=float)
    columns = [np.interp(instants, stamps, column) for column in rows.T]
    return np.stack(columns, axis=1).reshape(len(instants), rows.shape[1])


def resample_rotations(time: ArrayLike, quaternions: ArrayLike, at: ArrayLike) -> Array:
    """Interpolate rotations: turns at constant rate between those that were measured.

    Parameters
    ----------
    time : (n,) array
        Strictly increasing stamps [s].
    quaternions : (n, 4) array
        Measured rotations w, x, y, z.
    at : (m,) array
        The instants [s], within the log.

    Returns
    -------
    (m, 4) array
        Unit quaternions w, x, y, z. Signs follow the first measured one without jumps, so that
        columns are continuous.

    Raises
    ------
    BadArgument
        If an array has another shape or is not finite, there are fewer than two stamps, `time` does
        not increase, `at` lies outside the log, or a quaternion is zero.

    References
    ----------
    Shoemake, SIGGRAPH (1985), 245.
    """
    caller = "resample_rotations"
    stamps, instants = _check_times(time, at, caller=caller)
    measured = float_array("quaternions", quaternions, (len(stamps), 4), caller)
    nonzero = bool((np.linalg.norm(measured, axis=1) > 0).all())
    require(nonzero, "quaternions", "of a length above 0", "a zero", caller)
    rotations = Rotation.from_quat(measured, scalar_first=True)
    turned = Slerp(stamps, rotations)(instants)
    found = np.asarray(turned.as_quat(scalar_first=True), dtype=float)
    if not len(found):
        return found
    before = max(0, int(np.searchsorted(stamps, instants[0], side="right")) - 1)
    return align_signs(found, measured[before])


def align_signs(quaternions: Array, first: Array) -> Array:
    """Choose the signs of quaternions so that they go on without jumps.

    Parameters
    ----------
    quaternions : (n, 4) array
        Rotations, of which q and -q are the same; n > 0.
    first : (4,) array
        What the first one is to be near.

    Returns
    -------
    (n, 4) array
    """
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    signs = np.where(np.cumsum([quaternions[0] @ first < 0, *flips]) % 2, -1.0, 1.0)
    return quaternions * signs[:, None]


def _check_times(
    time: ArrayLike, at: ArrayLike, *, caller: str, beyond: bool = False
) -> tuple[Array, Array]:
    """Both as arrays, refused where `time` does not increase or `at` lies outside of it."""
    stamps = float_array("time", time, (None,), caller)
    instants = float_array("at", at, (None,), caller)
    require(len(stamps) >= 2, "time", "at least 2 instants", len(stamps), caller)
    back = np.flatnonzero(np.diff(stamps) <= 0)
    got = f"{stamps[back[:1] + 1]} behind {stamps[back[:1]]}"
    require(len(back) == 0, "time", "strictly increasing", got, caller)
    last = np.inf if beyond else stamps[-1]
    outside = instants[(instants < stamps[0]) | (instants > last)]
    rule = f"within {stamps[0]:.9g} and {stamps[-1]:.9g} s"
    require(not len(outside), "at", rule, float(outside[0]) if len(outside) else "", caller)
    return stamps, instants
