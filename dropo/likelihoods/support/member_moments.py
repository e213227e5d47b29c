"""Mean and covariance of a family's members, in the coordinates in which the family is taken."""

from typing import Any

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.numerics.array_api import constant, namespace
from dropo.core.services.validation import Array


def coordinates(family: Family, values: Array) -> Array:
    """Return parameters in the coordinates in which a family is taken.

    Parameters
    ----------
    family : Family
        It may be in logarithms.
    values : array
        Parameters, in their units.

    Returns
    -------
    array
        The values, or their logarithms if the family is logarithmic.
    """
    return np.log(values) if family.logarithmic else values


def moments_of(family: Family, own: Any) -> tuple[Any, Any]:
    """Find the moments of a member, or of its logarithms if the family is logarithmic.

    Parameters
    ----------
    family : Family
    own : (n,) array or tensor
        The family's unknowns.

    Returns
    -------
    mean : (d,) array or tensor
    covariance : (d, d) array or tensor
    """
    xp = namespace(own)
    mean = family.mean(own)
    sd = family.sd(own)
    covariance = constant(family.correlation(own), own) * sd[:, None] * sd[None, :]
    if not family.logarithmic:
        return mean, covariance
    # Exact for multivariate log-normals.
    covariance = xp.log1p(covariance / (mean[:, None] * mean[None, :]))
    return xp.log(mean) - 0.5 * xp.linalg.diagonal(covariance), covariance


def slopes_of_moments(family: Family, own: Array) -> tuple[Array, Array]:
    """Differentiate `moments_of` in each of the family's unknowns, by central differences.

    Parameters
    ----------
    family : Family
    own : (n,) array

    Returns
    -------
    of_mean : (n, d) array
    of_covariance : (n, d, d) array
    """
    box = family.unknowns.high - family.unknowns.low
    steps = 1e-6 * np.maximum(np.abs(own), 1e-6 * box) * np.eye(len(own))
    of_mean = []
    of_covariance = []
    for step in steps:
        mean_above, covariance_above = moments_of(family, own + step)
        mean_below, covariance_below = moments_of(family, own - step)
        width = 2 * step.sum()
        of_mean.append((mean_above - mean_below) / width)
        of_covariance.append((covariance_above - covariance_below) / width)
    return np.stack(of_mean), np.stack(of_covariance)
