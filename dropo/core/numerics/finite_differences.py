"""Central differences along axes: where to evaluate, and the quotients."""

import numpy as np

from dropo.core.services.validation import Array


def axial_design(first: Array, second: Array) -> Array:
    """Offsets along each axis from one point: none, then the first steps, then the second.

    Parameters
    ----------
    first, second : (k,) array
        Two steps on each of the k axes.

    Returns
    -------
    (2 k + 1, k) array
    """
    return np.concatenate([np.zeros((1, len(first))), np.diag(first), np.diag(second)])


def difference_quotients(predictions: Array, widths: Array) -> Array:
    """Divide central differences of an axial design by the distance between both points.

    Parameters
    ----------
    predictions : (2 k + 1, R, p) array
        Predictions on an `axial_design`; the first of them, at the point itself, is not used.
    widths : (k,) array
        First step less the second one, on each axis.

    Returns
    -------
    (R, p, k) array
    """
    k = len(widths)
    differences = predictions[1 : k + 1] - predictions[k + 1 :]
    return np.moveaxis(differences / widths[:, None, None], 0, -1)
