"""Distributions that parameters are drawn from at an episode's start."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.random import Generator

from dropo.core.records.fits.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array, float_array, require


class ParameterDistribution(Protocol):
    """A distribution over the parameters of `space`: every `Fit` is one."""

    @property
    def space(self) -> ParameterSpace:
        """The d parameters."""

    @property
    def mean(self) -> Array:
        """The mean (d,), at which a curriculum begins."""

    def sample(self, draws: int, rng: Generator) -> Array:
        """Draw independent parameter vectors.

        Parameters
        ----------
        draws : int
            Number K of vectors.
        rng : numpy.random.Generator
            What random numbers come from.

        Returns
        -------
        (K, d) array
            In the parameters' units.
        """


@dataclass(frozen=True, eq=False)
class Point:
    """Always the same parameters: the model without randomization.

    Attributes
    ----------
    space : ParameterSpace
        The d parameters.
    mean : (d,) array
        Their values.

    Raises
    ------
    BadArgument
        If `mean` has another shape or is not finite.
    """

    space: ParameterSpace
    mean: Array

    def __post_init__(self) -> None:
        mean = float_array("mean", self.mean, (len(self.space),), "Point")
        object.__setattr__(self, "mean", mean)

    def sample(self, draws: int, rng: Generator) -> Array:
        """Draw parameter vectors.

        Parameters
        ----------
        draws : int
            How many, K.
        rng : numpy.random.Generator
            Draws them.

        Returns
        -------
        (K, d) array
            Copies of the mean.
        """
        return np.tile(self.mean, (draws, 1))


@dataclass(frozen=True, eq=False)
class Uniform:
    """Uniform randomization of each parameter by itself.

    Attributes
    ----------
    space : ParameterSpace
        The d parameters.
    low, high : (d,) array, optional
        Bounds of each parameter, by default those of its search interval.

    Raises
    ------
    BadArgument
        If a bound has another shape or is not finite, or if `low` exceeds `high`.
    """

    space: ParameterSpace
    low: Array | None = None
    high: Array | None = None

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            values = getattr(self, name)
            if values is None:
                values = getattr(self.space, name)
            else:
                values = float_array(name, values, (len(self.space),), "Uniform")
            object.__setattr__(self, name, values)
        low, high = self.bounds
        require(bool(np.all(low <= high)), "low", "at most high", self.low, "Uniform")

    @property
    def bounds(self) -> Array:
        """The lower bounds, then the upper ones (2, d)."""
        return np.array([self.low, self.high])

    @property
    def mean(self) -> Array:
        """The middle of the bounds (d,)."""
        return self.bounds.mean(axis=0)

    def sample(self, draws: int, rng: Generator) -> Array:
        """Draw parameter vectors.

        Parameters
        ----------
        draws : int
            How many, K.
        rng : numpy.random.Generator
            Draws them.

        Returns
        -------
        (K, d) array
            Independent draws.
        """
        low, high = self.bounds
        return low + rng.random((draws, len(self.space))) * (high - low)


@dataclass(frozen=True, eq=False)
class Predictive:
    """A fit's distribution, with what is not known of its means added to its spread.

    Attributes
    ----------
    fit : Fit
        Whose means have standard errors; one without adds nothing.
    """

    fit: Fit

    @property
    def space(self) -> ParameterSpace:
        """The d parameters."""
        return self.fit.space

    @property
    def mean(self) -> Array:
        """The means (d,)."""
        return self.fit.mean

    def sample(self, draws: int, rng: Generator) -> Array:
        """Draw parameter vectors.

        Parameters
        ----------
        draws : int
            How many, K.
        rng : numpy.random.Generator
            Draws them.

        Returns
        -------
        (K, d) array
            Independent draws, all physically possible.
        """
        values = self.fit.sample(draws, rng)
        errors = np.nan_to_num(self.fit.mean_se)
        return self.space.feasible(values + errors * rng.standard_normal(values.shape))


def predictive(distribution: ParameterDistribution) -> ParameterDistribution:
    """Add to a fit's spread what is not known of its means.

    Parameters
    ----------
    distribution : ParameterDistribution
        Any.

    Returns
    -------
    ParameterDistribution
        The given one, if it is no fit, or a posterior of parameters, whose spread is just that.
    """
    if isinstance(distribution, Fit) and not distribution.parameters_are_constant:
        return Predictive(distribution)
    return distribution


@dataclass(frozen=True, eq=False)
class Curriculum:
    """A distribution whose width grows during training.

    Attributes
    ----------
    distribution : ParameterDistribution
        The distribution at its full width.
    steps : int
        Number of control steps of training after which the full width is reached.
    start : float
        Width at the beginning of training, as a fraction in [0, 1] of the full one.

    Raises
    ------
    BadArgument
        If `steps` is below 1 or `start` is not in [0, 1].
    """

    distribution: ParameterDistribution
    steps: int
    start: float = 0.0

    def __post_init__(self) -> None:
        require(self.steps >= 1, "steps", "at least 1", self.steps, "Curriculum")
        require(0 <= self.start <= 1, "start", "a share from 0 to 1", self.start, "Curriculum")

    @property
    def space(self) -> ParameterSpace:
        """The d parameters."""
        return self.distribution.space

    @property
    def mean(self) -> Array:
        """The mean (d,) of the distribution, at any width."""
        return self.distribution.mean

    def sample(self, draws: int, rng: Generator) -> Array:
        """Draw parameter vectors.

        Parameters
        ----------
        draws : int
            How many, K.
        rng : numpy.random.Generator
            Draws them.

        Returns
        -------
        (K, d) array
            Independent draws at the full width.
        """
        return self.distribution.sample(draws, rng)

    def fraction(self, done: int) -> float:
        """Compute how wide the distribution is in the course of training.

        Parameters
        ----------
        done : int
            Control steps of training so far.

        Returns
        -------
        float
            Fraction of the full width, from `start` to 1.
        """
        return self.start + (1 - self.start) * min(1.0, done / self.steps)


def full_width(distribution: ParameterDistribution) -> ParameterDistribution:
    """Find what a curriculum grows to, and the fit of a predictive distribution.

    Parameters
    ----------
    distribution : ParameterDistribution
        Any.

    Returns
    -------
    ParameterDistribution
        Itself where it is neither of them.
    """
    if isinstance(distribution, Curriculum):
        return full_width(distribution.distribution)
    return distribution.fit if isinstance(distribution, Predictive) else distribution


def draw(distribution: ParameterDistribution, rng: Generator, done: int) -> Array:
    """Draw one parameter vector.

    Parameters
    ----------
    distribution : ParameterDistribution
        What is drawn from.
    rng : numpy.random.Generator
        Source of the random numbers.
    done : int
        Control steps of training so far, on which the width of a curriculum depends.

    Returns
    -------
    (d,) array
        The parameters.
    """
    value = distribution.sample(1, rng)[0]
    if not isinstance(distribution, Curriculum):
        return value
    mean = distribution.mean
    return mean + distribution.fraction(done) * (value - mean)


def variances_of(distribution: ParameterDistribution) -> Array | None:
    """Find the noise that a fit learned.

    Parameters
    ----------
    distribution : ParameterDistribution
        Any.

    Returns
    -------
    (p,) array or None
        Variances in the signals' units squared; None for what is no fit.
    """
    whole = full_width(distribution)
    return whole.epsilon if isinstance(whole, Fit) else None


def places_of(distribution: ParameterDistribution) -> dict[str, dict[str, Any]]:
    """Find where in a model each parameter is.

    A fit keeps these. Magnitudes of effects and parameters of other simulators have no place.

    Parameters
    ----------
    distribution : ParameterDistribution
        Any.

    Returns
    -------
    dict of str to dict
        Field, element and index by parameter name.
    """
    distribution = full_width(distribution)
    own = {p.name: place for p in distribution.space if (place := p.place)}
    return {**(distribution.places if isinstance(distribution, Fit) else {}), **own}
