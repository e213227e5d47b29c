"""The posterior by sampling: of the parameters themselves, or of the distribution that they are
drawn from.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import Likelihood, LocalLikelihood
from dropo.core.contracts.noise import Noise, NoiseModel
from dropo.core.contracts.prior import LogPrior, Prior
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.sampler import Density, Sampler
from dropo.core.records.draws import ChainTooShort, Draws
from dropo.core.records.fit import Fit, Status
from dropo.core.records.fit_parts import PosteriorDiagnostics, PosteriorDraws
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, known, require
from dropo.estimators.support.around_maximum import AroundMaximum, unit_spread
from dropo.estimators.support.epsilon import noise_scale, noise_shape
from dropo.estimators.support.posterior_targets import (
    Local,
    OneByOne,
    PointLikelihood,
    Target,
    log_posterior,
)
from dropo.estimators.support.summary import at_bounds

# what Vehtari et al. 2021 ask for before draws are used
R_HAT = 1.01
ESS = 400
KEPT = 4000, 1_000_000  # row log-likelihoods are kept of at most so many draws, and so many numbers


@dataclass(frozen=True, kw_only=True)
class Posterior(Estimator):
    """Draws from the posterior.

    A prior is flat on the box, in the logarithm where a parameter is on a log scale, unless given.

    over: "parameters", one value of the parameters for all the data, with Gaussian errors of
    variance epsilon: the fit is the Gaussian of the draws' mean and covariance; "distribution", the
    phi of a `family`: the fit is the member at the draws' mean in the unit box, its standard errors
    their standard deviations.
    likelihood: a local one ("emulated", "linear") is built around its maximum and has gradients;
    None, the simulator itself for parameters, "monte-carlo" for a distribution, and "emulated" in
    both where the sampler needs gradients.
    priors: by the unknowns' names, "torso_mass" over parameters, "mean.torso_mass",
    "scale.torso_mass", "partial.a.b" over a distribution, "epsilon" or "epsilon[0]", ... for
    factors of a learned noise; the problem's own priors count for parameters or their means. Each
    is a text such as "normal(3.5, 0.2)" or a frozen distribution of scipy.stats.
    epsilon: the noise variance, one or for each signal; "learn", found with the rest: by a local
    likelihood a factor on each signal's variance, else one on the problem's own or on what least
    squares leaves; a Noise; None, the problem's own where it names one, else "learn". start: where
    walkers begin on other than local likelihoods, a least-squares estimate or the middle of the
    box.
    """

    over: Literal["parameters", "distribution"] = "parameters"
    likelihood: str | Likelihood | None = None
    family: str = "truncated_gaussian"
    epsilon: float | tuple[float, ...] | Noise | Literal["learn"] | None = None
    sampler: str | Sampler = "emcee"
    priors: Mapping[str, Prior] = field(default_factory=dict)
    start: Literal["least-squares", "middle"] = "least-squares"
    name = "posterior"

    def __post_init__(self) -> None:
        known("posterior over", self.over, ("parameters", "distribution"))
        known("start", self.start, ("least-squares", "middle"))
        require(
            not isinstance(self.epsilon, str) or self.epsilon == "learn",
            "epsilon",
            "a variance or 'learn'",
            self.epsilon,
            "Posterior",
        )

    def _fit(self, problem: Problem, run: Run) -> Fit:
        sampler: Sampler = (
            find("samplers", self.sampler)() if isinstance(self.sampler, str) else self.sampler
        )
        likelihood = self._likelihood(sampler)
        points = self.over == "parameters"
        family: Family = find("families", "full" if points else self.family)(problem.space)
        noise = self._noise(problem, run, isinstance(likelihood, LocalLikelihood))
        own = NoiseModel(noise, len(problem.simulator.signals)).unknowns
        prior = self._prior(
            problem, ParameterSpace((*(problem.space if points else family.unknowns), *own))
        )
        target: Target
        if isinstance(likelihood, LocalLikelihood):
            named = "point" if points else self.family
            place = AroundMaximum(
                problem,
                run,
                find("families", named)(problem.space),
                named,
                likelihood,
                noise,
                problem.space if points else None,
            )
            target, draws, notes = self._sample_locally(place, run, sampler, prior)
            return self._summary(problem, run, family, target, draws, notes)
        if likelihood is None:
            target = PointLikelihood(problem, noise)
        else:
            target = OneByOne(
                likelihood.bind(
                    problem.simulator, problem.segments, family, noise, run.rng.spawn(1)[0]
                )
            )
        draws = _sample(run, sampler, target, prior, *self._start(problem, run, target, family))
        return self._summary(problem, run, family, target, draws, [])

    def _likelihood(self, sampler: Sampler) -> Likelihood | None:
        chosen = self.likelihood
        if chosen is None and (sampler.needs_gradients or self.over == "distribution"):
            chosen = "emulated" if sampler.needs_gradients else "monte-carlo"
        made: Likelihood | None = (
            find("likelihoods", chosen)() if isinstance(chosen, str) else chosen
        )
        if self.over == "parameters" and not (made is None or isinstance(made, LocalLikelihood)):
            raise Incompatible(
                "The likelihood of Posterior(over='parameters') is the simulator's own, or "
                "a local model of it."
                f" Leave it out, or use 'emulated' or 'linear'. Got {self.likelihood!r} instead."
            )
        return made

    def _noise(self, problem: Problem, run: Run, local: bool) -> Noise:
        epsilon: Any = problem.epsilon if self.epsilon is None else self.epsilon
        if isinstance(epsilon, Noise):
            return epsilon
        learned: Literal["factor", "each"] | None = None
        if epsilon is None or isinstance(epsilon, str):
            epsilon, learned = (
                (noise_scale(problem, run), "each")
                if local
                else (noise_shape(problem, run), "factor")
            )
        return Noise(
            np.asarray(epsilon, dtype=float),
            learned,
            start=problem.start_noise,
            degrees=problem.noise_degrees,
        )

    def _prior(self, problem: Problem, space: ParameterSpace) -> LogPrior:
        own = {
            name if self.over == "parameters" else f"mean.{name}": prior
            for name, prior in problem.priors.items()
        }
        return LogPrior({**own, **self.priors}, space)

    def _sample_locally(
        self, place: AroundMaximum, run: Run, sampler: Sampler, prior: LogPrior
    ) -> tuple[Local, Draws, list[str]]:
        """The draws from the local model around the maximum; where they reach its edge, from a
        wider one around them.
        """
        target = place.head()
        draws = _sample(run, sampler, target, prior, target.best, unit_spread(target))
        edges = place.edges(draws, target)
        if edges:
            target = place.wider(draws, edges)
            draws = _sample(run, sampler, target, prior, target.best, unit_spread(target))
            edges = place.edges(draws, target)
        told = (
            f"draws of {', '.join(edges)} reach the edge of where the local model is trusted, "
            "so the posterior is wider than they are"
        )
        return (
            target,
            draws,
            [f"{told}: check with sampler 'emcee' and the simulator itself"] if edges else [],
        )

    def _start(
        self, problem: Problem, run: Run, target: Target, family: Family
    ) -> tuple[Array, Array]:
        """Phi (m,) to start from, and the walkers' spread (m,) in the unit box."""
        unknowns = target.unknowns
        start = unknowns.from_unit(np.full(len(unknowns), 0.5))
        spread = np.full(len(unknowns), 0.05)
        if self.start == "middle":
            return start, spread
        found = find("methods", "least-squares")()._fit(problem, run)
        if self.over == "parameters":
            start[: len(problem.space)] = found.mean
            spread[: len(problem.space)] = _unit_width(problem.space, found.mean, found.mean_se)
        else:
            start[: len(family.unknowns)] = family.phi(found.mean)
        return start, spread

    def _summary(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        target: Target,
        draws: Draws,
        notes: list[str],
    ) -> Fit:
        flat = draws.flat()
        m = len(family.unknowns)
        centre = target.unknowns.from_unit(target.unknowns.to_unit(flat).mean(axis=0))
        if self.over == "parameters":
            phi, centre[: len(problem.space)] = _gaussian(family, flat[:, : len(problem.space)])
            mean_se = family.sd(phi)
            scale_se = np.full(len(problem.space), np.nan)
        else:
            phi = centre[:m]
            sd = dict(zip(draws.names, flat.std(axis=0), strict=True))
            mean_se, scale_se = (
                np.array([sd.get(f"{kind}.{n}", np.nan) for n in problem.space.names])
                for kind in ("mean", "scale")
            )
        with run.counting(evaluations=1):
            value = float(target.many(centre[None])[0])
            predicted = target.mean(centre)
        targets = problem.simulator.targets(problem.segments)
        doubts, diagnostics = evaluate_draws(draws)
        notes = [*draws.notes, *doubts, *notes]
        return Fit(
            method=self.name,
            problem=problem.name,
            space=problem.space,
            family="full" if self.over == "parameters" else self.family,
            phi=phi,
            mean=family.mean(phi),
            scale=family.scale(phi),
            sd=family.sd(phi),
            mean_se=mean_se,
            scale_se=scale_se,
            correlation=family.correlation(phi),
            epsilon=target.epsilon(centre),
            log_likelihood=value,
            mse=float(np.mean((predicted - targets) ** 2)),
            transitions=int(problem.segments.lengths.sum()),
            simulator_steps=0,
            failed_simulations=0,
            objective_evaluations=0,
            status=Status.OUT_OF_BUDGET if notes else Status.CONVERGED,
            message=f"{len(flat)} draws: {'see the warnings.' if notes else 'the walkers agree.'}",
            warnings=(*problem.warnings, *notes, *at_bounds(family.unknowns, phi)),
            posterior=PosteriorDraws(
                over=self.over,
                unknowns=tuple(draws.names),
                diagnostics=diagnostics,
                chain=draws.chain,
                log_density=draws.log_density,
                observed=targets,
                diverging=draws.diverging,
                row_log_likelihood=_row_log_likelihood(draws, target, len(targets)),
            ),
        )


