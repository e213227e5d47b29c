"""Ensemble adaptation as in EPOpt: particles weighted by the likelihood of target data."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.prior import LogPrior
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.search_records import ParticlePosterior
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array, require
from dropo.estimators.support.distribution_fit import point_likelihood, posterior_fit
from dropo.estimators.support.posterior_targets import PointLikelihood

Gaussian = tuple[Array, Array]
"""Mean (d,) and lower Cholesky factor (d, d) of the covariance."""


@dataclass(frozen=True, kw_only=True)
class EPOpt(Estimator):
    """Sample the posterior of parameters that are the same in all rows, by importance weights.

    Particles are drawn from the prior (the problem's own, else uniform on the box), weighted by
    likelihood x prior / proposal, and a Gaussian with their moments proposes the next ones. If the
    data say much more than the prior, all weight would fall on one particle; so the likelihood is
    raised to a power that grows from round to round until it is 1, as far as enough particles stay
    effective [2]_. The last particles, drawn again by weight, are `search_record.draws`.

    Attributes
    ----------
    particles : int
        In each round; at least 10 for each parameter.
    rounds : int
        At most.
    effective_fraction : float
        The power grows as far as it leaves this fraction of the particles effective,
        (sum w)^2 / sum w^2.
    tempered : bool
        False: the power is 1 throughout, as in the paper.
    epsilon : float or tuple of float, optional
        The noise variance, one or for each signal [signal unit^2]. None: the problem's own, else
        the variance that least squares leaves.
    widening : float
        Factor on the particles' covariance in the proposal, whose tails must be wider than its
        target's.

    Raises
    ------
    BadArgument
        If `rounds` is below 1, `effective_fraction` is not in (0, 1), or `widening` is below 1; by
        `fit`, if there are fewer than 10 particles for each parameter.

    Notes
    -----
    p(xi | data) is proportional to p(xi) times the product over the rows of
    N(target; prediction under xi, diag(epsilon)).

    References
    ----------
    .. [1] Rajeswaran et al., "EPOpt: learning robust neural network policies using model
       ensembles", 2017, arXiv:1610.01283, section 3.2.
    .. [2] Del Moral, Doucet, Jasra, "An adaptive sequential Monte Carlo method for approximate
       Bayesian computation", Statistics and Computing 22 (2012).
    """

    particles: int = 200
    rounds: int = 60
    effective_fraction: float = 0.5
    tempered: bool = True
    epsilon: float | tuple[float, ...] | None = None
    widening: float = 1.5
    name = "epopt"
    uses_priors = True

    def __post_init__(self) -> None:
        require(self.rounds >= 1, "rounds", "at least 1", self.rounds, "EPOpt")
        require(
            0 < self.effective_fraction < 1,
            "effective_fraction",
            "a fraction in (0, 1)",
            self.effective_fraction,
            "EPOpt",
        )
        require(self.widening >= 1, "widening", "at least 1", self.widening, "EPOpt")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """Raise the power of the likelihood round by round."""
        d = len(problem.space)
        rule = f"at least {10 * d}, ten a parameter"
        require(self.particles >= 10 * d, "particles", rule, self.particles, "EPOpt")
        target = point_likelihood(problem, run, self.name, self.epsilon)
        prior = LogPrior(problem.priors, problem.space)
        rng = run.rng.spawn(1)[0]
        powers = [0.0]
        proposal = None
        while True:
            # Draw particles, and weight them with as high a power as leaves enough effective.
            points, density = _draw(proposal, self.particles, d, rng)
            log_likelihood, log_ratio = self._evaluate(problem, run, target, prior, points, density)
            power = 1.0
            if self.tempered:
                power = self._next_power(log_likelihood, log_ratio, powers[-1])
            powers.append(power)
            weights = _normalize(power * log_likelihood + log_ratio)
            text = f"round {len(powers) - 1}, likelihood to the power {power:.3g}"
            run.progress(min(0.99, len(powers) / self.rounds), text)
            if power >= 1 or len(powers) > self.rounds:
                break

            proposal = _moments(points, weights, self.widening)
        return self._summary(problem, run, target, points, weights, powers, rng)

    def _evaluate(
        self,
        problem: Problem,
        run: Run,
        target: PointLikelihood,
        prior: LogPrior,
        points: Array,
        density: Array,
    ) -> tuple[Array, Array]:
        """(K,) log-likelihoods and (K,) log(prior / proposal) of points (K, d).

        The first is -inf if a simulation failed, both are outside the box.
        """
        inside = ((points >= 0) & (points <= 1)).all(axis=1)
        values = problem.space.from_unit(points[inside])
        log_likelihood = np.full(len(points), -np.inf)
        log_likelihood[inside] = np.nan_to_num(run.evaluate(values, target.many), nan=-np.inf)
        log_prior = np.full(len(points), -np.inf)
        log_prior[inside] = prior(values)
        if not np.isfinite(log_likelihood + log_prior).any():
            raise SimulationFailed(
                "No particle of EPOpt has a likelihood: all simulations diverged. Narrow the"
                " bounds."
            )
        return log_likelihood, log_prior - density

    def _next_power(self, log_likelihood: Array, log_ratio: Array, before: float) -> float:
        """The largest power, from the one before up to 1, that leaves `least` effective.

        If fewer are effective at the power before already, as a poor proposal leaves them, it
        leaves nine tenths of those.
        """
        finite = np.isfinite(log_likelihood + log_ratio)
        log_likelihood = log_likelihood[finite]
        log_ratio = log_ratio[finite]

        def effective_at(power: float) -> float:
            return _effective(_normalize(power * log_likelihood + log_ratio))

        wanted = min(self.effective_fraction * self.particles, 0.9 * effective_at(before))
        if effective_at(1.0) >= wanted:
            return 1.0
        exponent = brentq(
            lambda exponent: effective_at(np.exp(exponent)) - wanted,
            np.log(max(before, 1e-30)),
            0.0,
            xtol=1e-6,
        )
        return float(np.exp(exponent))

    def _summary(
        self,
        problem: Problem,
        run: Run,
        target: PointLikelihood,
        points: Array,
        weights: Array,
        powers: list[float],
        rng: np.random.Generator,
    ) -> Fit:
        """The fit of the last particles, and what speaks against them."""
        draws = problem.space.from_unit(points[_resample(weights, rng)])
        effective = _effective(weights)
        warnings = []
        if effective < 0.1 * self.particles:
            warnings.append(
                f"{effective:.1f} of {self.particles} particles are effective: take more, or"
                " tempered=True"
            )
        message = (
            f"{len(powers) - 1} rounds, {effective:.0f} of {self.particles} particles effective."
        )
        status = Status.CONVERGED
        if powers[-1] < 1:
            status = Status.OUT_OF_BUDGET
            message += (
                f" The likelihood counts to the power {powers[-1]:.2g} alone: take more rounds."
            )
        particles = problem.space.from_unit(points)
        return posterior_fit(
            problem,
            run,
            self.name,
            draws,
            target,
            status=status,
            message=message,
            search_record=ParticlePosterior(draws, particles, weights, np.array(powers), effective),
            warnings=tuple(warnings),
        )


def _draw(
    proposal: Gaussian | None, count: int, d: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Points (K, d) and the log of the density (K,) that they are drawn from.

    Without a proposal they are uniform on the unit box; with one, some lie outside.
    """
    if proposal is None:
        return rng.random((count, d)), np.zeros(count)
    normal = rng.standard_normal((count, d))
    mean, factor = proposal
    log_volume = np.log(np.diagonal(factor)).sum() + 0.5 * d * np.log(2 * np.pi)
    return mean + normal @ factor.T, -0.5 * (normal**2).sum(axis=1) - log_volume


def _moments(points: Array, weights: Array, widening: float) -> Gaussian:
    """The Gaussian with the particles' mean and their covariance, widened and never singular."""
    mean = weights @ points
    covariance = widening * (points - mean).T @ ((points - mean) * weights[:, None])
    lowest = 1e-12 * np.trace(covariance) / len(mean) + 1e-30
    return mean, np.linalg.cholesky(covariance + lowest * np.eye(len(mean)))


def _normalize(logarithms: Array) -> Array:
    """(K,) weights that sum to 1, from their logarithms."""
    return np.exp(logarithms - logsumexp(logarithms))


def _effective(weights: Array) -> float:
    """(sum w)^2 / sum w^2 (Kong 1992) of weights that sum to 1."""
    return float(1 / (weights**2).sum())


def _resample(weights: Array, rng: np.random.Generator) -> Array:
    """(K,) the particles drawn again by weight, systematically (Kitagawa 1996)."""
    count = len(weights)
    positions = (np.arange(count) + rng.random()) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), positions), count - 1)
