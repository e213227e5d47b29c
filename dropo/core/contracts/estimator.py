"""The contract of estimators: a problem in, a fit out."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.services.blas_threads import one_blas_thread
from dropo.core.services.errors import Incompatible
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array, check_shape, require

Progress = Callable[[float, str], None]
"""Is called with the fraction of the work that is done, 0 to 1, and a text."""


CUT_SHORT = "Interrupted at the end: errors and checks that are missing were not reached."
"""Behind the message of a fit whose search had ended."""


def silent(fraction: float, text: str) -> None:
    """Show no progress.

    Parameters
    ----------
    fraction : float
        The part of the work that is done, from 0 to 1.
    text : str
        What would be shown.
    """


def with_cost(progress: Progress, simulator: Simulator) -> Progress:
    """Add to a progress text how many simulator steps have been made from now on.

    Parameters
    ----------
    progress : callable
        Shows the text.
    simulator : Simulator
        Counts its steps.

    Returns
    -------
    callable
        To be called in place of `progress`.
    """
    before = simulator.steps

    def show(fraction: float, text: str) -> None:
        progress(fraction, f"{text}, {simulator.steps - before:,} simulator steps")

    return show


@dataclass
class Run:
    """One run of an estimator: its randomness, evaluation log, progress, and cost so far.

    Attributes
    ----------
    problem : Problem
        What is fitted.
    rng : numpy.random.Generator
        All randomness of the run.
    evaluation_log : EvaluationLog
        Where evaluations are recorded.
    progress : callable
        Where progress goes.
    steps : int
        Simulator steps so far.
    failures : int
        Simulations so far that diverged.
    evaluations : int
        Evaluations of the objective so far.
    inner_evaluations : int
        Evaluations so far of local models of the objective, which simulate nothing.
    best : Fit or None
        What a search that has ended is worth while its errors and checks are still computed.
    """

    problem: Problem
    rng: np.random.Generator
    evaluation_log: EvaluationLog = field(default_factory=EvaluationLog)
    progress: Progress = silent
    steps: int = 0
    failures: int = 0
    evaluations: int = 0
    inner_evaluations: int = 0
    best: Fit | None = None

    @contextmanager
    def beginning(self, share: float = 0.05) -> Iterator[None]:
        """Show what runs inside a block as the beginning of the run, a share of its progress.

        Parameters
        ----------
        share : float
            The fraction of the run that is done at the block's end.

        Yields
        ------
        None
            The block runs between.
        """
        progress = self.progress
        self.progress = lambda fraction, text: progress(share * fraction, text)
        try:
            yield
        finally:
            self.progress = progress

    def evaluate(self, points: Array, function: Callable[[Array], Array]) -> Array:
        """Evaluate a function, or read its recorded values, and count what it costs.

        Parameters
        ----------
        points : (P, m) array
            Where to evaluate it.
        function : callable
            Points (P, m) to values with P rows.

        Returns
        -------
        array
            The values. A recorded evaluation adds its recorded cost.
        """

        def counted(points: Array) -> tuple[Array, dict[str, int]]:
            simulator = self.problem.simulator
            steps_before = simulator.steps
            failures_before = simulator.failures
            inner_before = self.inner_evaluations
            answers = function(points)
            inner = self.inner_evaluations - inner_before
            self.inner_evaluations = inner_before
            return answers, {
                "steps": simulator.steps - steps_before,
                "failures": simulator.failures - failures_before,
                "inner": inner,
            }

        answers, counts = self.evaluation_log.evaluate(points, counted)
        self.steps += counts["steps"]
        self.failures += counts["failures"]
        self.inner_evaluations += counts["inner"]
        self.evaluations += len(points)
        return answers

    @contextmanager
    def counting(self, evaluations: int = 0) -> Iterator[None]:
        """Count the simulations of a block that is too short to be recorded.

        A resumed run makes them again.

        Parameters
        ----------
        evaluations : int
            Evaluations of the objective that the block makes.

        Yields
        ------
        None
            The block runs between; its steps and failures are added to the run's where it ends.
        """
        simulator = self.problem.simulator
        steps_before = simulator.steps
        failures_before = simulator.failures
        yield
        self.steps += simulator.steps - steps_before
        self.failures += simulator.failures - failures_before
        self.evaluations += evaluations


class Estimator(ABC):
    """A method with its settings; a plug-in is a frozen dataclass that writes `_fit`.

    Attributes
    ----------
    name : str
        What `--method` takes.
    uses_priors : bool
        Whether the priors of a problem count; a method that knows none refuses them.
    """

    name: str
    uses_priors = False

    def fit(
        self,
        problem: Problem,
        *,
        rng: np.random.Generator | int | None = 0,
        evaluation_log: EvaluationLog | None = None,
        progress: Progress = silent,
    ) -> Fit:
        """Fit the distribution of the problem's parameters.

        Parameters
        ----------
        problem : Problem
            What was measured, and the simulator.
        rng : numpy.random.Generator, int or None
            Whatever `numpy.random.default_rng` takes; the same seed gives the same fit.
        evaluation_log : EvaluationLog, optional
            Where evaluations are recorded, for a run that can be resumed.
        progress : callable
            Is called with the fraction that is done (0 to 1) and a text.

        Returns
        -------
        Fit
            The distribution, and what it cost to find.

        Raises
        ------
        BadArgument
            If the problem has no parameters, or the method finds a mean or a spread that is not
            finite.
        Incompatible
            If the problem has priors, and the method uses none.
        """
        owner = f"Problem {problem.name!r}"
        require(len(problem.space) >= 1, "parameters", "at least one", 0, owner)
        self._check_priors(problem)
        begun = time.perf_counter()
        run = Run(
            problem,
            np.random.default_rng(rng),
            evaluation_log or EvaluationLog(),
            with_cost(progress, problem.simulator),
        )
        # The simulator's threads use the cores; small matrix products gain nothing from more.
        with one_blas_thread():
            fit = self.fit_part(problem, run)
        self._check_numbers(fit)
        seed = int(rng) if isinstance(rng, int | np.integer) else None
        return replace(
            fit,
            wall_time_s=time.perf_counter() - begun,
            seed=seed,
            simulator_steps=run.steps,
            failed_simulations=run.failures,
            objective_evaluations=run.evaluations,
            inner_evaluations=run.inner_evaluations,
            source=problem.source,
        )

    def fit_part(self, problem: Problem, run: Run) -> Fit:
        """Fit within a run that another method may have begun.

        Parameters
        ----------
        problem : Problem
        run : Run
            Whose cost and evaluation log are shared.

        Returns
        -------
        Fit
            Without its cost. Interrupted after its search had ended, it is `run.best`.
        """
        try:
            return self._fit(problem, run)
        except KeyboardInterrupt:
            if run.best is None:
                raise
            message = f"{run.best.message} {CUT_SHORT}"
            return replace(run.best, status=Status.INTERRUPTED, message=message)

    def _check_numbers(self, fit: Fit) -> None:
        """Refuse a fit whose means, spreads or member of the family are no numbers."""
        owner = f"method {self.name!r}"
        for what in ("mean", "scale", "sd"):
            values = np.asarray(getattr(fit, what), dtype=float)
            check_shape(what, values, (len(fit.space),), owner)
            for name, value in zip(fit.space.names, values.tolist(), strict=True):
                require(math.isfinite(value), f"{what} of {name}", "a finite number", value, owner)
        phi = np.asarray(fit.phi, dtype=float)
        require(bool(np.isfinite(phi).all()), "phi", "finite", phi.tolist(), owner)

    def _check_priors(self, problem: Problem) -> None:
        """Refuse priors that would be left out in silence."""
        if problem.priors and not self.uses_priors:
            names = ", ".join(problem.priors)
            raise Incompatible(
                f"Method {self.name!r} uses no prior, and there is one of {names}. Use 'dropo',"
                " 'least-squares', 'random-effects', 'posterior', 'epopt' or 'npe', or leave"
                " 'prior' out."
            )

    @abstractmethod
    def _fit(self, problem: Problem, run: Run) -> Fit:
        """Fit the problem; the caller fills in what it cost.

        Simulations go through `run.evaluate`, so that they are counted and recorded, or through
        `run.counting`.
        """
