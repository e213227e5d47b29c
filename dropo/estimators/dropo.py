"""DROPO: the distribution of the parameters that makes the measured segments most likely."""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Literal

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import (
    AUTOMATIC,
    GroupedLogLikelihood,
    Likelihood,
    LocalLikelihood,
    LocalLogLikelihood,
    LogLikelihood,
    RunLikelihood,
)
from dropo.core.contracts.noise import Noise
from dropo.core.contracts.optimizer import Optimizer
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import describe_failures
from dropo.core.contracts.support.maximize import SearchResult, maximize
from dropo.core.contracts.support.mean_prior import MeanPrior, mean_places, with_prior, within_prior
from dropo.core.numerics.kept_rows import MEMORY, MemorySettings
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.fit_parts import StartFilter
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.start_mean import Start, checked_start, given_start
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, known, require
from dropo.estimators.support.epsilon import TAILS, noise_scale, noise_shape, tail_degrees, tune
from dropo.estimators.support.family_of_groups import family_warnings
from dropo.estimators.support.far_groups import with_models_of_their_own
from dropo.estimators.support.filtered_starts import fit_from_filtered_starts
from dropo.estimators.support.final_step import corrected_by_simulation
from dropo.estimators.support.first_mean.global_search import (
    GlobalStart,
    best_start,
    is_wide,
    may_have_several,
)
from dropo.estimators.support.first_mean.search import Search, Searched, search_from
from dropo.estimators.support.physics_step import checked_by_shorter_steps
from dropo.estimators.support.point_estimate import estimate
from dropo.estimators.support.rough_starts import (
    SEARCH,
    SMOOTHED,
    SearchSettings,
    search_settings,
    starts_are_rough,
)
from dropo.estimators.support.summary import as_found, summarize
from dropo.estimators.support.trust_region import MakeOptimizer, OuterIterations
from dropo.estimators.support.whole_runs import (
    NOISY,
    bound_to_segments,
    may_follow_runs,
    reason_to_follow,
    starts_are_noisy,
)
from dropo.evaluation.emulator_check import check_emulator, parameters_without_spread
from dropo.evaluation.held_out import held_out_errors
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.mjmodel.standing import refuse_unknown_base

LONG_TAILS = "The noise has long tails: a Student t of {:.3g} degrees of freedom."
SWEEP = tuple(10.0**k for k in range(-8, -1))
"""Noise variances of figure 6.4: 1e-8, 1e-7, ..., 1e-2 [signal unit^2]."""


