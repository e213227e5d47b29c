"""The posterior by sampling: of the parameters themselves, or of the distribution that they are drawn from."""

from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from dropo.core.catalogue import find
from dropo.core.checks import Array, known, require
from dropo.core.estimator import Estimator, Run
from dropo.core.family import Family
from dropo.core.fit import Fit, Status
from dropo.core.likelihood import Likelihood, LogLikelihood
from dropo.core.local_likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.noise import Epsilon, Noise, NoiseModel
from dropo.core.parameters import ParameterSpace
from dropo.core.problem import Problem
from dropo.core.sampler import ChainTooShort, Density, Draws, Sampler
from dropo.estimators.dropo import DROPO, noise_shape
from dropo.estimators.summary import at_bounds

R_HAT, ESS = 1.01, 400  # what Vehtari et al. 2021 ask for before draws are used
NARROWEST = 1e-4  # the least width of a local likelihood, as a share of the box


class _Target(Protocol):
    """What is sampled: a log-likelihood of phi (m,), many phi at once; the prior is flat on the box of its unknowns."""

    unknowns: ParameterSpace

    def many(self, phi: Array) -> Array: ...  # (W, m) -> (W,)
    def epsilon(self, phi: Array) -> Array: ...  # (m,) -> (p,)
    def mean(self, phi: Array) -> Array: ...  # (m,) -> (R, p)


class PointLikelihood:
    """log p(data | xi, epsilon) = sum over rows of log N(target; prediction under xi, diag(epsilon)): one xi for all the data."""

    def __init__(self, problem: Problem, epsilon: Epsilon):
        self.simulator, self.segments, self.size = problem.simulator, problem.segments, len(problem.space)
        self.targets = self.simulator.targets(self.segments)
        self.noise = NoiseModel(epsilon, self.targets.shape[1])
        require(bool((self.noise.shape > 0).all()), "epsilon", "positive: the errors need a variance", epsilon, "Posterior")
        self.unknowns = ParameterSpace((*problem.space, *self.noise.unknowns))

    def many(self, phi: Array) -> Array:
        """(W, m) -> (W,) log-likelihood [nats]; NaN where a simulation failed."""
        variance = np.array([self.epsilon(p) for p in phi])[:, None]  # (W, 1, p)
        errors = self.simulator.predict(phi[:, : self.size], self.segments) - self.targets  # (W, R, p)
        return np.asarray(-0.5 * (errors**2 / variance + np.log(2 * np.pi * variance)).sum(axis=(1, 2)))

    def epsilon(self, phi: Array) -> Array:
        """(p,) the noise variances."""
        return self.noise.epsilon(phi[self.size :])

    def mean(self, phi: Array) -> Array:
        """(R, p) the prediction."""
        prediction: Array = self.simulator.predict(phi[None, : self.size], self.segments)[0]
        return prediction


class _OneByOne:
    """A log-likelihood over a family's members, for many of them; best: (n,) the family's unknowns at its maximum, where known."""

    def __init__(self, bound: LogLikelihood, best: Array | None = None):
        self.bound, self.unknowns, self.epsilon, self.mean, self.best = bound, bound.unknowns, bound.epsilon, bound.mean, best

    def many(self, phi: Array) -> Array:
        return np.array([self.bound(p) for p in phi])


