"""Tails, quantiles and densities of a few distributions, bit for bit those of scipy.stats.

Its import takes longer than a small fit, and these are all that a fit asks of it.
"""

from typing import Any

import numpy as np
from scipy import special


def normal_tail(z: Any) -> Any:
    """Return the probability that a standard normal number is above `z`."""
    return special.ndtr(-np.asarray(z, dtype=float))


def normal_of_tail(probability: Any) -> Any:
    """Return the number that a standard normal one is above with a probability."""
    return -special.ndtri(probability)


def student_tail(t: Any, degrees: Any) -> Any:
    """Return the probability that a Student t number is above `t`."""
    return special.stdtr(degrees, -np.asarray(t, dtype=float))


def student_below(t: Any, degrees: Any) -> Any:
    """Return the probability that a Student t number is below `t`."""
    return special.stdtr(degrees, t)


def student_quantile(share: Any, degrees: Any) -> Any:
    """Return the number below which a Student t one is with a probability `share`."""
    return special.stdtrit(degrees, share)


def student_log_density(t: Any, degrees: Any) -> Any:
    """Return the logarithm of a Student t number's density at `t`."""
    t = np.asarray(t, dtype=float)
    degrees = np.asarray(degrees, dtype=float)
    constant = np.log(special.poch(0.5 * degrees, 0.5)) - 0.5 * (np.log(degrees) + np.log(np.pi))
    return constant - (degrees + 1) / 2 * np.log1p(t * t / degrees)


def chi2_tail(x: Any, degrees: Any) -> Any:
    """Return the probability that a chi-square number is above `x`."""
    return special.chdtrc(degrees, x)


def chi2_of_tail(probability: Any, degrees: Any) -> Any:
    """Return the number that a chi-square one is above with a probability."""
    return special.chdtri(degrees, probability)


def chi2_quantile(share: Any, degrees: Any) -> Any:
    """Return the number below which a chi-square one is with a probability `share`."""
    return 2 * special.gammaincinv(np.asarray(degrees, dtype=float) / 2, share)