@dataclass(frozen=True, kw_only=True)
class DROPO(Estimator):
    """Maximise the log-likelihood of the segments over a family of distributions.

    As published (Tiboni 2021, chapter 5): likelihood "monte-carlo" with 100 draws, anew at every
    evaluation (redraw), family "truncated_gaussian", optimizer "cma-es-once", a budget of 5000
    evaluations, start "middle".

    Attributes
    ----------
    likelihood : str or Likelihood
        A name, or one with settings of its own. "auto": "trajectory", which finds the start states
        of whole runs, where part of the state was not measured, or where rows follow each other and
        residuals say that they begin with noisy measurements; else "emulated". Only for segments of
        one step without an optimizer of one's own.
    family : str
        The family of distributions.
    optimizer : str or None
        None: Fisher scoring where the likelihood knows its information, else "cma-es".
    epsilon : float, tuple of float, "learn", "tune" or None
        The noise variance, one or for each signal [signal unit^2]. "learn": one for each signal,
        found with the rest (sampled likelihoods: one factor on the variances that least squares
        leaves). "tune": the smallest of `sweep` whose fit has a mean squared error of at most
        `mse_threshold` (section 5.3). None: the problem's own where it names one, else "learn".
    draws : int or None
        Of a sampled likelihood, for each transition in one evaluation.
    redraw : bool
        Whether a sampled likelihood has draws of their own for every evaluation.
    budget : int
        Evaluations of one search at most; of a local likelihood no further round begins after so
        many.
    start : {"middle", "least-squares", "random"}, mapping, sequence of float or Fit
        The first mean: the middle of the box, a least-squares estimate, or drawn from the box
        (uniformly, in logarithms where a parameter is searched so); values by parameter (those left
        out are in the middle) or of all of them in order; or the mean of another fit.
    sweep : tuple of float
        The noise variances that "tune" tries [signal unit^2].
    mse_threshold : float or None
        The largest mean squared error that "tune" accepts. None: 1.1 times the smallest one of the
        sweep.
    start_noise : bool or None
        Whether the measured start states carry the noise too; None: as the problem says.
    starts : {"measured", "filtered"}
        Segments start from the measured states, or (local likelihoods; noise on all measurements)
        from states that a Kalman filter makes of the measurements up to them.
    degrees : float or None
        The degrees of freedom of a Student t in the Gaussian's place; None: as the problem says.
    memory : MemorySettings
        How much memory a fit by a local likelihood may take, however many transitions there are;
        what is more is kept in temporary files. A likelihood that is given keeps to its own.
    noise : {"auto", "gaussian"}
        What learned noise may be where neither this nor the problem gives degrees. "auto": a
        Student t where the residuals of a Gaussian fit have longer tails (outliers among them), and
        with a memory in whole runs. "gaussian": nothing else, but in whole runs.
    search : SearchSettings
        How a local likelihood is searched: trust regions, and points of the whole box before.

    Raises
    ------
    UnknownName
        If a likelihood, or a named `start`, `starts`, `noise` or `epsilon`, is none of those that
        it may be.
    BadArgument
        If `budget` is below 1, `degrees` is not above 2, or `draws` or `redraw` is given beside a
        likelihood that brings its own settings.
    Incompatible
        If `draws` or `redraw` is given for a likelihood that draws nothing; by `fit`, if the
        likelihood cannot be fitted with the optimizer, the starts or the effects that are there, or
        the data lack the pose of a base that may touch something.
    SimulationFailed
        By `fit`, if the simulator diverges where a search of a sampled likelihood begins.

    Notes
    -----
    Priors of the problem are those of the means: the fit maximises log-likelihood + log prior, and
    `priors` of the fit says how much of what is known they give. `log_likelihood` is that of the
    data alone.

    References
    ----------
    G. Tiboni, "Towards safe and efficient transfer of robot policies from simulation to real
    world", thesis, Politecnico di Torino, 2021.
    """

    likelihood: str | Likelihood = AUTOMATIC
    family: str = "truncated_gaussian"
    optimizer: str | None = None
    epsilon: float | tuple[float, ...] | Literal["learn", "tune"] | None = None
    draws: int | None = None
    redraw: bool = False
    budget: int = 5000
    start: Start = "middle"
    sweep: tuple[float, ...] = SWEEP
    mse_threshold: float | None = None
    start_noise: bool | None = None
    starts: Literal["measured", "filtered"] = "measured"
    degrees: float | None = None
    memory: MemorySettings = MEMORY
    noise: Literal["auto", "gaussian"] = "auto"
    search: SearchSettings = SEARCH
    name = "dropo"
    uses_priors = True

    def __post_init__(self) -> None:
        start = checked_start(self.start, ("least-squares", "middle", "random"))
        object.__setattr__(self, "start", start)
        known("starts", self.starts, ("measured", "filtered"))
        known("noise", self.noise, ("auto", "gaussian"))
        if isinstance(self.epsilon, str):
            known("epsilon", self.epsilon, ("learn", "tune"))
        require(self.budget >= 1, "budget", "at least 1", self.budget, "DROPO")
        has_variance = self.degrees is None or self.degrees > 2
        require(has_variance, "degrees", "above 2, to have a variance", self.degrees, "DROPO")
        draws_are_free = self.draws is None or isinstance(self.likelihood, str)
        rule = "left out where the likelihood brings its own"
        require(draws_are_free, "draws", rule, self.draws, "DROPO")
        own = not self.redraw or isinstance(self.likelihood, str)
        require(own, "redraw", rule, self.redraw, "DROPO")
        self._make_likelihood()  # so that a wrong name is refused at once

    # --- what is fitted: the likelihood, the noise, the first mean

    @property
    def _likelihood_name(self) -> str:
        """The name of the likelihood of segments."""
        if not isinstance(self.likelihood, str):
            return type(self.likelihood).__name__
        return "emulated" if self.likelihood == AUTOMATIC else self.likelihood

    def _make_likelihood(self) -> Likelihood:
        """The likelihood that the settings name."""
        if not isinstance(self.likelihood, str):
            return self.likelihood
        kind = find("likelihoods", self._likelihood_name)
        settings = [setting.name for setting in fields(kind)] if is_dataclass(kind) else []
        given: dict[str, Any] = {}
        if self.draws is not None:
            given["draws"] = self.draws
        if self.redraw:
            given["redraw"] = True
        for setting in given:
            if setting not in settings:
                raise Incompatible(
                    f"The likelihood {self._likelihood_name!r} draws nothing. Leave {setting} out,"
                    " or use 'monte-carlo'."
                )
        if "memory" in settings:
            given["memory"] = self.memory
        return kind(**given)

    def _make_noise(
        self, problem: Problem, variance: Any, learned: Literal["factor", "each"] | None = None
    ) -> Noise:
        """The noise of that variance, or of learned factors on it."""
        start_noise = self.start_noise
        if start_noise is None:
            start_noise = problem.start_noise and not starts_are_rough(problem)
        degrees = problem.noise_degrees if self.degrees is None else self.degrees
        if degrees is None and self.noise == AUTOMATIC and learned and starts_are_rough(problem):
            degrees = self.search.rough.degrees
        return Noise(
            np.asarray(variance, dtype=float),
            learned,
            # Filtered starts begin with a fit whose measured starts carry noise.
            start=start_noise or self.starts == "filtered",
            degrees=degrees,
        )

    def _first_mean(self, problem: Problem, run: Run, rng: np.random.Generator) -> Array:
        """(d,) means where the search begins, in the parameters' units."""
        space = problem.space
        given = given_start(self.start, space)
        if given is not None:
            return given
        if self.start == "least-squares":
            with run.beginning():
                return estimate(problem, run).value
        if self.start == "random":
            return space.from_unit(rng.random(len(space)))
        return (space.low + space.high) / 2

    # --- the fit

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """With the noise that the settings ask for: swept, given, or learned with the rest."""
        if isinstance(problem.simulator, RobotSimulator) and problem.reset == "transition":
            observed = problem.simulator.layout.observed("qpos")
            refuse_unknown_base(problem.simulator.model, observed)
        # Every fit of a sweep draws alike, so that fits differ by their noise alone.
        seeds = run.rng.integers(2**63, size=3)
        if self.epsilon == "tune":

            def fit_at(variance: float) -> Fit:
                noise = self._make_noise(problem, variance)
                return self._fit_with_noise(problem, run, noise, seeds)

            return tune(fit_at, self.sweep, self.mse_threshold, problem, run)

        # A given noise stays; else it is learned: each signal's own variance, or for a sampled
        # likelihood one factor on the variances that least squares leaves.
        given = problem.epsilon if self.epsilon is None else self.epsilon
        if given is not None and not isinstance(given, str):
            noise = self._make_noise(problem, given)
        elif isinstance(self._make_likelihood(), LocalLikelihood | RunLikelihood):
            noise = self._make_noise(problem, noise_scale(problem, run), "each")
        else:
            noise = self._make_noise(problem, noise_shape(problem, run), "factor")
        return self._fit_with_noise(problem, run, noise, seeds)

    def _fit_with_noise(self, problem: Problem, run: Run, noise: Noise, seeds: Ints) -> Fit:
        """One fit, of whole runs or of segments, by the likelihood that the settings name.

        seeds (3,): of the likelihood, of the optimizer, of a random start.
        """
        likelihood_rng = np.random.default_rng(int(seeds[0]))
        optimizer_rng = np.random.default_rng(int(seeds[1]))
        start_rng = np.random.default_rng(int(seeds[2]))
        prior = MeanPrior(problem.priors, problem.space)
        family = within_prior(find("families", self.family)(problem.space), prior)
        likelihood = self._make_likelihood()
        mean = self._first_mean(problem, run, start_rng)

        # A likelihood of whole runs was asked for.
        if isinstance(likelihood, RunLikelihood):
            mean = prior.within.clip(mean)
            return self._fit_runs(problem, run, family, likelihood, noise, mean, reason=None)

        # It is chosen, as where part of the state was not measured.
        reason = reason_to_follow(problem) if self._may_follow_runs(problem) else None
        if reason is not None:
            first = self._first_mean_of_runs(problem, run, mean)
            try:
                return self._follow_runs(problem, run, family, noise, first, reason)
            except SimulationFailed as error:
                problem = _without_runs(problem, error)

        # Segments are fitted by a local likelihood. Single steps from states that were only
        # estimated would mislead a search of the whole box.
        if isinstance(likelihood, LocalLikelihood):
            elsewhere = None
            misleading = reason is not None and problem.horizon == 1
            if not misleading:
                elsewhere = self._best_of_box(problem, run, mean)
            if elsewhere is not None:
                mean = elsewhere.value
                problem = replace(problem, warnings=(*problem.warnings, *elsewhere.warnings))
            mean = prior.within.clip(mean)
            return self._fit_locally(
                problem, run, family, likelihood, noise, mean, likelihood_rng, elsewhere
            )

        # Segments are fitted by a sampled likelihood.
        mean = prior.within.clip(mean)
        if self.starts == "filtered":
            raise Incompatible(
                f"{self._likelihood_name!r} takes no filtered starts. Use 'emulated', 'linear' or"
                " 'unscented'."
            )
        objective = likelihood.bind(
            problem.simulator, problem.segments, family, noise, likelihood_rng
        )
        return self._fit_sampled(problem, run, family, objective, mean, optimizer_rng)

    def _first_mean_of_runs(self, problem: Problem, run: Run, mean: Array) -> Array:
        """The mean (d,) from which whole runs are followed: where these were asked for, their
        segments show roughly where to begin.
        """
        if problem.whole_runs:
            mean = best_start(problem, run, mean, self.search.rough.points).value
        return MeanPrior(problem.priors, problem.space).within.clip(mean)

    def _best_of_box(self, problem: Problem, run: Run, mean: Array) -> GlobalStart | None:
        """Where a local search begins in a wide box, or where a motion may repeat: near the best of
        several optima. None in other problems.
        """
        if not (is_wide(problem.space) or may_have_several(problem)):
            return None
        return best_start(problem, run, mean, search_settings(problem, self.search)[1])

    # --- the fit of segments

    def _fit_sampled(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        objective: LogLikelihood,
        mean: Array,
        rng: np.random.Generator,
    ) -> Fit:
        """The fit by a sampled log-likelihood, which is searched as it is, over the whole box."""
        start = first_member(family, objective.unknowns, mean)
        check_start(problem, run, family, start)
        # Rounding may carry a start on a bound out of the unit box. The first steps of "cma-es" are
        # a quarter of that box: the thesis' 1 in [0, 4].
        unit_start = np.clip(objective.unknowns.to_unit(start), 0.0, 1.0)
        kind = find("optimizers", self.optimizer or "cma-es")
        optimizer = kind(len(unit_start), rng, start=unit_start, budget=self.budget)
        prior = MeanPrior(problem.priors, problem.space)
        found = maximize(with_prior(objective, prior), objective.unknowns, optimizer, run)
        if prior:
            of_prior = prior.value(found.point[mean_places(objective, problem.space)])
            found = replace(found, value=found.value - of_prior)
        return self._summarise(problem, run, family, objective, found)

    def _fit_locally(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        likelihood: LocalLikelihood,
        noise: Noise,
        mean: Array,
        rng: np.random.Generator,
        elsewhere: GlobalStart | None,
    ) -> Fit:
        """The fit by a local likelihood, which is built again wherever its maximum is found."""
        search = self._local_search(problem, run, family, likelihood, rng)
        points = search_settings(problem, self.search)[1]
        searched = search_from(problem, run, family, noise, mean, elsewhere, search, points)
        searched = _with_smoothing_noted(searched)

        # Where its residuals say that starts are noisy, go on with starts that are found.
        if self._has_noisy_starts(searched, run, family):
            found_mean = searched.mean(family)
            try:
                return self._follow_runs(
                    searched.problem, run, family, searched.noise, found_mean, NOISY
                )
            except SimulationFailed as error:
                searched = replace(searched, problem=_without_runs(searched.problem, error))

        # Where residuals have long tails, so has the noise.
        searched = self._with_tails(searched, family, search)
        problem = searched.problem
        objective = searched.objective
        found = searched.found

        # Filter the start states at the estimate, and fit from there.
        start_filter: StartFilter | None = None
        if self.starts == "filtered":
            problem, objective, found, start_filter = fit_from_filtered_starts(
                search, problem, run, family, searched.noise, objective, found
            )

        return self._fit_at_maximum(
            problem, run, family, objective, found, start_filter=start_filter, rng=rng
        )

    def _local_search(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        likelihood: LocalLikelihood,
        rng: np.random.Generator,
    ) -> Search:
        """The search by outer iterations, in regions as the problem asks for."""
        make_optimizer = None
        if self.optimizer:
            make_optimizer = self._local_optimizer(self.optimizer, rng)
        regions, _ = search_settings(problem, self.search)
        regions = replace(regions, budget=self.budget)

        def search(
            problem: Problem, noise: Noise, mean: Array, width: Array | None = None
        ) -> tuple[LocalLogLikelihood, SearchResult]:
            iterations = OuterIterations(
                problem, run, family, likelihood, noise, rng, make_optimizer, regions
            )
            return iterations.fit(mean, width)

        return search

    def _has_noisy_starts(self, searched: Searched, run: Run, family: Family) -> bool:
        """Whether residuals of single steps say that these begin with noisy measurements, and whole
        runs may be followed instead.
        """
        problem = searched.problem
        found = searched.found
        interrupted = found.status is Status.INTERRUPTED
        if interrupted or problem.horizon != 1 or not self._may_follow_runs(problem):
            return False
        prediction = searched.objective.mean(found.point)
        return starts_are_noisy(problem, run, searched.mean(family), prediction)

    def _fit_at_maximum(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        objective: LocalLogLikelihood,
        found: SearchResult,
        *,
        start_filter: StartFilter | None,
        rng: np.random.Generator,
    ) -> Fit:
        """The fit at a maximum of a local likelihood, with what simulations there say of it."""
        run.best = as_found(problem, **self._of_maximum(family, objective, found))

        # Where nothing varies, the simulator itself has the last word on the means.
        constant = tuple(parameters_without_spread(family, objective, found.point))
        varying = [name for name in problem.space.names if name not in constant]
        fitted_scales = [name for name in varying if f"scale.{name}" in objective.unknowns.names]
        nothing_varies = not fitted_scales
        if nothing_varies and found.status is not Status.INTERRUPTED:
            objective, found = corrected_by_simulation(problem, run, family, objective, found)

        # Groups far from the population's centre get local models of their own.
        group_warnings: list[str] = []
        checked_by_group = False
        if isinstance(objective, GroupedLogLikelihood) and found.status is not Status.INTERRUPTED:
            checked_by_group = True
            prior = MeanPrior(problem.priors, problem.space)
            objective, found, group_warnings = with_models_of_their_own(
                run, objective, found, rng, prior
            )

        # Compare the local model with the simulator at the fit, then with one of shorter steps.
        spent = run.steps
        check, emulator_warnings = check_emulator(
            problem,
            run,
            family,
            objective,
            found.point,
            rng,
            alike=nothing_varies,
            confirmed=checked_by_group and not group_warnings,
        )
        fit = self._summarise(
            problem,
            run,
            family,
            objective,
            found,
            warnings=[*group_warnings, *emulator_warnings],
            emulator_check=check,
            start_filter=start_filter,
            constant_parameters=constant,
        )
        return checked_by_shorter_steps(problem, run, fit, objective, found.point, spent=spent)

    def _local_optimizer(self, name: str, rng: np.random.Generator) -> MakeOptimizer:
        """What makes the optimizer of that name inside each outer iteration."""
        kind = find("optimizers", name)

        def make(dimension: int, start: Array) -> Optimizer:
            made: Optimizer = kind(
                dimension, rng.spawn(1)[0], start=start, step=0.1, budget=self.budget
            )
            return made

        return make

    def _with_tails(self, searched: Searched, family: Family, search: Search) -> Searched:
        """The maximum under noise of long tails, where residuals ask for such; else as it is."""
        degrees = self._tail_degrees(searched, family)
        if degrees is None:
            return searched
        noise = replace(searched.noise, degrees=degrees)
        mean = searched.mean(family)
        objective, found = search(searched.problem, noise, mean, searched.width)
        found = replace(found, reason=f"{found.reason} {LONG_TAILS.format(degrees)}")
        return replace(searched, noise=noise, objective=objective, found=found)

    def _tail_degrees(self, searched: Searched, family: Family) -> float | None:
        """The degrees of freedom that the residuals of a Gaussian fit ask for, if they may."""
        problem = searched.problem
        noise = searched.noise
        found = searched.found
        learned = self.noise == AUTOMATIC and noise.learned == "each" and noise.degrees is None
        if not learned or found.status is Status.INTERRUPTED:
            return None
        moments = searched.objective.moments(found.point)
        if moments is None:
            return None
        mean, covariance = moments
        factors = found.point[len(family.unknowns) :]
        targets = problem.simulator.targets(problem.segments)
        return tail_degrees(targets - mean, covariance, factors > TAILS.rounding)

    # --- the fit of whole runs

    def _may_follow_runs(self, problem: Problem) -> bool:
        """Whether a likelihood of whole runs may be chosen."""
        automatic = self.likelihood == AUTOMATIC and self.optimizer is None
        as_usual = self.starts == "measured" and self.epsilon != "tune"
        return automatic and as_usual and may_follow_runs(problem)

    def _follow_runs(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        noise: Noise,
        mean: Array,
        reason: str,
    ) -> Fit:
        """The fit of whole runs, where their likelihood was not asked for but chosen.

        reason: why, a sentence for the message of the fit.
        """
        likelihood = find("likelihoods", "trajectory")()
        run.progress(0.0, reason)
        return self._fit_runs(problem, run, family, likelihood, noise, mean, reason)

    def _fit_runs(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        likelihood: RunLikelihood,
        noise: Noise,
        mean: Array,
        reason: str | None,
    ) -> Fit:
        """The fit by a likelihood that finds the start states of whole runs, from a first mean.

        reason: why it was chosen; None where it was asked for.
        """
        if self.optimizer is not None or self.starts == "filtered":
            raise Incompatible(
                "A likelihood of whole runs finds parameters and starts by a search of its own."
                " Leave 'optimizer' and 'starts' out, or use 'emulated'."
            )
        effects = bound_to_segments(problem)
        if effects:
            raise Incompatible(
                f"{effects[0]} acts by the time since a segment's start or on the sensors, which"
                " whole runs cannot have. Use 'emulated'."
            )

        # Search from the first mean, or, where simulations around it diverge, from the point of the
        # box that follows the measurements best.
        try:
            run_fit = likelihood.fit_runs(problem, run, family, noise, mean)
        except SimulationFailed:
            start = best_start(problem, run, mean, search_settings(problem, self.search)[1])
            run_fit = likelihood.fit_runs(problem, run, family, noise, start.best)

        # The fit, of the rows that start from the states that were found.
        found = run_fit.found
        name = self._likelihood_name
        if reason is not None:
            found = replace(found, reason=f"{found.reason} {reason}")
            name = "trajectory"
        fit = self._summarise(
            run_fit.problem,
            run,
            family,
            run_fit.objective,
            found,
            details=run_fit.details,
            likelihood=name,
            optimizer="gauss-newton",
        )

        # What the search warns of counts against the model; what it did not reach has no errors.
        check = fit.model_check
        if run_fit.warnings and check is not None:
            sentences = (*check.sentences, *run_fit.warnings)
            check = replace(check, passed=False, sentences=sentences)
        if not run_fit.reached:
            unknown = np.full(len(fit.mean), np.nan)
            fit = replace(fit, mean_se=unknown, scale_se=unknown)
        fit = replace(fit, model_check=check, warnings=(*fit.warnings, *run_fit.warnings))
        fit = checked_by_shorter_steps(run_fit.problem, run, fit, run_fit.objective, found.point)

        # Noise and held-out errors are those of the problem that was given.
        return replace(
            fit,
            epsilon=run_fit.epsilon,
            held_out=held_out_errors(problem, run, fit.mean),
        )

    # --- the end of any fit

    def _summarise(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        objective: LogLikelihood,
        found: SearchResult,
        **further: Any,
    ) -> Fit:
        """The fit at a maximum; further: what else `summarize` takes."""
        with run.counting():
            of_maximum = self._of_maximum(family, objective, found)
        given = {**of_maximum, "objective": objective, "memory": self.memory, **further}
        fit = summarize(problem, run, **given)

        # Do the groups of recordings spread as the family says? Only these likelihoods can tell.
        fits_the_spread = fit.likelihood in ("emulated", "random-effects")
        if not (fits_the_spread and isinstance(objective, LocalLogLikelihood)):
            return fit
        if fit.status is Status.INTERRUPTED:
            return fit
        rng = run.rng.spawn(1)[0]
        warnings = self._family_warnings(problem, family, objective, found.point, fit, rng)
        return replace(fit, warnings=(*fit.warnings, *warnings))

    def _family_warnings(
        self,
        problem: Problem,
        family: Family,
        objective: LocalLogLikelihood,
        phi: Array,
        fit: Fit,
        rng: np.random.Generator,
    ) -> list[str]:
        """What groups of recordings say against the family."""
        return family_warnings(problem, family, objective, phi, fit, rng)

    def _of_maximum(
        self, family: Family, objective: LogLikelihood, found: SearchResult
    ) -> dict[str, Any]:
        """What of a fit is known where its search ends."""
        is_local = isinstance(objective, LocalLogLikelihood)
        return {
            "method": self.name,
            "family": family,
            "family_name": self.family,
            "phi": found.point,
            "epsilon": objective.epsilon(found.point),
            "log_likelihood": found.value,
            "mean_prediction": objective.mean(found.point),
            "status": found.status,
            "message": found.reason,
            "likelihood": self._likelihood_name,
            "optimizer": self.optimizer or ("fisher-scoring" if is_local else "cma-es"),
        }


