"""The contract of estimators: a problem in, a Fit out."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import threadpool_limits

from dropo.core.contracts.problem import Problem
from dropo.core.contracts.simulator import Simulator
from dropo.core.records.fit import Fit
from dropo.core.services.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array, require

Progress = Callable[[float, str], None]


def silent(share: float, text: str) -> None:
    """No progress."""


def with_cost(progress: Progress, simulator: Simulator) -> Progress:
    """The same progress, whose text also says how many simulator steps were made from now on."""
    before = simulator.steps
    return lambda share, text: progress(
        share, f"{text}, {simulator.steps - before:,} simulator steps"
    )


@dataclass
class Run:
    """One run of an estimator: its randomness, what was evaluated, where progress goes, and what it
    cost so far.
    """

    problem: Problem
    rng: np.random.Generator
    evaluation_log: EvaluationLog = field(default_factory=EvaluationLog)
    progress: Progress = silent
    steps: int = 0
    failures: int = 0
    evaluations: int = 0

    def evaluate(self, points: Array, function: Callable[[Array], Array]) -> Array:
        """function(points), or its recorded answer; simulator steps and failures are counted either
        way.
        """

        def counted(points: Array) -> tuple[Array, dict[str, int]]:
            simulator = self.problem.simulator
            before = simulator.steps, simulator.failures
            answers = function(points)
            return answers, {
                "steps": simulator.steps - before[0],
                "failures": simulator.failures - before[1],
            }

        answers, counts = self.evaluation_log.evaluate(points, counted)
        self.steps += counts["steps"]
        self.failures += counts["failures"]
        self.evaluations += len(points)
        return answers

    @contextmanager
    def counting(self, evaluations: int = 0) -> Iterator[None]:
        """Counts the simulations of a block that is too short to be recorded: a resumed run makes
        them again.
        """
        simulator = self.problem.simulator
        before = simulator.steps, simulator.failures
        yield
        self.steps += simulator.steps - before[0]
        self.failures += simulator.failures - before[1]
        self.evaluations += evaluations


class Estimator(ABC):
    """A recipe with frozen settings. A plug-in writes `_fit`; name is what `--method` takes."""

    name: str

    def fit(
        self,
        problem: Problem,
        *,
        rng: np.random.Generator | int | None = 0,
        evaluation_log: EvaluationLog | None = None,
        progress: Progress = silent,
    ) -> Fit:
        """Fits the distribution of the problem's parameters.

        rng: anything that numpy.random.default_rng takes; evaluation_log: where evaluations are
        recorded, for a run that can be resumed;
        progress: called with the share that is done (0 to 1) and a text.
        """
        require(
            len(problem.space) >= 1, "parameters", "at least one", 0, f"Problem {problem.name!r}"
        )
        begun = time.perf_counter()
        run = Run(
            problem,
            np.random.default_rng(rng),
            evaluation_log or EvaluationLog(),
            with_cost(progress, problem.simulator),
        )
        with threadpool_limits(
            1, user_api="blas"
        ):  # the simulator's threads use the cores; small products gain nothing
            fit = self._fit(problem, run)
        seed = int(rng) if isinstance(rng, int | np.integer) else None
        return replace(
            fit,
            wall_time_s=time.perf_counter() - begun,
            seed=seed,
            simulator_steps=run.steps,
            failed_simulations=run.failures,
            objective_evaluations=run.evaluations,
        )

    @abstractmethod
    def _fit(self, problem: Problem, run: Run) -> Fit:
        """Simulations go through `run.evaluate`, so that they are counted and recorded, or through
        `run.counting`.
        """
