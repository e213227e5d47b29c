"""The posterior by sampling: of the parameters, or of the distribution that they are drawn from."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.fit_parts import PosteriorDiagnostics, PosteriorDraws
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.start_mean import Start, checked_start, given_start
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, known, require
from dropo.estimators.support.around_maximum import AroundMaximum, unit_spread
from dropo.estimators.support.epsilon import noise_scale, noise_shape
from dropo.estimators.support.posterior_targets import (
    BatchedLogLikelihood,
    Local,
    OneByOne,
    PointLikelihood,
    log_posterior,
)
from dropo.estimators.support.summary import at_bounds, cut_off, of_every_fit, with_model_check


@dataclass(frozen=True)
class DrawSettings:
    """What draws must fulfil, and how much of them is kept.

    Attributes
    ----------
    r_hat : float
        Largest split R-hat before draws are used.
    effective_sample_size : float
        Smallest effective sample size before draws are used.
    kept_draws : int
        The log-likelihoods of the rows are kept of at most so many draws.
    kept_numbers : int
        At most so many of these numbers are kept, rows times draws.

    References
    ----------
    Vehtari et al., "Rank-normalization, folding, and localization", Bayesian Analysis 16 (2021).
    """

    r_hat: float = 1.01
    effective_sample_size: float = 400
    kept_draws: int = 4000
    kept_numbers: int = 1_000_000


DEFAULTS = DrawSettings()


@dataclass(frozen=True, kw_only=True)
class Posterior(Estimator):
    """Draw from the posterior of the parameters, or of the distribution that they are drawn from.

    Attributes
    ----------
    over : {"parameters", "distribution"}
        "parameters": one value of the parameters for all the data, with Gaussian errors of variance
        epsilon. The fit is the Gaussian of the draws' mean and covariance. "distribution": the phi
        of a `family`. The fit is the member at the draws' mean in the unit box, and its standard
        errors are the draws' standard deviations.
    likelihood : str or Likelihood, optional
        A local one ("emulated", "linear") is built around its maximum and has gradients. None: the
        simulator itself for parameters, "monte-carlo" for a distribution, and "emulated" in both if
        the sampler needs gradients.
    family : str
        The family of distributions.
    epsilon : float, tuple of float, Noise, "learn", optional
        The noise variance, one or for each signal [signal unit^2]. "learn": found with the rest; by
        a local likelihood a factor on each signal's variance, else one on the problem's own
        variances or on those that least squares leaves. None: the problem's own where it names one,
        else "learn".
    sampler : str or Sampler
        A name, or one with settings of its own.
    priors : mapping of str to Prior
        By the unknowns' names: "torso_mass" over parameters, "mean.torso_mass", "scale.torso_mass",
        "partial.a.b" over a distribution, "epsilon" or "epsilon[0]", ... for factors of a learned
        noise. Each is a text such as "normal(3.5, 0.2)" or a frozen distribution of scipy.stats.
        The problem's own priors count for parameters or their means. Without one, the prior is flat
        on the box, in the logarithm where a parameter is on a log scale.
    start : {"least-squares", "middle"}, mapping, sequence of float or Fit
        Where walkers begin on likelihoods that are not local: a least-squares estimate, the middle
        of the box, or values as `DROPO` takes them.
    settings : DrawSettings

    Raises
    ------
    UnknownName
        If `over` or a named `start` is none of the above; by `fit`, if there is no likelihood,
        family or sampler of that name, or a prior is of an unknown that does not exist.
    BadArgument
        If `epsilon` is another text than "learn", or a value of `start` is no finite number.
    """

    over: Literal["parameters", "distribution"] = "parameters"
    likelihood: str | Likelihood | None = None
    family: str = "truncated_gaussian"
    epsilon: float | tuple[float, ...] | Noise | Literal["learn"] | None = None
    sampler: str | Sampler = "emcee"
    priors: Mapping[str, Prior] = field(default_factory=dict)
    start: Start = "least-squares"
    settings: DrawSettings = field(default_factory=DrawSettings)
    name = "posterior"
    uses_priors = True

    def __post_init__(self) -> None:
        known("posterior over", self.over, ("parameters", "distribution"))
        start = checked_start(self.start, ("least-squares", "middle"))
        object.__setattr__(self, "start", start)
        valid = not isinstance(self.epsilon, str) or self.epsilon == "learn"
        require(valid, "epsilon", "a variance or 'learn'", self.epsilon, "Posterior")

    @property
    def _of_parameters(self) -> bool:
        """Whether the posterior is of the parameters themselves."""
        return self.over == "parameters"

    # --- what is sampled: the likelihood, the noise, the prior

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """Draws from a local model of the likelihood, or from the likelihood itself."""
        sampler = self.sampler
        if isinstance(sampler, str):
            sampler = find("samplers", sampler)()
        likelihood = self._make_likelihood(sampler)
        family = find("families", "full" if self._of_parameters else self.family)(problem.space)
        noise = self._make_noise(problem, run, isinstance(likelihood, LocalLikelihood))
        prior = self._make_prior(problem, family, noise)

        target: BatchedLogLikelihood
        if isinstance(likelihood, LocalLikelihood):
            around = self._around_maximum(problem, run, likelihood, noise)
            target, draws, notes = self._sample_locally(around, run, sampler, prior)
            return self._summarise(problem, run, family, target, draws, notes)

        if likelihood is None:
            target = PointLikelihood(problem, noise)
        else:
            rng = run.rng.spawn(1)[0]
            bound = likelihood.bind(problem.simulator, problem.segments, family, noise, rng)
            target = OneByOne(bound)
        start, spread = self._start(problem, run, target, family)
        draws = _sample(run, sampler, target, prior, start, spread)
        return self._summarise(problem, run, family, target, draws, [])

    def _make_likelihood(self, sampler: Sampler) -> Likelihood | None:
        """The likelihood that the settings name, or that the sampler needs; None: the simulator."""
        chosen = self.likelihood
        if chosen is None and sampler.needs_gradients:
            chosen = "emulated"
        elif chosen is None and not self._of_parameters:
            chosen = "monte-carlo"
        if isinstance(chosen, str):
            chosen = find("likelihoods", chosen)()
        made: Likelihood | None = chosen
        possible = made is None or isinstance(made, LocalLikelihood)
        if self._of_parameters and not possible:
            raise Incompatible(
                "The likelihood of Posterior(over='parameters') is the simulator's own, or a local"
                " model of it. Leave it out, or use 'emulated' or 'linear'. Got"
                f" {self.likelihood!r} instead."
            )
        return made

    def _make_noise(self, problem: Problem, run: Run, local: bool) -> Noise:
        """The noise that the settings or the problem name, or learned factors on a scale."""
        epsilon: Any = problem.epsilon if self.epsilon is None else self.epsilon
        if isinstance(epsilon, Noise):
            return epsilon
        learned: Literal["factor", "each"] | None = None
        if epsilon is None or isinstance(epsilon, str):
            learned = "each" if local else "factor"
            epsilon = noise_scale(problem, run) if local else noise_shape(problem, run)
        return Noise(
            np.asarray(epsilon, dtype=float),
            learned,
            start=problem.start_noise,
            degrees=problem.noise_degrees,
        )

    def _make_prior(self, problem: Problem, family: Family, noise: Noise) -> LogPrior:
        """The priors of the settings before those of the problem."""
        learned = NoiseModel(noise, len(problem.simulator.signals)).unknowns
        unknowns = problem.space if self._of_parameters else family.unknowns
        priors = {}
        for name, prior in problem.priors.items():
            priors[name if self._of_parameters else f"mean.{name}"] = prior
        return LogPrior({**priors, **self.priors}, ParameterSpace((*unknowns, *learned)))

    # --- sampling

    def _around_maximum(
        self, problem: Problem, run: Run, likelihood: LocalLikelihood, noise: Noise
    ) -> AroundMaximum:
        """What builds the local likelihood; parameters are a family without spread."""
        family_name = "point" if self._of_parameters else self.family
        return AroundMaximum(
            problem,
            run,
            find("families", family_name)(problem.space),
            family_name,
            likelihood,
            noise,
            problem.space if self._of_parameters else None,
        )

    def _sample_locally(
        self, around: AroundMaximum, run: Run, sampler: Sampler, prior: LogPrior
    ) -> tuple[Local, Draws, list[str]]:
        """Draws from the local model around the maximum, and a warning.

        If draws crowd at the edge of the region in which the model is trusted, they are drawn again
        from a wider model around them.
        """
        target = around.head()
        draws = _sample(run, sampler, target, prior, target.best, unit_spread(target))
        edges = around.edges(draws, target)
        if edges and not draws.interrupted:
            target = around.wider(draws, edges)
            draws = _sample(run, sampler, target, prior, target.best, unit_spread(target))
            edges = around.edges(draws, target)
        if not edges:
            return target, draws, []
        note = (
            f"draws of {', '.join(edges)} reach the edge of where the local model is trusted, so"
            " the posterior is wider than they are: check with sampler 'emcee' and the simulator"
            " itself"
        )
        return target, draws, [note]

    def _start(
        self, problem: Problem, run: Run, target: BatchedLogLikelihood, family: Family
    ) -> tuple[Array, Array]:
        """Phi (m,) to start from, and the walkers' spread (m,) in the unit box."""
        unknowns = target.unknowns
        start = unknowns.from_unit(np.full(len(unknowns), 0.5))
        spread = np.full(len(unknowns), 0.05)
        if self.start == "middle":
            return start, spread
        d = len(problem.space)
        mean = given_start(self.start, problem.space)
        if mean is None:
            found = find("methods", "least-squares")()._fit(replace(problem, priors={}), run)
            run.best = None  # of another method
            mean = found.mean
            if self._of_parameters:
                spread[:d] = _unit_width(problem.space, mean, found.mean_se)
        if self._of_parameters:
            start[:d] = mean
        else:
            start[: len(family.unknowns)] = family.phi(mean)
        return start, spread

    # --- the fit

    def _summarise(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        target: BatchedLogLikelihood,
        draws: Draws,
        notes: list[str],
    ) -> Fit:
        """The fit of the draws, with what speaks against them."""
        centre, phi = self._centre(problem, family, target, draws)
        mean_se, scale_se = self._errors(problem, family, draws, phi)
        with run.counting(evaluations=1):
            log_likelihood = float(target.many(centre[None])[0])
            predicted = target.mean(centre)
        targets = problem.simulator.targets(problem.segments)
        sentences, diagnostics = evaluate_draws(draws, self.settings)
        notes = [*draws.notes, *sentences, *notes]
        status, end = _end(draws, bool(notes))
        posterior = PosteriorDraws(
            over=self.over,
            unknowns=tuple(draws.names),
            diagnostics=diagnostics,
            chain=draws.chain,
            log_density=draws.log_density,
            observed=targets,
            diverging=draws.diverging,
            row_log_likelihood=self._row_log_likelihood(draws, target, len(targets)),
        )
        cut = []
        if self._of_parameters:
            cut = cut_off(problem.space, family.mean(phi), family.sd(phi))
        fit = Fit(
            method=self.name,
            problem=problem.name,
            space=problem.space,
            family="full" if self._of_parameters else self.family,
            phi=phi,
            mean=family.mean(phi),
            scale=family.scale(phi),
            sd=family.sd(phi),
            mean_se=mean_se,
            scale_se=scale_se,
            correlation=family.correlation(phi),
            epsilon=target.epsilon(centre),
            log_likelihood=log_likelihood,
            mse=float(np.mean((predicted - targets) ** 2)),
            transitions=int(problem.segments.lengths.sum()),
            simulator_steps=0,
            failed_simulations=0,
            objective_evaluations=0,
            status=status,
            message=f"{len(draws.flat())} draws: {end}",
            warnings=(*notes, *at_bounds(family.unknowns, phi), *cut),
            posterior=posterior,
        )
        return with_model_check(problem, run, replace(fit, **of_every_fit(problem, run, fit)))

    def _centre(
        self, problem: Problem, family: Family, target: BatchedLogLikelihood, draws: Draws
    ) -> tuple[Array, Array]:
        """The unknowns (m,) in the middle of the draws, and the family's member there."""
        d = len(problem.space)
        values = draws.flat()
        centre = target.unknowns.from_unit(target.unknowns.to_unit(values).mean(axis=0))
        if self._of_parameters:
            phi, centre[:d] = _gaussian(family, values[:, :d])
        else:
            phi = centre[: len(family.unknowns)]
        return centre, phi

    def _errors(
        self, problem: Problem, family: Family, draws: Draws, phi: Array
    ) -> tuple[Array, Array]:
        """Standard errors (d,) of the means and of the scales, by the draws."""
        names = problem.space.names
        if self._of_parameters:
            return family.sd(phi), np.full(len(names), np.nan)
        sd = dict(zip(draws.names, draws.flat().std(axis=0), strict=True))
        mean_se = np.array([sd.get(f"mean.{name}", np.nan) for name in names])
        scale_se = np.array([sd.get(f"scale.{name}", np.nan) for name in names])
        return mean_se, scale_se

    def _row_log_likelihood(
        self, draws: Draws, target: BatchedLogLikelihood, rows: int
    ) -> Array | None:
        """(S, W, R) of a local model, if it is small enough to keep."""
        count = draws.log_density.size
        small = count <= self.settings.kept_draws and count * rows <= self.settings.kept_numbers
        if not isinstance(target, Local) or not small:
            return None
        return target.rows(draws.flat()).reshape(*draws.log_density.shape, -1)


