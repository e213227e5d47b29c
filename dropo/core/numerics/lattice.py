"""Numbers that lie on a lattice, as those of encoders do."""

import numpy as np

from dropo.core.services.validation import Array


def lattice_step(values: Array) -> float | None:
    """Find the step of a lattice on which all numbers lie, with several rows on each point.

    Parameters
    ----------
    values : (n,) array
        The numbers.

    Returns
    -------
    float or None
        The step, in their unit; None where they lie on no lattice.
    """
    points = np.unique(values)
    if len(points) < 3 or len(points) > len(values) / 2:
        return None
    steps = np.diff(points)
    rounding = 1e-9 * (points[-1] - points[0])
    step = float(np.min(steps[steps > rounding], initial=np.inf))
    counts = steps / step
    whole = np.abs(counts - np.rint(counts)) < 0.05
    return step if np.mean(whole) > 0.95 else None
