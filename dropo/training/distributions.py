"""What parameters are drawn from at an episode's start: a fit, a point, bounds, or any of them
growing to its full width.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.random import Generator

from dropo.core.records.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array, float_array, require


class ParameterDistribution(Protocol):
    """A distribution over the parameters of `space`: every `Fit` is one."""

    @property
    def space(self) -> ParameterSpace:
        """The d parameters."""

    @property
    def mean(self) -> Array:
        """(d,) where a law that widens begins."""

    def sample(self, draws: int, rng: Generator) -> Array:
        """Independent parameter vectors (K, d)."""


@dataclass(frozen=True, eq=False)
class Point:
    """Always the same parameters `mean` (d,): the model without randomization."""

    space: ParameterSpace
    mean: Array

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "mean", float_array("mean", self.mean, (len(self.space),), "Point")
        )

    def sample(self, draws: int, rng: Generator) -> Array:
        """(K, d) copies."""
        return np.tile(self.mean, (draws, 1))


@dataclass(frozen=True, eq=False)
class Uniform:
    """Uniform randomization, each parameter on its own between low (d,) and high (d,); without
    bounds, on the search intervals.
    """

    space: ParameterSpace
    low: Array | None = None
    high: Array | None = None

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            given = getattr(self, name)
            values = (
                getattr(self.space, name)
                if given is None
                else float_array(name, given, (len(self.space),), "Uniform")
            )
            object.__setattr__(self, name, values)
        require(
            bool(np.all(self.bounds[0] <= self.bounds[1])),
            "low",
            "at most high",
            self.low,
            "Uniform",
        )

    @property
    def bounds(self) -> Array:
        """(2, d) low, then high."""
        return np.array([self.low, self.high])

    @property
    def mean(self) -> Array:
        """(d,) the middle."""
        return self.bounds.mean(axis=0)

    def sample(self, draws: int, rng: Generator) -> Array:
        """(K, d) independent draws."""
        low, high = self.bounds
        return low + rng.random((draws, len(self.space))) * (high - low)


@dataclass(frozen=True, eq=False)
class Curriculum:
    """A law that grows from a share `start` of its width to all of it over the first so many
    control `steps` of training.
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
        """(d,) that of the law."""
        return self.distribution.mean

    def sample(self, draws: int, rng: Generator) -> Array:
        """(K, d) draws at its full width."""
        return self.distribution.sample(draws, rng)

    def share(self, done: int) -> float:
        """The share of the width after so many control steps."""
        return self.start + (1 - self.start) * min(1.0, done / self.steps)


def full(distribution: ParameterDistribution | None) -> ParameterDistribution | None:
    """The law at its full width."""
    return distribution.distribution if isinstance(distribution, Curriculum) else distribution


def draw(distribution: ParameterDistribution, rng: Generator, done: int) -> Array:
    """(d,) one parameter vector, after `done` control steps of training."""
    value = distribution.sample(1, rng)[0]
    return (
        distribution.mean + distribution.share(done) * (value - distribution.mean)
        if isinstance(distribution, Curriculum)
        else value
    )


def variances_of(distribution: ParameterDistribution) -> Array | None:
    """(p,) the noise variances that a fit learned; None where the law is no fit."""
    return (
        variances_of(distribution.distribution)
        if isinstance(distribution, Curriculum)
        else getattr(distribution, "epsilon", None)
    )


def places_of(distribution: ParameterDistribution) -> dict[str, dict[str, Any]]:
    """Where in a model each parameter is, as a fit keeps it; effects and parameters of other
    simulators have none.
    """
    if isinstance(distribution, Curriculum):
        return places_of(distribution.distribution)
    own = {p.name: place for p in distribution.space if (place := p.place)}
    return {**(distribution.places if isinstance(distribution, Fit) else {}), **own}