@dataclass(frozen=True)
class Posterior(Estimator):
    """Draws from the posterior under a prior that is flat on the box, in the logarithm where a parameter is on a log scale.

    over: "parameters", one value of the parameters for all the data, with Gaussian errors of variance epsilon: the fit is
    the Gaussian of the draws' mean and covariance; "distribution", a family's phi: the fit is the member at the draws' mean
    in the unit box, its standard errors their standard deviations, and `likelihood` and `family` count.
    epsilon: the noise variance, one or for each signal; "learn", a factor on the problem's own, or on the residuals' variances,
    found with the rest; None, the problem's own where it names one, else "learn". start: where the walkers begin, a
    least-squares estimate or the middle of the box.
    """

    over: Literal["parameters", "distribution"] = "parameters"
    likelihood: str | Likelihood = "monte-carlo"
    family: str = "truncated_gaussian"
    epsilon: float | tuple[float, ...] | Literal["learn"] | None = None
    sampler: str | Sampler = "emcee"
    start: Literal["least-squares", "middle"] = "least-squares"
    name = "posterior"

    def __post_init__(self) -> None:
        known("posterior over", self.over, ("parameters", "distribution"))
        known("start", self.start, ("least-squares", "middle"))
        require(not isinstance(self.epsilon, str) or self.epsilon == "learn", "epsilon", "a variance or 'learn'", self.epsilon, "Posterior")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        family: Family = find("families", "full" if self.over == "parameters" else self.family)(problem.space)
        target = self._target(problem, family, run)
        start, spread = self._start(problem, run, target, family)
        sampler: Sampler = find("samplers", self.sampler)() if isinstance(self.sampler, str) else self.sampler
        unit = np.clip(target.unknowns.to_unit(start), 0.0, 1.0)
        evaluate = _Evaluate(run, sampler.evaluations(len(unit)))
        draws = sampler.sample(target.many, target.unknowns, rng=run.rng, evaluate=evaluate, start=unit, spread=spread)
        return self._summary(problem, run, family, target, draws)

    def _target(self, problem: Problem, family: Family, run: Run) -> _Target:
        epsilon: Any = problem.epsilon if self.epsilon is None else self.epsilon
        if epsilon is None or isinstance(epsilon, str):
            epsilon = Noise(noise_shape(problem, run), "factor")
        if self.over == "parameters":
            return PointLikelihood(problem, epsilon)
        likelihood: Likelihood = find("likelihoods", self.likelihood)() if isinstance(self.likelihood, str) else self.likelihood
        if isinstance(likelihood, LocalLikelihood):
            return _OneByOne(*around_the_maximum(problem, run, family, self.family, likelihood, epsilon))
        return _OneByOne(likelihood.bind(problem.simulator, problem.segments, family, epsilon, run.rng.spawn(1)[0]))

    def _start(self, problem: Problem, run: Run, target: _Target, family: Family) -> tuple[Array, Array]:
        """phi (m,) to start from, and the walkers' spread (m,) in the unit box."""
        unknowns = target.unknowns
        start, spread = unknowns.from_unit(np.full(len(unknowns), 0.5)), np.full(len(unknowns), 0.05)
        best = getattr(target, "best", None)
        if best is not None:
            start[: len(best)] = best
        if self.start == "middle" or best is not None:
            return start, spread
        found = find("methods", "least-squares")()._fit(problem, run)
        if self.over == "parameters":
            start[: len(problem.space)] = found.mean
            spread[: len(problem.space)] = _unit_width(problem.space, found.mean, found.mean_se)
        else:
            start[: len(family.unknowns)] = family.phi(found.mean)
        return start, spread

    def _summary(self, problem: Problem, run: Run, family: Family, target: _Target, draws: Draws) -> Fit:
        flat, m = draws.flat(), len(family.unknowns)
        centre = target.unknowns.from_unit(target.unknowns.to_unit(flat).mean(axis=0))
        if self.over == "parameters":
            phi, centre[: len(problem.space)] = _gaussian(family, flat[:, : len(problem.space)])
            mean_se, scale_se = family.sd(phi), np.full(len(problem.space), np.nan)
        else:
            phi, sd = centre[:m], dict(zip(draws.names, flat.std(axis=0), strict=True))
            mean_se, scale_se = (np.array([sd.get(f"{kind}.{n}", np.nan) for n in problem.space.names]) for kind in ("mean", "scale"))
        with run.counting(evaluations=1):
            value, predicted = float(target.many(centre[None])[0]), target.mean(centre)
        notes, diagnostics = judge(draws)
        return Fit(
            method=self.name, problem=problem.name, space=problem.space, family="full" if self.over == "parameters" else self.family,
            phi=phi, mean=family.mean(phi), scale=family.scale(phi), sd=family.sd(phi), mean_se=mean_se, scale_se=scale_se,
            correlation=family.correlation(phi), epsilon=target.epsilon(centre), log_likelihood=value,
            mse=float(np.mean((predicted - problem.simulator.targets(problem.segments)) ** 2)),
            transitions=int(problem.segments.lengths.sum()), simulator_steps=0, failed_simulations=0, objective_evaluations=0,
            status=Status.OUT_OF_BUDGET if notes else Status.CONVERGED,
            message=f"{len(flat)} draws: {'too few, see the warnings.' if notes else 'the walkers agree.'}",
            warnings=(*problem.warnings, *notes, *at_bounds(family.unknowns, phi)),
            arrays={"chain": draws.chain, "log_density": draws.log_density}, details={"over": self.over, "posterior": diagnostics},
        )  # fmt: skip


