"""Tails, quantiles and densities of a few distributions, bit for bit those of scipy.stats.

Its import takes longer than a small fit, and these are all that a fit asks of it.
"""

from typing import Any

import numpy as np
from scipy import special


def normal_tail(z: Any) -> Any:
    """Return the probability that a standard normal number is above `z`.

    Parameters
    ----------
    z : array_like
        Standard normal numbers.

    Returns
    -------
    array
        P(Z > z), accurate where it is very small.
    """
    return special.ndtr(-np.asarray(z, dtype=float))


def normal_of_tail(probability: Any) -> Any:
    """Return the number that a standard normal one is above with a probability.

    Parameters
    ----------
    probability : array_like
        From 0 to 1.

    Returns
    -------
    array
        z with P(Z > z) as given.
    """
    return -special.ndtri(probability)


def student_tail(t: Any, degrees: Any) -> Any:
    """Return the probability that a Student t number is above `t`.

    Parameters
    ----------
    t : array_like
        Student t numbers.
    degrees : array_like
        Degrees of freedom; it broadcasts with `t`.

    Returns
    -------
    array
        P(T > t).
    """
    return special.stdtr(degrees, -np.asarray(t, dtype=float))


def student_below(t: Any, degrees: Any) -> Any:
    """Return the probability that a Student t number is below `t`.

    Parameters
    ----------
    t : array_like
        Student t numbers.
    degrees : array_like
        Degrees of freedom; it broadcasts with `t`.

    Returns
    -------
    array
        P(T < t).
    """
    return special.stdtr(degrees, t)


def student_quantile(share: Any, degrees: Any) -> Any:
    """Return the number below which a Student t one is with a probability.

    Parameters
    ----------
    share : array_like
        The probability, from 0 to 1.
    degrees : array_like
        Degrees of freedom; it broadcasts with `share`.

    Returns
    -------
    array
        t with P(T < t) as given.
    """
    return special.stdtrit(degrees, share)


def student_log_density(t: Any, degrees: Any) -> Any:
    """Return the logarithm of the density of Student's t distribution.

    Parameters
    ----------
    t : array_like
        Where it is evaluated.
    degrees : array_like
        Degrees of freedom; it broadcasts with `t`.

    Returns
    -------
    array
        In nats.
    """
    t = np.asarray(t, dtype=float)
    degrees = np.asarray(degrees, dtype=float)
    constant = np.log(special.poch(0.5 * degrees, 0.5)) - 0.5 * (np.log(degrees) + np.log(np.pi))
    return constant - (degrees + 1) / 2 * np.log1p(t * t / degrees)


def chi2_tail(x: Any, degrees: Any) -> Any:
    """Return the probability that a chi-square number is above `x`.

    Parameters
    ----------
    x : array_like
        Chi-square numbers, at least 0.
    degrees : array_like
        Degrees of freedom; it broadcasts with `x`.

    Returns
    -------
    array
        P(X > x).
    """
    return special.chdtrc(degrees, x)


def chi2_of_tail(probability: Any, degrees: Any) -> Any:
    """Return the number that a chi-square one is above with a probability.

    Parameters
    ----------
    probability : array_like
        From 0 to 1.
    degrees : array_like
        Degrees of freedom; it broadcasts with `probability`.

    Returns
    -------
    array
        x with P(X > x) as given.
    """
    return special.chdtri(degrees, probability)


def chi2_quantile(share: Any, degrees: Any) -> Any:
    """Return the number below which a chi-square one is with a probability.

    Parameters
    ----------
    share : array_like
        The probability, from 0 to 1.
    degrees : array_like
        Degrees of freedom; it broadcasts with `share`.

    Returns
    -------
    array
        x with P(X < x) as given.
    """
    return 2 * special.gammaincinv(np.asarray(degrees, dtype=float) / 2, share)
