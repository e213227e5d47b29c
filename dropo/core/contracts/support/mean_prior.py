"""The priors of a problem in a search for one best point: a density of the means, beside the data.

A fit then maximises log-likelihood + log prior of the means (maximum a posteriori). The prior is
the density in each parameter's own unit, however the parameter is searched.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import LocalLogLikelihood, LogLikelihood
from dropo.core.contracts.prior import Prior, read_prior, slope
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array

# Step of the second differences of a log density, in interquartile ranges.
STEP = 1e-3


class MeanPrior:
    """The log prior of the means of d parameters, with its slope and its curvature.

    Parameters
    ----------
    priors : mapping of str to Prior
        By the names of the parameters; the others are flat.
    space : ParameterSpace
        The d parameters.

    Attributes
    ----------
    within : ParameterSpace
        The same, their search intervals cut to where the priors have a density.

    Raises
    ------
    UnknownName, BadArgument
        As of `read_prior`.
    """

    def __init__(self, priors: Mapping[str, Prior], space: ParameterSpace):
        self.space = space
        self.distributions = {
            space.names.index(name): read_prior(prior, space[name])
            for name, prior in priors.items()
        }
        self.within = space
        if self.distributions:
            self.within = ParameterSpace(tuple(map(self._cut, range(len(space)), space)))

    def _cut(self, place: int, parameter: Parameter) -> Parameter:
        """A parameter within the ends of its prior."""
        if place not in self.distributions:
            return parameter
        low, high = self.distributions[place].support()
        return replace(
            parameter, low=max(parameter.low, float(low)), high=min(parameter.high, float(high))
        )

    def __bool__(self) -> bool:
        """Whether there is a prior at all."""
        return bool(self.distributions)

    def value(self, mean: Array) -> float:
        """Evaluate the log density of means.

        Parameters
        ----------
        mean : (d,) array
            In the parameters' units.

        Returns
        -------
        float
            In nats; the sum over the parameters that have a prior, -inf outside its ends.
        """
        return float(
            sum(distribution.logpdf(mean[i]) for i, distribution in self.distributions.items())
        )

    def score(self, mean: Array) -> Array:
        """Differentiate the log density by the means.

        Parameters
        ----------
        mean : (d,) array
            In the parameters' units.

        Returns
        -------
        (d,) array
            In nats per unit of each parameter; 0 where it has no prior.
        """
        out = np.zeros(len(self.space))
        for i, distribution in self.distributions.items():
            out[i] = slope(distribution, mean[i : i + 1])[0]
        return out

    def information(self, mean: Array) -> Array:
        """Find the curvature -d^2 log p / d mean^2 by central differences.

        Parameters
        ----------
        mean : (d,) array
            In the parameters' units.

        Returns
        -------
        (d,) array
            In nats per squared unit; 0 without a prior, and where the log density is convex or not
            finite.
        """
        out = np.zeros(len(self.space))
        for i, distribution in self.distributions.items():
            step = STEP * (distribution.ppf(0.75) - distribution.ppf(0.25))
            below, here, above = distribution.logpdf(mean[i] + step * np.array([-1.0, 0.0, 1.0]))
            if np.isfinite([below, here, above]).all():
                out[i] = max((2 * here - below - above) / step**2, 0.0)
        return out

    def as_normal(self, mean: Array) -> tuple[Array, Array]:
        """Find the normal prior of the same slope at means (d,), for Gauss-Newton steps.

        Parameters
        ----------
        mean : (d,) array

        Returns
        -------
        centre : (d,) array
            Its means; where there is no prior, the mean itself.
        precision : (d,) array
            Its curvature; where the density has less, so much that its centre is within a search
            interval of the mean.
        """
        score = self.score(mean)
        least = np.abs(score) / (self.space.high - self.space.low)
        precision = np.maximum(self.information(mean), least)
        step = np.divide(score, precision, out=np.zeros_like(score), where=precision > 0)
        return mean + step, precision


def within_prior(family: Family, prior: MeanPrior) -> Family:
    """Bound the means of a family's members by the ends of a prior; scales stay as they are.

    Parameters
    ----------
    family : Family
        Changed in place.
    prior : MeanPrior

    Returns
    -------
    Family
        The same one.
    """
    if not prior:
        return family
    ends = {f"mean.{parameter.name}": parameter for parameter in prior.within}
    bounded = []
    for unknown in family.unknowns:
        own = ends.get(unknown.name, unknown)
        low, high = max(unknown.low, own.low), min(unknown.high, own.high)
        bounded.append(replace(unknown, low=low, high=high))
    family.unknowns = ParameterSpace(tuple(bounded))
    return family


def with_prior(objective: LogLikelihood, prior: MeanPrior | None) -> LogLikelihood:
    """Make what a search maximises: the log-likelihood, and the log prior where there is one.

    Parameters
    ----------
    objective : LogLikelihood
        Whose unknowns "mean.x" have the prior.
    prior : MeanPrior or None

    Returns
    -------
    LogLikelihood
        The objective itself without a prior.
    """
    return WithPrior(objective, prior) if prior else objective


def local_with_prior(objective: LocalLogLikelihood, prior: MeanPrior | None) -> LocalLogLikelihood:
    """Make the same of a local log-likelihood, with its scores and information; see `with_prior`.

    Parameters
    ----------
    objective : LocalLogLikelihood
    prior : MeanPrior or None

    Returns
    -------
    LocalLogLikelihood
        The objective itself without a prior.
    """
    return WithPrior(objective, prior) if prior else objective


def mean_places(objective: LogLikelihood, space: ParameterSpace) -> Ints:
    """Find the places of the means among the unknowns of an objective.

    Parameters
    ----------
    objective : LogLikelihood
        Its unknowns have a name "mean.x" for each parameter x.
    space : ParameterSpace
        The d parameters.

    Returns
    -------
    (d,) array of int
        The place of "mean.x" in `objective.unknowns`, in the order of the space.
    """
    names = objective.unknowns.names
    return np.array([names.index(f"mean.{name}") for name in space.names])


class WithPrior(LocalLogLikelihood):
    """A log-likelihood with the log prior of the means as one more row.

    Parameters
    ----------
    objective : LogLikelihood
        A local one for scores and information.
    prior : MeanPrior
    """

    def __init__(self, objective: LogLikelihood, prior: MeanPrior):
        self.objective = objective
        self.prior = prior
        self.unknowns = objective.unknowns
        self.has_gradients = objective.has_gradients
        self.simulator = objective.simulator
        self.places = mean_places(objective, prior.space)

    def _rows(self, phi: Array) -> Array:
        """The rows' log densities, then the prior's (R + 1,)."""
        return np.append(self.objective.rows(phi), self.prior.value(phi[self.places]))

    def gradient(self, phi: Array) -> Array:  # type: ignore[override]
        """The gradients of both together."""
        out = self.objective.gradient(phi).copy()
        out[self.places] += self.prior.score(phi[self.places])
        return out

    def value_score_information(self, phi: Array) -> tuple[float, Array, Array]:
        """Those of the likelihood, with a row of scores and a curvature of the prior."""
        assert isinstance(self.objective, LocalLogLikelihood)
        value, scores, information = self.objective.value_score_information(phi)
        mean = phi[self.places]
        own = np.zeros(len(phi))
        own[self.places] = self.prior.score(mean)
        curvature = np.zeros(len(phi))
        curvature[self.places] = self.prior.information(mean)
        return (
            value + self.prior.value(mean),
            np.concatenate([scores, own[None]]),
            information + np.diag(curvature),
        )

    def epsilon(self, phi: Array) -> Array:
        """Give the objective's noise variances: a prior says nothing of noise."""
        return self.objective.epsilon(phi)

    def mean(self, phi: Array) -> Array:
        """Give the objective's mean prediction: a prior changes no prediction."""
        return self.objective.mean(phi)

    def predict(self, values: Array) -> Array:
        """Give the predictions of the objective's local model."""
        assert isinstance(self.objective, LocalLogLikelihood)
        return self.objective.predict(values)
