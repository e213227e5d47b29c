"""What a posterior is a posterior of: log-likelihoods of many phi at once, with the prior on top."""

from dataclasses import replace
from typing import Protocol

import numpy as np

from dropo.core.contracts.likelihood import LocalLogLikelihood, LogLikelihood
from dropo.core.contracts.noise import Epsilon, NoiseModel
from dropo.core.contracts.prior import LogPrior
from dropo.core.contracts.problem import Problem
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.validation import Array


class Target(Protocol):
    """A log-likelihood of phi (m,), many phi at once.

    many: (W, m) -> (W,) [nats]; epsilon: (m,) -> (p,) the noise variances; mean: (m,) -> (R, p) the
    mean prediction.
    """

    unknowns: ParameterSpace

    def many(self, phi: Array) -> Array: ...
    def epsilon(self, phi: Array) -> Array: ...
    def mean(self, phi: Array) -> Array: ...


class PointLikelihood:
    """log p(data | xi, epsilon) = sum over rows of log N(target; prediction under xi,
    diag(epsilon)): one xi for all the data.
    """

    def __init__(self, problem: Problem, epsilon: Epsilon):
        self.simulator = problem.simulator
        self.segments = problem.segments
        self.size = len(problem.space)
        self.targets = self.simulator.targets(self.segments)
        self.noise = (
            NoiseModel(epsilon, self.targets.shape[1])
            .positive("a posterior")
            .plain("A posterior without likelihood")
        )
        self.unknowns = ParameterSpace((*problem.space, *self.noise.unknowns))

    def many(self, phi: Array) -> Array:
        """(W, m) -> (W,) log-likelihood [nats]; NaN where a simulation failed."""
        variance = np.array([self.epsilon(p) for p in phi])[:, None]  # (W, 1, p)
        errors = (
            self.simulator.predict(phi[:, : self.size], self.segments) - self.targets
        )  # (W, R, p)
        return np.asarray(
            -0.5 * (errors**2 / variance + np.log(2 * np.pi * variance)).sum(axis=(1, 2))
        )

    def epsilon(self, phi: Array) -> Array:
        """(p,) the noise variances."""
        return self.noise.epsilon(phi[self.size :])

    def mean(self, phi: Array) -> Array:
        """(R, p) the prediction."""
        prediction: Array = self.simulator.predict(phi[None, : self.size], self.segments)[0]
        return prediction


class OneByOne:
    """A log-likelihood over a family's members, for many of them."""

    def __init__(self, bound: LogLikelihood):
        self.bound = bound
        self.unknowns = bound.unknowns
        self.epsilon = bound.epsilon
        self.mean = bound.mean

    def many(self, phi: Array) -> Array:
        """(W, m) -> (W,) log-likelihood [nats]."""
        return np.array([self.bound(p) for p in phi])

    def rows(self, phi: Array) -> Array:
        """(W, m) -> (W, R) log density of each compared row [nats]."""
        return np.array([self.bound.rows(p) for p in phi])


class Local(OneByOne):
    """A local log-likelihood, from which gradients come where it has them; `best` (m,) is near its
    maximum.
    """

    def __init__(self, bound: LocalLogLikelihood, best: Array):
        super().__init__(bound)
        self.bound: LocalLogLikelihood = bound
        self.best = np.clip(best, self.unknowns.low, self.unknowns.high)

    def value_score_information(self, phi: Array) -> tuple[Array, Array]:
        """(W, m) -> log-likelihoods (W,) [nats] and their gradients (W, m)."""
        parts = [self.bound.value_score_information(p)[:2] for p in phi]
        return np.array([value for value, _ in parts]), np.array(
            [scores.sum(axis=0) for _, scores in parts]
        )

    def rename(self, space: ParameterSpace) -> None:
        """The unknowns "mean.x" of a family without spread as the parameters x themselves, on their
        own scales.
        """
        own = [
            replace(p, name=q.name, scale=q.scale)
            for p, q in zip(self.unknowns, space, strict=False)
        ]
        self.unknowns = ParameterSpace((*own, *self.unknowns.parameters[len(space) :]))


class LogPosterior:
    """Log-likelihood + log prior, a density over the unit box; (W, m) -> (W,)."""

    def __init__(self, target: Target, prior: LogPrior):
        self.target = target
        self.prior = prior

    def __call__(self, phi: Array) -> Array:
        return self.target.many(phi) + self.prior(phi)


class SmoothLogPosterior(LogPosterior):
    """The same with its gradient."""

    def __init__(self, target: Local, prior: LogPrior):
        super().__init__(target, prior)
        self.local = target

    def value_score_information(self, phi: Array) -> tuple[Array, Array]:
        """(W, m) -> (W,), (W, m)."""
        values, gradients = self.local.value_score_information(phi)
        return values + self.prior(phi), gradients + self.prior.gradient(phi)


def log_posterior(target: Target, prior: LogPrior) -> LogPosterior:
    """With gradients where the likelihood has them."""
    smooth = isinstance(target, Local) and target.bound.has_gradients
    return (
        SmoothLogPosterior(target, prior)
        if isinstance(target, Local) and smooth
        else LogPosterior(target, prior)
    )