def _sample(
    run: Run, sampler: Sampler, target: Target, prior: LogPrior, start: Array, spread: Array
) -> Draws:
    unit = np.clip(target.unknowns.to_unit(start), 0.0, 1.0)
    evaluate = _Evaluate(run, sampler.evaluations(len(unit)))
    return sampler.sample(
        log_posterior(target, prior),
        target.unknowns,
        rng=run.rng,
        evaluate=evaluate,
        start=unit,
        spread=spread,
    )


def _row_log_likelihood(draws: Draws, target: Target, rows: int) -> Array | None:
    """(S, W, R), where a local model gives it and it is small enough to keep."""
    count = draws.log_density.size
    if not isinstance(target, Local) or count > KEPT[0] or count * rows > KEPT[1]:
        return None
    return target.rows(draws.flat()).reshape(*draws.log_density.shape, -1)


class _Evaluate:
    """`run.evaluate`, with progress."""

    def __init__(self, run: Run, planned: int):
        self.run = run
        self.planned = planned
        self.done = 0

    def __call__(self, points: Array, function: Density) -> Array:
        answers = self.run.evaluate(points, function)
        self.done += len(points)
        self.run.progress(
            min(1.0, self.done / self.planned),
            f"{self.done} points, highest here {answers.reshape(len(points), -1)[:, 0].max():.6g}",
        )
        return answers


