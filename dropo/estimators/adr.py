"""ADR: uniform bounds that widen where the policy does well on them."""

from dataclasses import dataclass

import numpy as np

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.interactive_estimator import (
    Callbacks,
    InteractiveEstimator,
    Performance,
    distribution,
)
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit, Status
from dropo.core.records.parameters import ParameterSpace
from dropo.core.records.search_records import IntervalHistory
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.distribution_fit import evaluate_fit

SIGNATURE = "(values, rng) -> float"


@dataclass(frozen=True, kw_only=True)
class ADR(InteractiveEstimator):
    """Automatic domain randomization: a uniform law that grows as far as the policy can follow
    (OpenAI 2019, arXiv:1910.07113, section 5).

    It begins as a point, the model's own values, in the middle of the box where there are none.
    Each of `budget` calls puts one parameter on one of its two bounds, both drawn at random, draws
    the others from the present law, and asks performance(values, rng), which runs the policy there
    in simulation and may train it too. After `buffer` calls on a bound their average decides
    (algorithm 1): at least `thresholds`[1], the bound moves outwards by `step` of the search
    interval; at most `thresholds`[0], inwards; the box is never left. The thresholds are in the
    unit of the performance, by default a rate of success. No target data are used; draws: for the
    log-likelihood of the problem's data.
    """

    performance: Performance | None = None
    thresholds: tuple[float, float] = (0.25, 0.75)
    step: float = 0.02
    buffer: int = 10
    budget: int = 2000
    draws: int = 100
    name = "adr"

    def __post_init__(self) -> None:
        self._check_callback("performance", SIGNATURE)
        require(
            self.thresholds[0] < self.thresholds[1],
            "thresholds",
            "the lower one first",
            self.thresholds,
            "ADR",
        )
        require(
            0 < self.step <= 0.5, "step", "a share of the interval in (0, 0.5]", self.step, "ADR"
        )
        require(
            min(self.buffer, self.budget) >= 1,
            "buffer, budget",
            "at least 1",
            (self.buffer, self.budget),
            "ADR",
        )

    def _fit(self, problem: Problem, run: Run) -> Fit:
        calls = Callbacks(run)
        bounds = Bounds(problem.space, _start(problem), self)
        history = [bounds.ends.copy()]
        status = Status.OUT_OF_BUDGET
        message = f"The bounds after {self.budget} calls; ADR has no end of its own."
        try:
            for done in range(self.budget):
                place, values = bounds.ask(run.rng)
                bounds.tell(place, self._performance(calls, values))
                history.append(bounds.ends.copy())
                run.progress(
                    (done + 1) / self.budget,
                    f"{done + 1} calls, entropy {bounds.entropy:.3g} nat a parameter",
                )
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
            message = f"Interrupted after {len(history) - 1} calls: these are the bounds so far."
        low, high = bounds.ends
        family = find("families", "uniform")(problem.space)
        fit = distribution(
            problem,
            self.name,
            "uniform",
            family.phi((low + high) / 2, (high - low) / 2),
            status=status,
            message=message,
            search_record=IntervalHistory(np.array(history), target_transitions=calls.transitions),
        )
        return evaluate_fit(problem, run, fit, self.draws, run.rng.spawn(1)[0])

    def _performance(self, calls: Callbacks, values: Array) -> float:
        assert self.performance is not None
        performance = self.performance
        return calls.number(values, lambda rng: performance(values, rng))


def _start(problem: Problem) -> Array:
    """(d,) the model's own values, inside the box."""
    space = problem.space
    nominal = problem.simulator.nominal
    return (
        (space.low + space.high) / 2 if nominal is None else np.clip(nominal, space.low, space.high)
    )


class Bounds:
    """The bounds `ends` (2, d) of ADR, low before high, and what was seen on each of them since it
    last moved.
    """

    def __init__(self, space: ParameterSpace, start: Array, settings: ADR):
        self.space = space
        self.start = start
        self.settings = settings
        self.ends = np.stack([start, start])
        self._seen: dict[tuple[int, int], list[float]] = {
            (side, i): [] for side in (0, 1) for i in range(len(space))
        }

    @property
    def entropy(self) -> float:
        """Of the law, a parameter: mean log width [nats], -inf while one has none."""
        with np.errstate(divide="ignore"):
            return float(np.log(self.ends[1] - self.ends[0]).mean())

    def ask(self, rng: np.random.Generator) -> tuple[tuple[int, int], Array]:
        """A bound (side, parameter), and values (d,) on it."""
        side = int(rng.integers(2))
        i = int(rng.integers(len(self.space)))
        values = self.ends[0] + rng.random(len(self.space)) * (self.ends[1] - self.ends[0])
        values[i] = self.ends[side, i]
        return (side, i), values

    def tell(self, place: tuple[int, int], performance: float) -> None:
        """Takes in what was seen on the bound, and moves it when that is enough; it never passes
        the start.
        """
        seen, (side, i), settings = self._seen[place], place, self.settings
        seen.append(performance)
        if len(seen) < settings.buffer:
            return
        average = np.mean(seen)
        outwards = settings.step * self.space[i].width * (1 if side else -1)
        seen.clear()
        move = (
            outwards
            if average >= settings.thresholds[1]
            else -outwards
            if average <= settings.thresholds[0]
            else 0.0
        )
        low, high = (
            (self.start[i], self.space.high[i]) if side else (self.space.low[i], self.start[i])
        )
        self.ends[side, i] = np.clip(self.ends[side, i] + move, low, high)
