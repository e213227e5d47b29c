"""What is sampled: log-likelihoods of many phi at once, and their sum with a prior."""

from dataclasses import replace
from typing import Protocol

import numpy as np

from dropo.core.contracts.likelihood import LocalLogLikelihood, LogLikelihood
from dropo.core.contracts.noise import Epsilon, NoiseModel
from dropo.core.contracts.prior import LogPrior
from dropo.core.contracts.problem import Problem
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array


class BatchedLogLikelihood(Protocol):
    """A log-likelihood of many phi (m,) at once.

    Attributes
    ----------
    unknowns : ParameterSpace
        Of the m numbers of phi.
    """

    unknowns: ParameterSpace

    def many(self, phi: Array) -> Array:
        """Evaluate the log-likelihood at many points.

        Parameters
        ----------
        phi : (W, m) array
            W numbers phi, each in the order of `unknowns`.

        Returns
        -------
        (W,) array
            In nats.
        """

    def epsilon(self, phi: Array) -> Array:
        """Give the noise variances at one point.

        Parameters
        ----------
        phi : (m,) array
            In the order of `unknowns`.

        Returns
        -------
        (p,) array
            In squared signal units.
        """

    def mean(self, phi: Array) -> Array:
        """Predict the compared rows' mean at one point.

        Parameters
        ----------
        phi : (m,) array
            In the order of `unknowns`.

        Returns
        -------
        (R, p) array
            In the signals' units.
        """


class PointLikelihood:
    """The Gaussian likelihood of parameters that are the same in all rows.

    Parameters
    ----------
    problem : Problem
    epsilon : Epsilon
        The noise variances, given or learned.

    Raises
    ------
    BadArgument
        If a variance is 0.
    Incompatible
        If the noise is on the start states too, or is no Gaussian.

    Notes
    -----
    log p(data | xi, epsilon) is the sum over the rows of
    log N(target; prediction under xi, diag(epsilon)).
    """

    def __init__(self, problem: Problem, epsilon: Epsilon):
        self.simulator = problem.simulator
        self.segments = problem.segments
        self.size = len(problem.space)
        self.targets = self.simulator.targets(self.segments)
        noise = NoiseModel(epsilon, self.targets.shape[1])
        self.noise = noise.positive("a posterior").plain("A posterior without likelihood")
        self.unknowns = ParameterSpace((*problem.space, *self.noise.unknowns))

    def many(self, phi: Array) -> Array:
        """Evaluate the log-likelihood at many points, with one batch of simulations.

        Parameters
        ----------
        phi : (W, m) array
            Parameters, then the numbers of the noise.

        Returns
        -------
        (W,) array
            In nats; NaN where a simulation failed.
        """
        variance = np.array([self.epsilon(p) for p in phi])[:, None]  # (W, 1, p)
        predictions = self.simulator.predict(phi[:, : self.size], self.segments)
        errors = predictions - self.targets  # (W, R, p)
        density = errors**2 / variance + np.log(2 * np.pi * variance)
        return np.asarray(-0.5 * density.sum(axis=(1, 2)))

    def epsilon(self, phi: Array) -> Array:
        """Give the noise variances at one point.

        Parameters
        ----------
        phi : (m,) array
            Parameters, then the numbers of the noise.

        Returns
        -------
        (p,) array
            In squared signal units.
        """
        return self.noise.epsilon(phi[self.size :])

    def mean(self, phi: Array) -> Array:
        """Predict the compared rows at one point.

        Parameters
        ----------
        phi : (m,) array
            Parameters, then the numbers of the noise.

        Returns
        -------
        (R, p) array
            In the signals' units; NaN where the simulation failed.
        """
        prediction: Array = self.simulator.predict(phi[None, : self.size], self.segments)[0]
        return prediction