def _without_runs(problem: Problem, error: SimulationFailed) -> Problem:
    """The problem with a warning that its whole runs could not be followed."""
    warning = f"start states could not be found along whole runs: {error}"
    return replace(problem, warnings=(*problem.warnings, warning))


def _with_smoothing_noted(searched: Searched) -> Searched:
    """What was found, with a sentence where errors of the starts were not carried on."""
    problem = searched.problem
    found = searched.found
    if problem.start_noise and not searched.noise.start and starts_are_rough(problem):
        found = replace(found, reason=f"{found.reason} {SMOOTHED}")
    return replace(searched, found=found)


def first_member(family: Family, unknowns: ParameterSpace, mean: Array) -> Array:
    """Find the member of a family where a search begins.

    Parameters
    ----------
    family : Family
        The distributions.
    unknowns : ParameterSpace
        The family's, and behind them the likelihood's own.
    mean : (d,) array
        The means, in the parameters' units.

    Returns
    -------
    (m,) array
        The family's phi of that mean; the likelihood's own unknowns are in the middle of their
        bounds.
    """
    start = unknowns.from_unit(np.full(len(unknowns), 0.5))
    start[: len(family.unknowns)] = family.phi(mean)
    return start


def check_start(problem: Problem, run: Run, family: Family, phi: Array) -> None:
    """Refuse to search where the simulator diverges at the start's mean already.

    Parameters
    ----------
    problem : Problem
        The segments and their simulator.
    run : Run
        Counts the simulations.
    family : Family
        The distributions.
    phi : (m,) array
        The member where the search would begin.

    Raises
    ------
    SimulationFailed
        Where a prediction is not finite.
    """
    values = family.mean(phi[: len(family.unknowns)])[None]
    with run.counting():
        predictions = problem.simulator.predict(values, problem.segments)
    if not np.isfinite(predictions).all():
        sentence = describe_failures(predictions, values, problem.space)
        raise SimulationFailed(f"{sentence} Leave those segments out, or start elsewhere.")