def _end(draws: Draws, has_notes: bool) -> tuple[Status, str]:
    """How sampling ended, and the same in words."""
    end = "see the warnings." if has_notes else "the walkers agree."
    if draws.interrupted:
        return Status.INTERRUPTED, f"interrupted, these are the draws so far: {end}"
    return Status.OUT_OF_BUDGET if has_notes else Status.CONVERGED, end


def _sample(
    run: Run,
    sampler: Sampler,
    target: BatchedLogLikelihood,
    prior: LogPrior,
    start: Array,
    spread: Array,
) -> Draws:
    """Draws from likelihood x prior, begun at phi (m,) with a spread (m,) in the unit box."""
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


class _Evaluate:
    """`run.evaluate`, with progress."""

    def __init__(self, run: Run, planned: int):
        self.run = run
        self.planned = planned
        self.done = 0

    def __call__(self, points: Array, function: Density) -> Array:
        answers = self.run.evaluate(points, function)
        self.done += len(points)
        highest = answers.reshape(len(points), -1)[:, 0].max()
        text = f"{self.done} points, highest here {highest:.6g}"
        self.run.progress(min(1.0, self.done / self.planned), text)
        return answers


def _unit_width(space: ParameterSpace, mean: Array, error: Array) -> Array:
    """(d,) standard errors in the unit box, at most a tenth; 0.01 for a missing one."""
    known_error = np.nan_to_num(error)
    above = space.to_unit(space.clip(mean + known_error))
    below = space.to_unit(space.clip(mean - known_error))
    width = np.clip((above - below) / 2, 1e-9, 0.1)
    return np.where(np.isfinite(error), width, 0.01)


