"""Priors of single parameters, in the parameters' own units.

A prior is a frozen distribution of scipy.stats, or a short text such as "normal(3.5, 0.2)".
"""

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, known, require

Prior = str | Any
"""A text, or a frozen continuous distribution of scipy.stats (which has no type of its own)."""
# Step of central differences, in interquartile ranges.
STEP = float(np.finfo(float).eps ** (1 / 3))
SMALLEST_MASS = 1e-9
"""A prior with less of its mass in the search interval is refused."""


def _of_scipy(name: str, *numbers: Any, **named: Any) -> Any:
    """A frozen distribution of scipy.stats, which is imported where there are priors alone."""
    from scipy import stats

    return getattr(stats, name)(*numbers, **named)


DISTRIBUTIONS: dict[str, tuple[tuple[str, ...], Callable[..., Any]]] = {
    "normal": (("mean", "sd"), lambda mean, sd: _of_scipy("norm", mean, sd)),
    "lognormal": (
        ("mean of the logarithm", "sd of the logarithm"),
        lambda mean, sd: _of_scipy("lognorm", sd, scale=np.exp(mean)),
    ),
    "halfnormal": (("scale",), lambda scale: _of_scipy("halfnorm", scale=scale)),
    "uniform": (("low", "high"), lambda low, high: _of_scipy("uniform", low, high - low)),
}
"""The names that a text can begin with: the numbers in its brackets, and the distribution."""
TEXT = re.compile(r"\s*([a-z]+)\s*(?:\(([^()]*)\))?\s*")
EXAMPLES = "a name with numbers in brackets, such as normal(3.5, 0.2)"


def read_prior(prior: Prior, parameter: Parameter) -> Any:
    """Make the frozen distribution of a parameter's prior.

    Parameters
    ----------
    prior : str or frozen scipy.stats distribution
        "uniform" alone is uniform on the search interval.
    parameter : Parameter
        Whose prior it is.

    Returns
    -------
    frozen scipy.stats distribution
        In the parameter's unit.

    Raises
    ------
    UnknownName
        If a text begins with another name.
    BadArgument
        If it is no continuous distribution of one number, its numbers make no density, or it has
        no mass in the search interval.
    """
    caller = f"prior of {parameter.name!r}"
    distribution = _from_text(prior, parameter) if isinstance(prior, str) else prior
    frozen = hasattr(distribution, "logpdf") and hasattr(distribution, "dist")
    univariate = frozen and np.ndim(distribution.mean()) == 0
    rule = "a text such as 'normal(3.5, 0.2)' or a frozen continuous distribution of scipy.stats"
    require(univariate, "law", rule, prior, caller)
    # Either difference may round to 0 in the tail of the distribution.
    low = parameter.low
    high = parameter.high
    mass = max(
        distribution.cdf(high) - distribution.cdf(low),
        distribution.sf(low) - distribution.sf(high),
    )
    rule = f"one with mass in the search interval [{low:g}, {high:g}]"
    require(bool(mass > SMALLEST_MASS), "law", rule, describe(prior), caller)
    return distribution


def _from_text(text: str, parameter: Parameter) -> Any:
    """The distribution that a text names."""
    caller = f"prior of {parameter.name!r}"
    match = TEXT.fullmatch(text)
    require(match is not None, "law", EXAMPLES, text, caller)
    assert match is not None
    name = match[1]
    arguments = match[2]
    takes, make = DISTRIBUTIONS[known("prior", name, DISTRIBUTIONS)]
    if name == "uniform" and arguments is None:
        return make(parameter.low, parameter.high)
    try:
        numbers = [float(number) for number in (arguments or "").split(",")]
    except ValueError:
        numbers = []
    rule = f"{name}({', '.join(takes)}), in numbers"
    complete = len(numbers) == len(takes) and bool(np.isfinite(numbers).all())
    require(complete, "law", rule, text, caller)
    distribution = make(*numbers)
    if not np.isfinite(distribution.median()):
        raise BadArgument(
            f"The 'law' of {caller} must be {rule} that make a density: widths above 0. "
            f"Got {text!r} instead."
        )
    return distribution


def describe(prior: Prior) -> str:
    """Describe a prior as a text, the same for the same prior.

    Parameters
    ----------
    prior : str or frozen scipy.stats distribution
        The prior.

    Returns
    -------
    str
        The text itself, or the distribution's name with its numbers.
    """
    if isinstance(prior, str):
        return prior
    numbers = [repr(value) for value in prior.args]
    named = [f"{name}={value!r}" for name, value in prior.kwds.items()]
    return f"{prior.dist.name}({', '.join([*numbers, *named])})"


class LogPrior:
    """The log density of independent priors over the unit box of a space, up to a constant.

    It is flat in parameters without a prior. A prior is a density in the parameter's own unit;
    where the box is one in logarithms, d value / d unit coordinate is proportional to the value,
    and the density over the box has this factor.

    Parameters
    ----------
    priors : mapping of str to Prior
        Priors by the names of the space's parameters.
    space : ParameterSpace
        The m parameters.

    Attributes
    ----------
    distributions : dict of int to frozen scipy.stats distribution
        The priors by the parameter's place in the space.

    Raises
    ------
    UnknownName
        If there is a prior of a parameter that does not exist.
    BadArgument
        If a prior is not valid; see `read_prior`.
    """

    def __init__(self, priors: Mapping[str, Prior], space: ParameterSpace):
        self.space = space
        for name in priors:
            known("unknown with a prior", name, space.names)
        self.distributions = {
            space.names.index(name): read_prior(prior, space[name])
            for name, prior in priors.items()
        }

    def __call__(self, points: Array) -> Array:
        """Log densities (W,) at points (W, m), in the parameters' own units."""
        out = np.zeros(len(points))
        for i, distribution in self.distributions.items():
            values = points[:, i]
            by_box = np.log(values) if self.space.is_log[i] else 0.0
            out += distribution.logpdf(values) + by_box
        return out

    def gradient(self, points: Array) -> Array:
        """Differentiate the log density by the parameters in their own units.

        Parameters
        ----------
        points : (W, m) array
            Parameter vectors, in the parameters' own units.

        Returns
        -------
        (W, m) array
            In nats per unit of each parameter; 0 for one without a prior.
        """
        out = np.zeros(points.shape)
        for i, distribution in self.distributions.items():
            values = points[:, i]
            by_box = 1 / values if self.space.is_log[i] else 0.0
            out[:, i] = slope(distribution, values) + by_box
        return out


def slope(distribution: Any, x: Array) -> Array:
    """Differentiate a log density by central differences.

    Parameters
    ----------
    distribution : frozen scipy.stats distribution
    x : (n,) array
        Where.

    Returns
    -------
    (n,) array
        One-sided at the ends of the support, and 0 outside.
    """
    step = STEP * (distribution.ppf(0.75) - distribution.ppf(0.25))
    below, here, above = (distribution.logpdf(at) for at in (x - step, x, x + step))
    low = np.isfinite(below)
    high = np.isfinite(above)
    with np.errstate(invalid="ignore"):
        rise = np.where(high, above, here) - np.where(low, below, here)
        sides = np.maximum(low.astype(float) + high, 1)
        return np.where(np.isfinite(here) & (low | high), rise / (step * sides), 0.0)
