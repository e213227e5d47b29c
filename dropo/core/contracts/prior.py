"""Priors of single parameters, in the parameters' own units: a scipy.stats distribution, or a short
text such as "normal(3.5, 0.2)".
"""

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy import stats

from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument
from dropo.core.services.validation import Array, known, require

Prior = (
    str | Any
)  # a text, or a frozen continuous distribution of scipy.stats (which has no type of its own)
STEP = float(np.finfo(float).eps ** (1 / 3))  # of central differences, in interquartile ranges
LEAST_MASS = 1e-9  # a prior with less of its mass inside the box has none there

LAWS: dict[str, tuple[tuple[str, ...], Callable[..., Any]]] = {
    "normal": (("mean", "sd"), lambda mean, sd: stats.norm(mean, sd)),
    "lognormal": (
        ("mean of the logarithm", "sd of the logarithm"),
        lambda mean, sd: stats.lognorm(sd, scale=np.exp(mean)),
    ),
    "halfnormal": (("scale",), lambda scale: stats.halfnorm(scale=scale)),
    "uniform": (("low", "high"), lambda low, high: stats.uniform(low, high - low)),
}
"""The texts' names: what stands in their brackets, and the distribution."""
TEXT = re.compile(r"\s*([a-z]+)\s*(?:\(([^()]*)\))?\s*")


def read_prior(prior: Prior, parameter: Parameter) -> Any:
    """The frozen distribution of a parameter's prior; "uniform" alone is uniform on the search
    interval.
    """
    caller = f"prior of {parameter.name!r}"
    distribution = _from_text(prior, parameter) if isinstance(prior, str) else prior
    kind = "a text such as 'normal(3.5, 0.2)' or a frozen continuous distribution of scipy.stats"
    require(
        hasattr(distribution, "logpdf")
        and hasattr(distribution, "dist")
        and np.ndim(distribution.mean()) == 0,
        "law",
        kind,
        prior,
        caller,
    )
    inside = max(
        distribution.cdf(parameter.high) - distribution.cdf(parameter.low),
        distribution.sf(parameter.low) - distribution.sf(parameter.high),
    )
    interval = f"one with mass in the search interval [{parameter.low:g}, {parameter.high:g}]"
    require(bool(inside > LEAST_MASS), "law", interval, describe(prior), caller)
    return distribution


def _from_text(text: str, parameter: Parameter) -> Any:
    caller = f"prior of {parameter.name!r}"
    found = TEXT.fullmatch(text)
    require(
        found is not None,
        "law",
        "a name with numbers in brackets, such as normal(3.5, 0.2)",
        text,
        caller,
    )
    assert found is not None
    takes, make = LAWS[known("prior", found[1], LAWS)]
    if found[1] == "uniform" and found[2] is None:
        return make(parameter.low, parameter.high)
    try:
        numbers = [float(number) for number in (found[2] or "").split(",")]
    except ValueError:
        numbers = []
    rule = f"{found[1]}({', '.join(takes)}), in numbers"
    require(
        len(numbers) == len(takes) and bool(np.isfinite(numbers).all()), "law", rule, text, caller
    )
    distribution = make(*numbers)
    if not np.isfinite(distribution.median()):
        raise BadArgument(
            f"The 'law' of {caller} must be {rule} that make a density: widths above 0. "
            f"Got {text!r} instead."
        )
    return distribution


def describe(prior: Prior) -> str:
    """A prior as a text, the same for the same one."""
    if isinstance(prior, str):
        return prior
    numbers = [f"{value!r}" for value in prior.args] + [
        f"{name}={value!r}" for name, value in prior.kwds.items()
    ]
    return f"{prior.dist.name}({', '.join(numbers)})"


class LogPrior:
    """The log density of independent priors over the unit box of a space, up to a constant; flat
    there where none is given.

    priors: by the names of the space's parameters. A prior is a density in the parameter's own
    unit; where the box is one in logarithms, d value / d unit coordinate is proportional to the
    value, and the density over the box carries it.
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
        """(W, m) -> (W,)."""
        out = np.zeros(len(points))
        for i, distribution in self.distributions.items():
            out += distribution.logpdf(points[:, i]) + (
                np.log(points[:, i]) if self.space.is_log[i] else 0.0
            )
        return out

    def gradient(self, points: Array) -> Array:
        """(W, m), by the parameters in their own units."""
        out = np.zeros(points.shape)
        for i, distribution in self.distributions.items():
            out[:, i] = _slope(distribution, points[:, i]) + (
                1 / points[:, i] if self.space.is_log[i] else 0.0
            )
        return out


def _slope(distribution: Any, x: Array) -> Array:
    """D log density / dx by central differences; from one side at the ends of the law's support, 0
    outside.
    """
    step = STEP * (distribution.ppf(0.75) - distribution.ppf(0.25))
    below, here, above = (distribution.logpdf(at) for at in (x - step, x, x + step))
    low = np.isfinite(below)
    high = np.isfinite(above)
    with np.errstate(invalid="ignore"):
        rise = np.where(high, above, here) - np.where(low, below, here)
        return np.where(
            np.isfinite(here) & (low | high),
            rise / (step * np.maximum(low.astype(float) + high, 1)),
            0.0,
        )