def _gaussian(family: Any, values: Array) -> tuple[Array, Array]:
    """phi (m,) of the Gaussian with the moments of draws (K, d), and their mean (d,)."""
    mean = values.mean(axis=0)
    d = values.shape[1]
    phi = np.array(family.phi_of(mean, np.cov(values.T).reshape(d, d)))
    # A posterior may be narrower than the least scale of a search.
    names = family.unknowns.names
    for i, name in enumerate(family.space.names):
        phi[names.index(f"mean.{name}")] = mean[i]
        phi[names.index(f"scale.{name}")] = values[:, i].std(ddof=1)
    return phi, mean


def evaluate_draws(
    draws: Draws, settings: DrawSettings = DEFAULTS
) -> tuple[list[str], PosteriorDiagnostics]:
    """Diagnose draws: whether the walkers agree, and whether there are enough.

    Parameters
    ----------
    draws : Draws
    settings : DrawSettings

    Returns
    -------
    notes : list of str
        What speaks against using the draws, a sentence each.
    diagnostics : PosteriorDiagnostics
        Of each unknown, by name.
    """
    notes = []
    r_hat = draws.split_r_hat()
    ess = draws.effective_sample_size()
    try:
        times = draws.autocorrelation_time()
    except ChainTooShort as error:
        times = error.estimate
        notes.append(str(error))

    large = [
        f"{name} {r:.3f}" for name, r in zip(draws.names, r_hat, strict=True) if r > settings.r_hat
    ]
    if large:
        notes.append(
            f"split R-hat is above {settings.r_hat} ({', '.join(large)}): the walkers do not agree"
            " yet; take more steps"
        )
    least = settings.effective_sample_size
    small = [f"{name} {e:.0f}" for name, e in zip(draws.names, ess, strict=True) if e < least]
    if small:
        notes.append(
            f"the effective sample size is below {least} ({', '.join(small)}): take more steps"
        )
    found = PosteriorDiagnostics(
        autocorrelation_time=_by_name(draws, times),
        split_r_hat=_by_name(draws, r_hat),
        effective_sample_size=_by_name(draws, ess),
    )
    return notes, found


def _by_name(draws: Draws, values: Array) -> dict[str, float]:
    """The values (m,) by unknown."""
    return dict(zip(draws.names, values.tolist(), strict=True))
