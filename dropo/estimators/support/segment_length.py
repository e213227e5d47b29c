"""The horizon of the segments (the thesis' lambda), chosen by prediction of held-out data."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.likelihood import AUTOMATIC
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.fit_choices import HorizonChoice, HorizonTrial
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.errors import BadArgument, Incompatible, SimulationFailed
from dropo.core.services.validation import Array, require


@dataclass(frozen=True)
class HorizonSettings:
    """What decides which horizons are tried and how they are scored.

    Attributes
    ----------
    lengths : tuple of int
        These horizons are tried where none are named [control steps].
    minimum_segments : int
        A horizon needs so many segments in the fitted and in the held-out part.
    every : int
        The last of every so many trajectories is held out; where there are fewer, the last of so
        many parts of each.
    lowest : float
        Least standard deviation of an error, as a fraction of the signal's: smaller errors are not
        distinguished.
    lowest_fraction : float
        Least variance beside the fit's spread, as a fraction of the mean squared residual.
    """

    lengths: tuple[int, ...] = (1, 2, 5, 10, 20)
    minimum_segments: int = 10
    every: int = 3
    lowest: float = 1e-4
    lowest_fraction: float = 0.01


DEFAULTS = HorizonSettings()


@dataclass(frozen=True)
class TriedHorizon:
    """A horizon that was tried.

    Attributes
    ----------
    horizon : int
        In control steps.
    fit : Fit
        What it gives on the fitted part.
    scores : (U,) array
        Held-out log-likelihood of each unit of time [nats].
    """

    horizon: int
    fit: Fit
    scores: Array


@dataclass(frozen=True)
class ChooseHorizon(Estimator):
    """Fit with several horizons, score each on held-out data, and fit all data with the best.

    Attributes
    ----------
    estimator : Estimator
        The method that fits.
    lengths : tuple of int
        The horizons to try, in control steps.
    settings : HorizonSettings

    Raises
    ------
    BadArgument
        If there are no lengths, or one is below 1.

    Notes
    -----
    Likelihoods with different horizons are of different data, so every fit is scored on the same
    ones: predictions over all the horizons, N(f(mean), J S J' + diag(e)), with S the fit's
    covariance, J the Jacobian and e the variances that the fit leaves on the fitted part at that
    horizon. Held out are the problem's own such data, else every third trajectory, else the last
    third of each. Of the horizons whose score is within one standard error of the best one's,
    paired by units of time of the longest horizon, that with the smallest standard errors (their
    product) is taken. `horizon_choice` of the fit holds the table.
    """

    estimator: Estimator
    lengths: tuple[int, ...] = DEFAULTS.lengths
    settings: HorizonSettings = field(default_factory=HorizonSettings)

    def __post_init__(self) -> None:
        positive = len(self.lengths) >= 1 and min(self.lengths) >= 1
        rule = "whole numbers of at least 1"
        require(positive, "lengths", rule, self.lengths, "ChooseHorizon")
        # All horizons by one likelihood, that of segments.
        estimator: Any = self.estimator
        if getattr(estimator, "likelihood", None) == AUTOMATIC:
            object.__setattr__(self, "estimator", replace(estimator, likelihood="emulated"))

    @property
    def name(self) -> str:  # type: ignore[override]
        """The name of the method that fits."""
        return self.estimator.name

    @property
    def uses_priors(self) -> bool:  # type: ignore[override]
        """Whether that method uses priors."""
        return self.estimator.uses_priors

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """Fit the fitted part with each horizon, choose one, and fit all data with it."""
        if problem.reset == "start":
            raise Incompatible(
                "There is no lambda to choose with `reset: start`, where a segment is a whole"
                " trajectory."
            )
        training, unseen = split(problem, self.settings)
        horizons = self._possible_horizons(training.trajectories, unseen)
        parts = len(horizons) + 1
        seed = int(run.rng.integers(2**63))

        candidates: list[TriedHorizon] = []
        for i, horizon in enumerate(horizons):
            part = training.using(horizon=horizon)
            fit = self._fit_part(part, run, seed, i / parts, f"lambda {horizon}")
            if fit.status is Status.INTERRUPTED:
                note = (
                    f"interrupted while lambda was chosen: this is lambda = {horizon} on a part of"
                    " the data"
                )
                return replace(fit, warnings=(*fit.warnings, note))
            with run.counting(evaluations=2 * len(horizons)):
                scores = held_out_scores(training, unseen, fit, horizons, self.settings)
            candidates.append(TriedHorizon(horizon, fit, scores))

        best, choice = choose(candidates)
        whole = problem.using(horizon=best.horizon)
        text = f"lambda {best.horizon}, all data"
        fit = self._fit_part(whole, run, seed, len(horizons) / parts, text)
        tried = ", ".join(map(str, horizons))
        message = f"{fit.message} lambda = {best.horizon} predicts held-out data best, of {tried}."
        return replace(fit, message=message, horizon_choice=choice)

    def _possible_horizons(self, fitted: Trajectories, unseen: Trajectories) -> list[int]:
        """The horizons that leave enough segments in both parts; BadArgument if there is none."""
        least = self.settings.minimum_segments
        possible = []
        for horizon in self.lengths:
            if min(_count(fitted, horizon), _count(unseen, horizon)) >= least:
                possible.append(horizon)
        if not possible:
            raise BadArgument(
                f"No lambda of {self.lengths} leaves {least} segments to fit and {least} to hold"
                " out. Give lambda."
            )
        return possible

    def _fit_part(self, problem: Problem, run: Run, seed: int, done: float, what: str) -> Fit:
        """One fit, whose progress is a part of the whole's from the fraction done on."""
        fraction = 1 / (len(self.lengths) + 1)

        def show(own: float, text: str) -> None:
            run.progress(done + own * fraction, f"{what}: {text}")

        inner = Run(problem, np.random.default_rng(seed), run.evaluation_log, show)
        fit = self.estimator.fit_part(problem, inner)
        run.steps = run.steps + inner.steps
        run.failures = run.failures + inner.failures
        run.evaluations = run.evaluations + inner.evaluations
        return fit


def split(problem: Problem, settings: HorizonSettings = DEFAULTS) -> tuple[Problem, Trajectories]:
    """Split a problem's data into a part to fit and one to hold out.

    Parameters
    ----------
    problem : Problem
    settings : HorizonSettings

    Returns
    -------
    training : Problem
        The problem with the part to fit.
    unseen : Trajectories
        The problem's own held-out data, else every third trajectory, else the last third of each.
    """
    if problem.held_out is not None:
        return problem, problem.held_out
    data = problem.trajectories
    every = settings.every
    count = len(data.spans)
    if count >= every:
        out = np.arange(count) % every == every - 1
        training = data.select(np.flatnonzero(~out))
        return replace(problem, trajectories=training), data.select(np.flatnonzero(out))

    late = np.zeros(len(data), dtype=bool)
    for start, stop in data.spans:
        late[start:stop] = np.arange(stop - start) >= (stop - start) * (every - 1) // every
    training = data.rows(np.flatnonzero(~late))
    return replace(problem, trajectories=training), data.rows(np.flatnonzero(late))


def held_out_scores(
    training: Problem,
    unseen: Trajectories,
    fit: Fit,
    horizons: list[int],
    settings: HorizonSettings = DEFAULTS,
) -> Array:
    """Score a fit's predictions of held-out data over several horizons.

    Parameters
    ----------
    training : Problem
        The fitted part, from which the variances of the errors come.
    unseen : Trajectories
        What is predicted.
    fit : Fit
    horizons : list of int
        In control steps.
    settings : HorizonSettings

    Returns
    -------
    (U,) array
        Log-likelihood summed over all horizons within each unit of time, which is as long as the
        longest horizon [nats]; -inf if a simulation failed.
    """
    units = _units(unseen, max(horizons))
    scores = np.zeros(int(units.max()) + 1)
    try:
        for horizon in horizons:
            fitted = training.using(horizon=horizon)
            new = replace(training, trajectories=unseen, horizon=horizon)
            variance = _error_variance(fitted, fit, settings)
            residuals, spread = _predict(new, fit)
            density = _log_normal(residuals, spread + np.diag(variance))
            first = new.segments.steps[new.segments.rows[0], 0]
            np.add.at(scores, units[first], density)
    except SimulationFailed:
        return np.full(len(scores), -np.inf)
    return scores


def choose(candidates: Sequence[TriedHorizon]) -> tuple[TriedHorizon, HorizonChoice]:
    """Choose among horizons: the most precise one whose score is as good as the best.

    Parameters
    ----------
    candidates : sequence of TriedHorizon

    Returns
    -------
    chosen : TriedHorizon
    choice : HorizonChoice
        The table of all.
    """
    best = max(candidates, key=lambda c: c.scores.sum())
    gaps = []
    errors = []
    for candidate in candidates:
        below = np.full(len(best.scores), np.inf)
        if np.isfinite(candidate.scores).all():
            below = best.scores - candidate.scores
        error = 0.0
        if np.isfinite(below).all() and len(below) > 1:
            error = float(np.sqrt(len(below)) * np.std(below, ddof=1))
        gaps.append(float(below.sum()))
        errors.append(error)

    close = []
    for candidate, gap, error in zip(candidates, gaps, errors, strict=True):
        if gap <= error:
            close.append(candidate)
    chosen = min(close, key=_log_errors)

    trials = []
    for candidate, gap, error in zip(candidates, gaps, errors, strict=True):
        trial = HorizonTrial(
            horizon=candidate.horizon,
            below_best=gap if np.isfinite(gap) else np.nan,
            paired_error=error,
            chosen=candidate is chosen,
            mean=tuple(candidate.fit.mean.tolist()),
            mean_se=tuple(candidate.fit.mean_se.tolist()),
        )
        trials.append(trial)
    return chosen, HorizonChoice(tuple(trials))


def _log_errors(candidate: TriedHorizon) -> float:
    """The logarithm of the product of a fit's standard errors."""
    errors = np.nan_to_num(candidate.fit.mean_se, nan=np.inf, posinf=np.inf)
    return float(np.sum(np.log(errors)))


def _count(data: Trajectories, horizon: int) -> int:
    """How many whole segments of that horizon the trajectories have."""
    return sum((stop - start) // horizon for start, stop in data.spans)


def _units(data: Trajectories, longest: int) -> Ints:
    """(N,) the unit of each transition: pieces of trajectories of the longest horizon."""
    units = np.empty(len(data), dtype=np.int64)
    before = 0
    for start, stop in data.spans:
        units[start:stop] = before + np.arange(stop - start) // longest
        before = int(units[stop - 1]) + 1
    return units


def _error_variance(problem: Problem, fit: Fit, settings: HorizonSettings) -> Array:
    """(p,) variance of the residuals beside the fit's spread, with a lower bound."""
    residuals, spread = _predict(problem, fit)
    beside = np.mean(residuals**2 - np.einsum("rpp->rp", spread), axis=0)
    signal = np.var(problem.simulator.targets(problem.segments), axis=0)
    return np.maximum.reduce(
        [
            beside,
            settings.lowest_fraction * np.mean(residuals**2, axis=0),
            settings.lowest**2 * signal,
            np.full(len(signal), 1e-24),
        ]
    )


def _predict(problem: Problem, fit: Fit) -> tuple[Array, Array]:
    """Residuals (R, p) at the fit's mean, and the linearized covariance (R, p, p) of its spread."""
    predicted, jacobian = problem.simulator.linearize(fit.mean, problem.segments)
    covariance = fit.correlation * np.outer(fit.sd, fit.sd)
    spread = jacobian @ covariance @ jacobian.swapaxes(1, 2)
    return problem.simulator.targets(problem.segments) - predicted, spread


def _log_normal(residuals: Array, sigma: Array) -> Array:
    """(R,) log N(residual; 0, sigma)."""
    solved = np.linalg.solve(sigma, residuals[:, :, None])[:, :, 0]
    distance = np.sum(residuals * solved, axis=1)
    return np.asarray(-0.5 * (distance + np.linalg.slogdet(2 * np.pi * sigma)[1]))