class OneByOne:
    """A log-likelihood of a family's members, evaluated for many of them in turn.

    Parameters
    ----------
    bound : LogLikelihood
        The likelihood of one member.
    """

    def __init__(self, bound: LogLikelihood):
        self.bound = bound
        self.unknowns = bound.unknowns
        self.epsilon = bound.epsilon
        self.mean = bound.mean

    def many(self, phi: Array) -> Array:
        """Evaluate the log-likelihood at one point after the other.

        Parameters
        ----------
        phi : (W, m) array
            W numbers phi, each in the order of `unknowns`.

        Returns
        -------
        (W,) array
            In nats.
        """
        return np.array([self.bound(p) for p in phi])

    def rows(self, phi: Array) -> Array:
        """Evaluate the log density of each compared row.

        Parameters
        ----------
        phi : (W, m) array
            W numbers phi, each in the order of `unknowns`.

        Returns
        -------
        (W, R) array
            In nats.
        """
        return np.array([self.bound.rows(p) for p in phi])


class Local(OneByOne):
    """A local log-likelihood of a family's members, with gradients if it has them.

    Parameters
    ----------
    bound : LocalLogLikelihood
        The likelihood of one member.
    best : (m,) array
        A point near its maximum.
    """

    def __init__(self, bound: LocalLogLikelihood, best: Array):
        super().__init__(bound)
        self.bound: LocalLogLikelihood = bound
        self.best = self.unknowns.clip(best)

    def value_score_information(self, phi: Array) -> tuple[Array, Array]:
        """Evaluate the log-likelihood with its gradient at many points.

        Parameters
        ----------
        phi : (W, m) array
            W numbers phi, each in the order of `unknowns`.

        Returns
        -------
        values : (W,) array
            In nats.
        gradients : (W, m) array
            d value / d phi.
        """
        values = []
        gradients = []
        for p in phi:
            value, scores, _ = self.bound.value_score_information(p)
            values.append(value)
            gradients.append(scores.sum(axis=0))
        return np.array(values), np.array(gradients)

    def rename(self, space: ParameterSpace) -> None:
        """Call the unknowns "mean.x" of a family without spread by the parameters x themselves.

        Parameters
        ----------
        space : ParameterSpace
            The parameters, whose scales the unknowns get too.
        """
        own = []
        for unknown, parameter in zip(self.unknowns, space, strict=False):
            own.append(replace(unknown, name=parameter.name, scale=parameter.scale))
        self.unknowns = ParameterSpace((*own, *self.unknowns.parameters[len(space) :]))


class LogPosterior:
    """The sum of a log-likelihood and a log prior: phi (W, m) to log densities (W,).

    Parameters
    ----------
    target : BatchedLogLikelihood
        The log-likelihood.
    prior : LogPrior
        A density over the unit box.
    """

    def __init__(self, target: BatchedLogLikelihood, prior: LogPrior):
        self.target = target
        self.prior = prior

    def __call__(self, phi: Array) -> Array:
        return self.target.many(phi) + self.prior(phi)


class SmoothLogPosterior(LogPosterior):
    """A log posterior with gradients.

    Parameters
    ----------
    target : Local
        A log-likelihood with gradients.
    prior : LogPrior
        A density over the unit box.
    """

    def __init__(self, target: Local, prior: LogPrior):
        super().__init__(target, prior)
        self.local = target

    def value_score_information(self, phi: Array) -> tuple[Array, Array]:
        """Evaluate the log posterior with its gradient at many points.

        Parameters
        ----------
        phi : (W, m) array
            W numbers phi, each in the order of the unknowns.

        Returns
        -------
        values : (W,) array
            In nats, up to a constant.
        gradients : (W, m) array
            d value / d phi.
        """
        values, gradients = self.local.value_score_information(phi)
        return values + self.prior(phi), gradients + self.prior.gradient(phi)


def log_posterior(target: BatchedLogLikelihood, prior: LogPrior) -> LogPosterior:
    """Add a prior to a log-likelihood, with gradients if the likelihood has them.

    Parameters
    ----------
    target : BatchedLogLikelihood
    prior : LogPrior

    Returns
    -------
    LogPosterior
    """
    if isinstance(target, Local) and target.bound.has_gradients:
        return SmoothLogPosterior(target, prior)
    return LogPosterior(target, prior)
