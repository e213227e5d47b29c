"""DROPO: the distribution of the parameters with the highest likelihood of the measured segments."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.family import Family
from dropo.core.contracts.likelihood import Likelihood, LogLikelihood
from dropo.core.contracts.local_likelihood import LocalLikelihood, LocalLogLikelihood
from dropo.core.contracts.maximize import SearchResult, maximize
from dropo.core.contracts.noise import Noise
from dropo.core.contracts.optimizer import Optimizer
from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import describe_failures
from dropo.core.records.fit import Fit
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.trajectories import Ints
from dropo.core.services.errors import Incompatible, SimulationFailed
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, known, require
from dropo.estimators.least_squares import estimate
from dropo.estimators.support.epsilon import noise_scale, noise_shape, tune
from dropo.estimators.support.filtered_starts import fit_from_filtered_starts
from dropo.estimators.support.sobol_start import best_sobol_point
from dropo.estimators.support.summary import summarize
from dropo.estimators.support.trust_region import Rounds
from dropo.evaluation.emulator_check import certified_scales, paired_check

SWEEP = tuple(10.0**k for k in range(-8, -1))  # figure 6.4


@dataclass(frozen=True, kw_only=True)
class DROPO(Estimator):
    """Maximises the log-likelihood of the segments over a family of distributions (Tiboni 2021,
    chapter 5).

    As published: likelihood "monte-carlo" (K = `draws` = 100), family "truncated_gaussian",
    optimizer "cma-es", `budget` of 5000 evaluations, start "middle". likelihood, family, optimizer:
    names, or a Likelihood object; without an optimizer, Fisher scoring where the likelihood knows
    its information, else "cma-es". epsilon: the noise variance, one or for each signal; "learn",
    one for each signal found with the rest (sampled likelihoods: one factor on the variances that
    least squares leaves); "tune", section 5.3: the smallest of `sweep` whose fit has a mean squared
    error of at most `mse_threshold`; None, the problem's own where it names one, else "learn".
    start_noise: whether the measured start states carry the noise too; degrees: of freedom of a
    Student t in the Gaussian's place; None, as the problem says. start: the first mean, a
    least-squares estimate, the middle of the box, or drawn from it (uniformly, in logarithms where
    a parameter is searched so). starts: segments start from the measured states, or (local
    likelihoods; noise on all measurements) from states that a Kalman filter makes of the
    measurements up to them.
    """

    likelihood: str | Likelihood = "emulated"
    family: str = "truncated_gaussian"
    optimizer: str | None = None
    epsilon: float | tuple[float, ...] | Literal["learn", "tune"] | None = None
    draws: int | None = None
    budget: int = 5000
    start: Literal["least-squares", "middle", "random"] = "middle"
    sweep: tuple[float, ...] = SWEEP
    mse_threshold: float | None = None
    start_noise: bool | None = None
    starts: Literal["measured", "filtered"] = "measured"
    degrees: float | None = None
    name = "dropo"

    def __post_init__(self) -> None:
        known("start", self.start, ("least-squares", "middle", "random"))
        known("starts", self.starts, ("measured", "filtered"))
        if isinstance(self.epsilon, str):
            known("epsilon", self.epsilon, ("learn", "tune"))
        require(self.budget >= 1, "budget", "at least 1", self.budget, "DROPO")
        require(
            self.degrees is None or self.degrees > 2,
            "degrees",
            "above 2, to have a variance",
            self.degrees,
            "DROPO",
        )
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
            raise Incompatible(
                f"The likelihood {self.likelihood!r} draws nothing. Leave draws out, or "
                "use 'monte-carlo'."
            )
        return made() if self.draws is None else made(draws=self.draws)

    def _fit(self, problem: Problem, run: Run) -> Fit:
        seeds = run.rng.integers(2**63, size=3)
        if self.epsilon == "tune":
            return tune(
                lambda e: self._fit_with(problem, run, self._noise(problem, e), seeds),
                self.sweep,
                self.mse_threshold,
                problem,
                run,
            )
        given = problem.epsilon if self.epsilon is None else self.epsilon
        if given is not None and not isinstance(given, str):
            return self._fit_with(problem, run, self._noise(problem, given), seeds)
        if isinstance(self._likelihood(), LocalLikelihood):
            return self._fit_with(
                problem, run, self._noise(problem, noise_scale(problem, run), "each"), seeds
            )
        return self._fit_with(
            problem, run, self._noise(problem, noise_shape(problem, run), "factor"), seeds
        )

    def _noise(
        self, problem: Problem, variance: Any, learned: Literal["factor", "each"] | None = None
    ) -> Noise:
        start = problem.start_noise if self.start_noise is None else self.start_noise
        degrees = problem.noise_degrees if self.degrees is None else self.degrees
        return Noise(
            np.asarray(variance, dtype=float),
            learned,
            start=start or self.starts == "filtered",
            degrees=degrees,
        )

    def _fit_with(self, problem: Problem, run: Run, noise: Noise, seeds: Ints) -> Fit:
        family = find("families", self.family)(problem.space)
        randomness, search, place = (np.random.default_rng(int(seed)) for seed in seeds)
        likelihood = self._likelihood()
        centre = self._centre(problem, run, place)
        if isinstance(likelihood, LocalLikelihood):
            return self._fit_locally(problem, run, family, likelihood, noise, centre, randomness)
        if self.starts == "filtered":
            raise Incompatible(
                f"{self.likelihood!r} takes no filtered starts. Use 'emulated', 'linear' "
                "or 'unscented'."
            )
        objective = likelihood.bind(problem.simulator, problem.segments, family, noise, randomness)
        start = first_member(family, objective.unknowns, centre)
        check_start(problem, run, family, start)
        unit = np.clip(objective.unknowns.to_unit(start), 0.0, 1.0)
        optimizer = find("optimizers", self.optimizer or "cma-es")(
            len(unit), search, start=unit, budget=self.budget
        )
        return self._summary(
            problem, run, family, objective, maximize(objective, objective.unknowns, optimizer, run)
        )

    def _centre(self, problem: Problem, run: Run, rng: np.random.Generator) -> Array:
        """(d,) the first mean."""
        if self.start == "least-squares":
            return estimate(problem, run).value
        space = problem.space
        return (
            space.from_unit(rng.random(len(space)))
            if self.start == "random"
            else (space.low + space.high) / 2
        )

    def _fit_locally(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        likelihood: LocalLikelihood,
        noise: Noise,
        centre: Array,
        rng: np.random.Generator,
    ) -> Fit:
        def make(dimension: int, start: Array) -> Optimizer:
            made: Optimizer = find("optimizers", self.optimizer or "")(
                dimension, rng.spawn(1)[0], start=start, step=0.1, budget=self.budget
            )
            return made

        optimizer = make if self.optimizer else None
        seen = problem
        details = dict[str, Any]()
        try:
            objective, found = Rounds(problem, run, family, likelihood, noise, rng, optimizer).fit(
                centre
            )
        except SimulationFailed:  # even on a narrow design: most of the box may explode
            objective, found = Rounds(problem, run, family, likelihood, noise, rng, optimizer).fit(
                best_sobol_point(problem, run)
            )
        if self.starts == "filtered":
            refit = lambda seen, noise, centre, width: Rounds(
                seen, run, family, likelihood, noise, rng, optimizer
            ).fit(centre, width)
            seen, objective, found, details = fit_from_filtered_starts(
                refit, problem, run, family, noise, objective, found
            )
        checked, warnings = paired_check(seen, run, family, objective, found.point, rng)
        checked |= details
        checked["certified"] = certified_scales(family, objective, found.point)
        return self._summary(problem, run, family, objective, found, checked, warnings)

    def _summary(
        self,
        problem: Problem,
        run: Run,
        family: Family,
        objective: LogLikelihood,
        found: SearchResult,
        checked: dict[str, Any] | None = None,
        warnings: Sequence[str] = (),
    ) -> Fit:
        with run.counting():
            mean = objective.mean(found.point)
        return summarize(
            problem,
            run,
            method=self.name,
            family=family,
            family_name=self.family,
            phi=found.point,
            epsilon=objective.epsilon(found.point),
            log_likelihood=found.value,
            mean_prediction=mean,
            status=found.status,
            message=found.reason,
            objective=objective,
            details={**self._parts(objective), **(checked or {})},
            warnings=warnings,
        )

    def _parts(self, objective: LogLikelihood) -> dict[str, str]:
        default = "fisher-scoring" if isinstance(objective, LocalLogLikelihood) else "cma-es"
        named = (
            self.likelihood if isinstance(self.likelihood, str) else type(self.likelihood).__name__
        )
        return {"likelihood": named, "optimizer": self.optimizer or default}


def first_member(family: Family, unknowns: ParameterSpace, centre: Array) -> Array:
    """phi (m,) of that mean, the rest in its middle; the first steps are the optimizer's own, a
    quarter of the unit box (the thesis' 1 in [0, 4]).
    """
    start = unknowns.from_unit(np.full(len(unknowns), 0.5))
    start[: len(family.unknowns)] = family.phi(centre)
    return start


def check_start(problem: Problem, run: Run, family: Family, phi: Array) -> None:
    """Refuses to search where the simulator diverges at the start's mean already."""
    values = family.mean(phi[: len(family.unknowns)])[None]
    with run.counting():
        predictions = problem.simulator.predict(values, problem.segments)
    if not np.isfinite(predictions).all():
        sentence = describe_failures(predictions, values, problem.space)
        raise SimulationFailed(f"{sentence} Leave those segments out, or start elsewhere.")