def around_the_maximum(
    problem: Problem, run: Run, family: Family, family_name: str, likelihood: LocalLikelihood, epsilon: Any
) -> tuple[LocalLogLikelihood, Array]:
    """The local likelihood where DROPO finds its maximum, wide enough for eight standard errors of the means; and that maximum."""
    found = DROPO(likelihood=likelihood, family=family_name, epsilon=None if isinstance(epsilon, Noise) else epsilon)._fit(problem, run)
    box = problem.space.high - problem.space.low
    width = np.clip(np.maximum(2 * found.sd, 4 * np.nan_to_num(found.mean_se)), NARROWEST * box, box / 6)
    with run.counting(evaluations=1):
        local = likelihood.around(problem.simulator, problem.segments, family, epsilon, found.mean, width, run.rng.spawn(1)[0])
    return local, found.phi


class _Evaluate:
    """`run.evaluate`, with progress."""

    def __init__(self, run: Run, planned: int):
        self.run, self.planned, self.done = run, planned, 0

    def __call__(self, points: Array, function: Density) -> Array:
        answers = self.run.evaluate(points, function)
        self.done += len(points)
        self.run.progress(min(1.0, self.done / self.planned), f"{self.done} points, highest here {answers.max():.6g}")
        return answers


def _unit_width(space: ParameterSpace, mean: Array, error: Array) -> Array:
    """(d,) standard errors in the unit box, kept between rounding and a tenth of it; a hundredth where there is none."""
    above, below = (space.to_unit(np.clip(mean + sign * np.nan_to_num(error), space.low, space.high)) for sign in (1, -1))
    return np.where(np.isfinite(error), np.clip((above - below) / 2, 1e-9, 0.1), 0.01)


def _gaussian(family: Any, values: Array) -> tuple[Array, Array]:
    """phi (m,) of the Gaussian with the mean and covariance of draws (K, d), as narrow as they are; and that mean (d,)."""
    mean, d = values.mean(axis=0), values.shape[1]
    phi = np.array(family.phi_of(mean, np.cov(values.T).reshape(d, d)))
    for i, name in enumerate(family.space.names):  # a posterior may be narrower than the least scale of a search
        phi[family.unknowns.names.index(f"mean.{name}")] = mean[i]
        phi[family.unknowns.names.index(f"scale.{name}")] = values[:, i].std(ddof=1)
    return phi, mean


def judge(draws: Draws) -> tuple[list[str], dict[str, dict[str, float | None]]]:
    """What speaks against using the draws, a sentence each; and the diagnostics of each unknown by name."""
    notes, r_hat, ess = [], draws.split_r_hat(), draws.effective_sample_size()
    try:
        times = draws.autocorrelation_time()
    except ChainTooShort as error:
        times = error.estimate
        notes.append(str(error))
    if (r_hat > R_HAT).any():
        named = ", ".join(f"{n} {r:.3f}" for n, r in zip(draws.names, r_hat, strict=True) if r > R_HAT)
        notes.append(f"split R-hat is above {R_HAT} ({named}): the walkers do not agree yet; take more steps")
    if (ess < ESS).any():
        named = ", ".join(f"{n} {e:.0f}" for n, e in zip(draws.names, ess, strict=True) if e < ESS)
        notes.append(f"the effective sample size is below {ESS} ({named}): take more steps")
    columns = {"autocorrelation_time": times, "split_r_hat": r_hat, "effective_sample_size": ess}
    numbers = {key: [float(v) if np.isfinite(v) else None for v in values] for key, values in columns.items()}
    return notes, {key: dict(zip(draws.names, values, strict=True)) for key, values in numbers.items()}
