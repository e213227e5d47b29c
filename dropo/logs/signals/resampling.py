"""Logged numbers at other instants: Akima splines for sensors, the last value for commands, great
arcs for rotations.
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
    """The values (m, p) at the instants `at` (m,) [s], from values (n, p) at strictly increasing
    `time` (n,) [s].

    method: "akima", a spline that does not overshoot between measurements (Akima, J. ACM 17, 1970),
    as the thesis takes for sensors;
    "linear"; "previous": each value is held until the next, as commands are. `at` must not reach
    beyond the log; only "previous" goes on behind its end, where the last value is held.
    """
    known("method", method, ("akima", "linear", "previous"))
    stamps, instants = _times(time, at, caller="resample", beyond=method == "previous")
    rows = float_array("values", values, (len(stamps), None), "resample")
    if method == "previous":
        return rows[np.searchsorted(stamps, instants, side="right") - 1]
    if method == "akima" and len(stamps) > 2:
        return np.asarray(Akima1DInterpolator(stamps, rows)(instants), dtype=float)
    return np.stack([np.interp(instants, stamps, column) for column in rows.T], axis=1).reshape(
        len(instants), rows.shape[1]
    )


def resample_rotations(time: ArrayLike, quaternions: ArrayLike, at: ArrayLike) -> Array:
    """Unit quaternions (m, 4), w x y z, at the instants `at` (m,) [s]: turns at constant rate
    between measured `quaternions` (n, 4).

    time: (n,) [s] of those, strictly increasing. Shoemake, SIGGRAPH 1985. Signs follow the first
    quaternion without jumps, so that columns are continuous.
    """
    stamps, instants = _times(time, at, caller="resample_rotations")
    measured = float_array("quaternions", quaternions, (len(stamps), 4), "resample_rotations")
    require(
        bool((np.linalg.norm(measured, axis=1) > 0).all()),
        "quaternions",
        "of a length above 0",
        "a zero",
        "resample_rotations",
    )
    found = np.asarray(
        Slerp(stamps, Rotation.from_quat(measured, scalar_first=True))(instants).as_quat(
            scalar_first=True
        ),
        dtype=float,
    )
    if not len(found):
        return found
    first = measured[max(0, int(np.searchsorted(stamps, instants[0], side="right")) - 1)]
    turned = np.sum(found[1:] * found[:-1], axis=1) < 0
    signs = np.where(np.cumsum([found[0] @ first < 0, *turned]) % 2, -1.0, 1.0)
    return found * signs[:, None]


def _times(
    time: ArrayLike, at: ArrayLike, *, caller: str, beyond: bool = False
) -> tuple[Array, Array]:
    """Both as arrays, refused where `time` does not increase or `at` lies outside of it."""
    stamps = float_array("time", time, (None,), caller)
    instants = float_array("at", at, (None,), caller)
    require(len(stamps) >= 2, "time", "at least 2 instants", len(stamps), caller)
    back = np.flatnonzero(np.diff(stamps) <= 0)
    require(
        len(back) == 0,
        "time",
        "strictly increasing",
        f"{stamps[back[:1] + 1]} behind {stamps[back[:1]]}",
        caller,
    )
    outside = (instants < stamps[0]) | (instants > (np.inf if beyond else stamps[-1]))
    rule = f"within {stamps[0]:.9g} and {stamps[-1]:.9g} s"
    require(
        not outside.any(), "at", rule, float(instants[outside][0]) if outside.any() else "", caller
    )
    return stamps, instants
