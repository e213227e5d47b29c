"""Ensemble adaptation as in EPOpt: particles of the parameters, weighed by the likelihood of target
data and drawn again.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.prior import LogPrior
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit, Status
from dropo.core.records.search_records import ParticlePosterior
from dropo.core.services.errors import SimulationFailed
from dropo.core.services.validation import Array, require
from dropo.estimators.support.distribution_fit import point_likelihood, posterior_fit
from dropo.estimators.support.posterior_targets import PointLikelihood

# times the covariance of the particles is that of the Gaussian which proposes the next ones: wider
# tails than its target's
WIDER = 1.5


@dataclass(frozen=True, kw_only=True)
class EPOpt(Estimator):
    """The posterior of parameters that are the same in all rows, by importance weights (Rajeswaran
    et al. 2017, section 3.2).

    p(xi | data) is proportional to p(xi) times the product over rows of N(target; prediction under
    xi, diag(epsilon)). `particles` are drawn from the prior, weighed by likelihood x prior /
    proposal, and a Gaussian with their moments proposes the next ones. Where the data say much more
    than the prior, all weight would fall on one particle; so the likelihood is raised to a power
    that grows from round to round as far as it leaves the share `least` of the particles effective,
    (sum w)^2 / sum w^2, until it is 1 (Del Moral, Doucet, Jasra 2012); in the paper
    (arXiv:1610.01283) it is 1 throughout: `tempered` False. rounds: at most; the last one's
    particles, drawn again by weight, are `search_record.draws`. The prior is the problem's own,
    else uniform on the box.
    epsilon: the noise variance, one or for each signal; None, the problem's own, else the variance
    that least squares leaves.
    """

    particles: int = 200
    rounds: int = 60
    least: float = 0.5
    tempered: bool = True
    epsilon: float | tuple[float, ...] | None = None
    name = "epopt"

    def __post_init__(self) -> None:
        require(self.rounds >= 1, "rounds", "at least 1", self.rounds, "EPOpt")
        require(0 < self.least < 1, "least", "a share in (0, 1)", self.least, "EPOpt")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        d = len(problem.space)
        require(
            self.particles >= 10 * d,
            "particles",
            f"at least {10 * d}, ten a parameter",
            self.particles,
            "EPOpt",
        )
        target = point_likelihood(problem, run, self.name, self.epsilon)
        prior = LogPrior(problem.priors, problem.space)
        rng = run.rng.spawn(1)[0]
        powers = [0.0]
        proposal = None
        while True:
            points, density = _draw(proposal, self.particles, d, rng)
            log_likelihood, log_ratio = self._weigh(problem, run, target, prior, points, density)
            powers.append(
                self._power(log_likelihood, log_ratio, powers[-1]) if self.tempered else 1.0
            )
            weights = _weights(powers[-1] * log_likelihood + log_ratio)
            run.progress(
                min(0.99, len(powers) / self.rounds),
                f"round {len(powers) - 1}, likelihood to the power {powers[-1]:.3g}",
            )
            if powers[-1] >= 1 or len(powers) > self.rounds:
                break
            proposal = _moments(points, weights)
        return self._summary(problem, run, target, points, weights, powers, rng)

    def _weigh(
        self,
        problem: Problem,
        run: Run,
        target: PointLikelihood,
        prior: LogPrior,
        points: Array,
        density: Array,
    ) -> tuple[Array, Array]:
        """(K,) log-likelihoods, -inf where a simulation failed, and logs of prior / proposal, -inf
        outside the box, of points (K, d).
        """
        inside = ((points >= 0) & (points <= 1)).all(axis=1)
        values = problem.space.from_unit(points[inside])
        log_likelihood, log_prior = np.full((2, len(points)), -np.inf)
        log_likelihood[inside] = np.nan_to_num(run.evaluate(values, target.many), nan=-np.inf)
        log_prior[inside] = prior(values)
        if not np.isfinite(log_likelihood + log_prior).any():
            raise SimulationFailed(
                "No particle of EPOpt has a likelihood: all simulations diverged. Narrow "
                "the bounds."
            )
        return log_likelihood, log_prior - density

    def _power(self, log_likelihood: Array, log_ratio: Array, before: float) -> float:
        """The largest power of the likelihood, from the one `before` up to 1, that leaves `least`
        of the particles effective.

        Where fewer are effective at the power before already, as a poor proposal leaves them, nine
        tenths of those.
        """
        counting = np.isfinite(log_likelihood + log_ratio)
        log_likelihood = log_likelihood[counting]
        log_ratio = log_ratio[counting]
        left: Callable[[float], float] = lambda power: _effective(
            _weights(power * log_likelihood + log_ratio)
        )
        few = min(self.least * self.particles, 0.9 * left(before))
        if left(1.0) >= few:
            return 1.0
        return float(
            np.exp(
                brentq(
                    lambda exponent: left(np.exp(exponent)) - few,
                    np.log(max(before, 1e-30)),
                    0.0,
                    xtol=1e-6,
                )
            )
        )

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
        draws = problem.space.from_unit(points[_again(weights, rng)])
        effective = _effective(weights)
        warnings = []
        if effective < 0.1 * self.particles:
            warnings.append(
                f"{effective:.1f} of {self.particles} particles are effective: take more, "
                "or tempered=True"
            )
        done = powers[-1] >= 1
        message = (
            f"{len(powers) - 1} rounds, {effective:.0f} of {self.particles} particles effective."
        )
        return posterior_fit(
            problem,
            run,
            self.name,
            draws,
            target,
            status=Status.CONVERGED if done else Status.OUT_OF_BUDGET,
            message=message
            if done
            else (
                f"{message} The likelihood counts to the power {powers[-1]:.2g} alone: take "
                "more rounds."
            ),
            search_record=ParticlePosterior(
                draws, problem.space.from_unit(points), weights, np.array(powers), effective
            ),
            warnings=tuple(warnings),
        )


Gaussian = tuple[Array, Array]  # mean (d,) and lower factor (d, d) of the covariance


def _draw(
    proposal: Gaussian | None, count: int, d: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Points (K, d) of the unit box, or around it, and the log of the density that they are drawn
    from; None: uniform on the box.
    """
    if proposal is None:
        return rng.random((count, d)), np.zeros(count)
    normal = rng.standard_normal((count, d))
    mean, factor = proposal
    log_volume = np.log(np.diagonal(factor)).sum() + 0.5 * d * np.log(2 * np.pi)
    return mean + normal @ factor.T, -0.5 * (normal**2).sum(axis=1) - log_volume


def _moments(points: Array, weights: Array) -> Gaussian:
    mean = weights @ points
    covariance = WIDER * (points - mean).T @ ((points - mean) * weights[:, None])
    floor = 1e-12 * np.trace(covariance) / len(mean) + 1e-30
    return mean, np.linalg.cholesky(covariance + floor * np.eye(len(mean)))


def _weights(logarithms: Array) -> Array:
    return np.exp(logarithms - logsumexp(logarithms))


def _effective(weights: Array) -> float:
    """(sum w)^2 / sum w^2 (Kong 1992) of weights that sum to 1."""
    return float(1 / (weights**2).sum())


def _again(weights: Array, rng: np.random.Generator) -> Array:
    """(K,) the particles drawn again by weight, systematically (Kitagawa 1996)."""
    count = len(weights)
    places = (np.arange(count) + rng.random()) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), count - 1)
