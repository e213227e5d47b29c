"""DROPO: the distribution of the parameters with the highest likelihood of the measured segments."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from dropo.core.catalogue import find
from dropo.core.checks import Array, known, require
from dropo.core.data import Ints
from dropo.core.errors import Incompatible, SimulationFailed
from dropo.core.estimator import Estimator, Run
from dropo.core.family import Family
from dropo.core.fit import Fit, Status
from dropo.core.likelihood import Likelihood, LogLikelihood
from dropo.core.local_likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.noise import Epsilon, Noise
from dropo.core.optimizer import Optimizer
from dropo.core.parameters import ParameterSpace
from dropo.core.problem import Problem
from dropo.core.search import SearchResult, maximise
from dropo.core.simulator import describe_failures
from dropo.estimators.certificate import paired_check
from dropo.estimators.least_squares import estimate, misfit
from dropo.estimators.rounds import Rounds
from dropo.estimators.summary import summarise

SWEEP = tuple(10.0**k for k in range(-8, -1))  # figure 6.4


@dataclass(frozen=True)
class DROPO(Estimator):
    """Maximises the log-likelihood of the segments over a family of distributions (Tiboni 2021, chapter 5).

    As published: likelihood "monte-carlo" (K = `draws` = 100), family "truncated_gaussian", optimizer "cma-es", `budget` of
    5000 evaluations, start "middle". likelihood, family, optimizer: names, or a Likelihood object; without an optimizer,
    Fisher scoring where the likelihood knows its information, else "cma-es". epsilon: the noise variance, one or for each
    signal; "learn", one for each signal found with the rest (sampled likelihoods: one factor on the variances that least
    squares leaves); "tune", section 5.3: the smallest of `sweep` whose fit has a mean squared error of at most
    `mse_threshold`; None, the problem's own where it names one, else "learn". start: the first mean, a least-squares
    estimate or the middle of the box.
    """

    likelihood: str | Likelihood = "emulated"
    family: str = "truncated_gaussian"
    optimizer: str | None = None
    epsilon: float | tuple[float, ...] | Literal["learn", "tune"] | None = None
    draws: int | None = None
    budget: int = 5000
    start: Literal["least-squares", "middle"] = "middle"
    sweep: tuple[float, ...] = SWEEP
    mse_threshold: float | None = None
    name = "dropo"

    def __post_init__(self) -> None:
        known("start", self.start, ("least-squares", "middle"))
        require(self.budget >= 1, "budget", "at least 1", self.budget, "DROPO")
        require(
            self.draws is None or isinstance(self.likelihood, str),
            "draws",
            "left out where the likelihood brings its own",
            self.draws,
            "DROPO",
        )
        self._likelihood()

    def _likelihood(self) -> Likelihood:
        if not isinstance(self.likelihood, str):
            return self.likelihood
        made = find("likelihoods", self.likelihood)
        if self.draws is not None and "draws" not in getattr(made, "__dataclass_fields__", {}):
            raise Incompatible(f"The likelihood {self.likelihood!r} draws nothing. Leave draws out, or use 'monte-carlo'.")
        return made() if self.draws is None else made(draws=self.draws)

    def _fit(self, problem: Problem, run: Run) -> Fit:
        seeds = run.rng.integers(2**63, size=2)
        if self.epsilon == "tune":
            return tune(self, problem, run, seeds)
        if self.epsilon == "learn" or (self.epsilon is None and problem.epsilon is None):
            local = isinstance(self._likelihood(), LocalLikelihood)
            noise = Noise(misfit(problem, run), "each") if local else Noise(noise_shape(problem, run), "factor")
            return self._fit_with(problem, run, noise, seeds)
        return self._fit_with(problem, run, np.asarray(problem.epsilon if self.epsilon is None else self.epsilon, dtype=float), seeds)

    def _fit_with(self, problem: Problem, run: Run, epsilon: Epsilon, seeds: Ints) -> Fit:
        family = find("families", self.family)(problem.space)
        randomness, search = (np.random.default_rng(int(seed)) for seed in seeds)
        likelihood = self._likelihood()
        if isinstance(likelihood, LocalLikelihood):
            return self._fit_locally(problem, run, family, likelihood, epsilon, randomness)
        objective = likelihood.bind(problem.simulator, problem.segments, family, epsilon, randomness)
        start = self._start(problem, run, family, objective.unknowns)
        check_start(problem, run, family, start)
        unit = np.clip(objective.unknowns.to_unit(start), 0.0, 1.0)
        optimizer = find("optimizers", self.optimizer or "cma-es")(len(unit), search, start=unit, budget=self.budget)
        return self._summary(problem, run, family, objective, maximise(objective, objective.unknowns, optimizer, run))

    def _fit_locally(
        self, problem: Problem, run: Run, family: Family, likelihood: LocalLikelihood, epsilon: Epsilon, rng: np.random.Generator
    ) -> Fit:
        def make(dimension: int, start: Array) -> Optimizer:
            made: Optimizer = find("optimizers", self.optimizer or "")(
                dimension, rng.spawn(1)[0], start=start, step=0.1, budget=self.budget
            )
            return made

        centre = estimate(problem, run).value if self.start == "least-squares" else (problem.space.low + problem.space.high) / 2
        objective, found = Rounds(problem, run, family, likelihood, epsilon, rng, make if self.optimizer else None).fit(centre)
        checked, warnings = paired_check(problem, run, family, objective, found.point, rng)
        return self._summary(problem, run, family, objective, found, checked, warnings)

    def _start(self, problem: Problem, run: Run, family: Family, unknowns: ParameterSpace) -> Array:
        """phi to start from; the first steps are the optimizer's own, a quarter of the unit box (the thesis' 1 in [0, 4])."""
        start = unknowns.from_unit(np.full(len(unknowns), 0.5))
        if self.start == "least-squares":
            start[: len(family.unknowns)] = family.phi(estimate(problem, run).value)
        return start

    def _summary(
        self, problem: Problem, run: Run, family: Family, objective: LogLikelihood, found: SearchResult,
        checked: dict[str, Any] | None = None, warnings: Sequence[str] = (),
    ) -> Fit:  # fmt: skip
        with run.counting():
            mean = objective.mean(found.point)
        return summarise(
            problem, run, method=self.name, family=family, family_name=self.family, phi=found.point, epsilon=objective.epsilon(found.point),
            log_likelihood=found.value, mean_prediction=mean, status=found.status, message=found.reason,
            objective=objective, details={**self._parts(objective), **(checked or {})}, warnings=warnings,
        )  # fmt: skip

    def _parts(self, objective: LogLikelihood) -> dict[str, str]:
        default = "fisher-scoring" if isinstance(objective, LocalLogLikelihood) else "cma-es"
        named = self.likelihood if isinstance(self.likelihood, str) else type(self.likelihood).__name__
        return {"likelihood": named, "optimizer": self.optimizer or default}


def noise_shape(problem: Problem, run: Run) -> Array:
    """(p,) what a learned epsilon is a factor of: the problem's own, else the variances that least squares leaves.

    These are kept above (1e-4 of a signal's standard deviation)^2: a signal that the model explains perfectly would
    otherwise outweigh all others without bound.
    """
    if problem.epsilon is not None:
        return np.asarray(problem.epsilon, dtype=float)
    spread = np.var(problem.simulator.targets(problem.segments), axis=0)
    return np.maximum(estimate(problem, run).noise, np.maximum(1e-8 * spread, 1e-300))


def check_start(problem: Problem, run: Run, family: Family, phi: Array) -> None:
    """Refuses to search where the simulator diverges at the start's mean already."""
    values = family.mean(phi[: len(family.unknowns)])[None]
    with run.counting():
        predictions = problem.simulator.predict(values, problem.segments)
    if not np.isfinite(predictions).all():
        sentence = describe_failures(predictions, values, problem.space)
        raise SimulationFailed(f"{sentence} Leave those segments out, or start elsewhere.")


def tune(settings: DROPO, problem: Problem, run: Run, seeds: Ints) -> Fit:
    """The fit at the smallest epsilon of the sweep with an acceptable mean squared error (thesis, section 5.3, figure 6.4).

    Without a threshold, acceptable is at most 1.1 times the least of the sweep. Its table is in `details["tuning"]`.
    """
    fits = []
    for i, epsilon in enumerate(sorted(settings.sweep)):
        report = run.progress
        run.progress = lambda share, text, i=i, report=report, e=epsilon: report(
            (i + share) / len(settings.sweep), f"epsilon {e:.0e}: {text}"
        )  # type: ignore[misc]
        fits.append(settings._fit_with(problem, run, epsilon, seeds))
        run.progress = report
        if fits[-1].status is Status.INTERRUPTED:
            break
    least = min(fit.mse for fit in fits)
    threshold = (
        settings.mse_threshold if settings.mse_threshold is not None else 1.1 * least + 1e-10 * float(np.var(problem.segments.targets))
    )
    accepted = [fit for fit in fits if fit.mse <= threshold]
    table = [
        {"epsilon": float(f.epsilon[0]), "total_variance": float(np.sum(f.sd**2)), "mse": f.mse, "log_likelihood": f.log_likelihood}
        for f in fits
    ]
    best = accepted[0] if accepted else min(fits, key=lambda fit: fit.mse)
    note = () if accepted else (f"no epsilon of the sweep reaches the mean squared error {threshold:.3g}; the least is shown",)
    return replace(best, warnings=(*best.warnings, *note), details={**best.details, "tuning": table, "mse_threshold": threshold})
