"""Several tests at once."""

from collections.abc import Sequence

import numpy as np

from dropo.core.services.validation import Array


def holm(p_values: Sequence[float]) -> Array:
    """Adjust p-values of several tests, so that one false rejection among all has their level.

    Parameters
    ----------
    p_values : sequence of float
        Of each test; NaN where there was none, which counts as no test.

    Returns
    -------
    array
        Adjusted p-values in the same order.

    References
    ----------
    Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of
    Statistics 6, 1979.
    """
    values = np.asarray(p_values, dtype=float)
    adjusted = np.full(len(values), np.nan)
    tested = np.flatnonzero(np.isfinite(values))
    order = tested[np.argsort(values[tested], kind="stable")]
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * values[order]), 1.0)
    return adjusted
