"""Spread that a few wild numbers do not move."""

import numpy as np

from dropo.core.services.validation import Array

NORMAL = 1.4826
"""Standard deviations in the median distance from the centre of normal numbers."""


def deviation(errors: Array) -> Array:
    """The standard deviation (p,) of errors (n, p) about 0, were they normal: by their median size;
    NaN rows count for nothing.
    """
    return np.asarray(NORMAL * np.nanmedian(np.abs(errors), axis=0))