def _unit_width(space: ParameterSpace, mean: Array, error: Array) -> Array:
    """(d,) standard errors in the unit box, kept between rounding and a tenth of it; a hundredth
    where there is none.
    """
    above, below = (
        space.to_unit(np.clip(mean + sign * np.nan_to_num(error), space.low, space.high))
        for sign in (1, -1)
    )
    return np.where(np.isfinite(error), np.clip((above - below) / 2, 1e-9, 0.1), 0.01)


def _gaussian(family: Any, values: Array) -> tuple[Array, Array]:
    """Phi (m,) of the Gaussian with the mean and covariance of draws (K, d), as narrow as they are;
    and that mean (d,).
    """
    mean = values.mean(axis=0)
    d = values.shape[1]
    phi = np.array(family.phi_of(mean, np.cov(values.T).reshape(d, d)))
    for i, name in enumerate(
        family.space.names
    ):  # a posterior may be narrower than the least scale of a search
        phi[family.unknowns.names.index(f"mean.{name}")] = mean[i]
        phi[family.unknowns.names.index(f"scale.{name}")] = values[:, i].std(ddof=1)
    return phi, mean


def evaluate_draws(draws: Draws) -> tuple[list[str], PosteriorDiagnostics]:
    """What speaks against using the draws, a sentence each; and the diagnostics of each unknown by
    name.
    """
    notes = []
    r_hat = draws.split_r_hat()
    ess = draws.effective_sample_size()
    try:
        times = draws.autocorrelation_time()
    except ChainTooShort as error:
        times = error.estimate
        notes.append(str(error))
    if (r_hat > R_HAT).any():
        named = ", ".join(
            f"{n} {r:.3f}" for n, r in zip(draws.names, r_hat, strict=True) if r > R_HAT
        )
        notes.append(
            f"split R-hat is above {R_HAT} ({named}): the walkers do not agree yet; take more steps"
        )
    if (ess < ESS).any():
        named = ", ".join(f"{n} {e:.0f}" for n, e in zip(draws.names, ess, strict=True) if e < ESS)
        notes.append(f"the effective sample size is below {ESS} ({named}): take more steps")
    found = PosteriorDiagnostics(
        autocorrelation_time=dict(zip(draws.names, times.tolist(), strict=True)),
        split_r_hat=dict(zip(draws.names, r_hat.tolist(), strict=True)),
        effective_sample_size=dict(zip(draws.names, ess.tolist(), strict=True)),
    )
    return notes, found
