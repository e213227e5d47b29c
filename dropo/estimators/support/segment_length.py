"""The length of the segments (the thesis' lambda), chosen by how well what each one gives predicts
data that it has not seen.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit, Status
from dropo.core.records.fit_choices import HorizonChoice, HorizonTrial
from dropo.core.records.trajectories import Ints, Trajectories
from dropo.core.services.errors import BadArgument, Incompatible, SimulationFailed
from dropo.core.services.validation import Array, require

LENGTHS = (1, 2, 5, 10, 20)
FEWEST = 10  # segments that a candidate needs in the fitted and in the held-out part
EVERY = 3  # every third trajectory, or the last third of each, is held out
FLOOR = 1e-4  # of a signal's standard deviation: errors below it are not told apart


@dataclass(frozen=True)
class _Candidate:
    """A lambda, the fit that it gives on the fitted part, and its held-out log-likelihood by unit
    (U,).
    """

    length: int
    fit: Fit
    scores: Array


@dataclass(frozen=True)
class ChooseHorizon(Estimator):
    """Fits with each lambda of `lengths`, scores what it finds on data held out, and fits all data
    again with the best.

    Likelihoods at different lambda are of different data. So every fit is scored on the same ones:
    predictions over all the lengths, N(f(mean), J S J' + diag(e)), with S the fit's covariance, J
    the Jacobian and e the variances that it leaves on the fitted part at that length. Held out are
    the problem's own such data, else every third trajectory, else the last third. Of the lambdas
    whose score is within one standard error of the best one's, paired by units of time of the
    longest length, that with the smallest standard errors is taken (their product).
    `horizon_choice` of the fit has the table.
    """

    estimator: Estimator
    lengths: tuple[int, ...] = LENGTHS

    def __post_init__(self) -> None:
        require(
            len(self.lengths) >= 1 and min(self.lengths) >= 1,
            "lengths",
            "whole numbers of at least 1",
            self.lengths,
            "ChooseHorizon",
        )

    @property
    def name(self) -> str:  # type: ignore[override]
        """The method's own."""
        return self.estimator.name

    def _fit(self, problem: Problem, run: Run) -> Fit:
        if problem.reset == "start":
            raise Incompatible(
                "There is no lambda to choose with `reset: start`, where a segment is a "
                "whole trajectory."
            )
        training, unseen = split(problem)
        lengths = [
            n
            for n in self.lengths
            if min(_count(training.trajectories, n), _count(unseen, n)) >= FEWEST
        ]
        if not lengths:
            raise BadArgument(
                f"No lambda of {self.lengths} leaves {FEWEST} segments to fit and {FEWEST} "
                "to hold out. Give lambda."
            )
        seed = int(run.rng.integers(2**63))
        candidates: list[_Candidate] = []
        for i, n in enumerate(lengths):
            fit = self._part(
                training.using(length=n), run, seed, i / (len(lengths) + 1), f"lambda {n}"
            )
            if fit.status is Status.INTERRUPTED:
                return replace(
                    fit,
                    warnings=(
                        *fit.warnings,
                        (
                            f"interrupted while lambda was chosen: this is lambda = {n} on a "
                            "part of the data"
                        ),
                    ),
                )
            with run.counting(evaluations=2 * len(lengths)):
                candidates.append(
                    _Candidate(n, fit, held_out_scores(training, unseen, fit, lengths))
                )
        best, choice = choose(candidates)
        fit = self._part(
            problem.using(length=best.length),
            run,
            seed,
            len(lengths) / (len(lengths) + 1),
            f"lambda {best.length}, all data",
        )
        message = (
            f"{fit.message} lambda = {best.length} predicts held-out data best, of "
            f"{', '.join(map(str, lengths))}."
        )
        return replace(fit, message=message, horizon_choice=choice)

    def _part(self, problem: Problem, run: Run, seed: int, done: float, what: str) -> Fit:
        share = 1 / (len(self.lengths) + 1)
        inner = Run(
            problem,
            np.random.default_rng(seed),
            run.evaluation_log,
            lambda s, text: run.progress(done + s * share, f"{what}: {text}"),
        )
        fit = self.estimator._fit(problem, inner)
        run.steps = run.steps + inner.steps
        run.failures = run.failures + inner.failures
        run.evaluations = run.evaluations + inner.evaluations
        return fit


def split(problem: Problem) -> tuple[Problem, Trajectories]:
    """The part to fit, and what is held out."""
    data = problem.trajectories
    if problem.held_out is not None:
        return problem, problem.held_out
    count = len(data.spans)
    if count >= EVERY:
        out = np.arange(count) % EVERY == EVERY - 1
        return replace(problem, trajectories=data.select(np.flatnonzero(~out))), data.select(
            np.flatnonzero(out)
        )
    late = np.concatenate(
        [
            np.arange(stop - start) >= (stop - start) * (EVERY - 1) // EVERY
            for start, stop in data.spans
        ]
    )
    return replace(problem, trajectories=data.rows(np.flatnonzero(~late))), data.rows(
        np.flatnonzero(late)
    )


def held_out_scores(training: Problem, unseen: Trajectories, fit: Fit, lengths: list[int]) -> Array:
    """(U,) log-likelihood [nats] of held-out predictions over each of the lengths, summed within
    units of the longest; -inf where a simulation failed.
    """
    units = _units(unseen, max(lengths))
    scores = np.zeros(int(units.max()) + 1)
    try:
        for n in lengths:
            known = training.using(length=n)
            new = replace(training, trajectories=unseen, length=n)
            residuals, spread = _predicted(known, fit)
            variance = np.mean(residuals**2 - np.einsum("rpp->rp", spread), axis=0)
            signal = np.var(known.simulator.targets(known.segments), axis=0)
            variance = np.maximum.reduce(
                [
                    variance,
                    0.01 * np.mean(residuals**2, axis=0),
                    FLOOR**2 * signal,
                    np.full(len(signal), 1e-24),
                ]
            )
            residuals, spread = _predicted(new, fit)
            density = _log_normal(residuals, spread + np.diag(variance))
            np.add.at(scores, units[new.segments.steps[new.segments.rows[0], 0]], density)
    except SimulationFailed:
        return np.full(len(scores), -np.inf)
    return scores


def choose(candidates: list[_Candidate]) -> tuple[_Candidate, HorizonChoice]:
    """The candidate to take, and the table of all."""
    best = max(candidates, key=lambda c: c.scores.sum())
    rows = []
    for c in candidates:
        gap = (
            best.scores - c.scores
            if np.isfinite(c.scores).all()
            else np.full(len(best.scores), np.inf)
        )
        error = (
            float(np.sqrt(len(gap)) * np.std(gap, ddof=1))
            if np.isfinite(gap).all() and len(gap) > 1
            else 0.0
        )
        rows.append((c, float(gap.sum()), error))
    close = [c for c, gap, error in rows if gap <= error]
    chosen = min(
        close,
        key=lambda c: float(
            np.sum(np.log(np.nan_to_num(c.fit.mean_se, nan=np.inf, posinf=np.inf)))
        ),
    )
    trials = tuple(
        HorizonTrial(
            horizon=c.length,
            below_best=gap if np.isfinite(gap) else np.nan,
            paired_error=error,
            chosen=c is chosen,
            mean=tuple(c.fit.mean.tolist()),
            mean_se=tuple(c.fit.mean_se.tolist()),
        )
        for c, gap, error in rows
    )
    return chosen, HorizonChoice(trials)


def _count(data: Trajectories, length: int) -> int:
    return sum((stop - start) // length for start, stop in data.spans)


def _units(data: Trajectories, longest: int) -> Ints:
    """(N,) the unit of each transition: pieces of trajectories of the longest length."""

    def numbers() -> Iterator[Ints]:
        before = 0
        for start, stop in data.spans:
            own = before + np.arange(stop - start) // longest
            before = int(own[-1]) + 1
            yield own

    return np.concatenate(list(numbers()))


def _predicted(problem: Problem, fit: Fit) -> tuple[Array, Array]:
    """Residuals (R, p) at the fit's mean, and the covariance (R, p, p) that its spread gives to
    first order.
    """
    predicted, jacobian = problem.simulator.linearize(fit.mean, problem.segments)
    spread = jacobian @ (fit.correlation * np.outer(fit.sd, fit.sd)) @ jacobian.swapaxes(1, 2)
    return problem.simulator.targets(problem.segments) - predicted, spread


def _log_normal(residuals: Array, sigma: Array) -> Array:
    """(R,) log N(residual; 0, sigma)."""
    solved = np.linalg.solve(sigma, residuals[:, :, None])[:, :, 0]
    return np.asarray(
        -0.5 * (np.sum(residuals * solved, axis=1) + np.linalg.slogdet(2 * np.pi * sigma)[1])
    )
