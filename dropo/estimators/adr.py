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
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.fits.search_records import IntervalHistory
from dropo.core.records.parameters import ParameterSpace
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, require
from dropo.estimators.support.distribution_fit import evaluate_fit

SIGNATURE = "(values, rng) -> float"


@dataclass(frozen=True, kw_only=True)
class ADR(InteractiveEstimator):
    """Automatic domain randomization: a uniform distribution that grows with the policy's success.

    It begins as a point, the model's own values, in the middle of the box where there are none.
    Each call puts one parameter on one of its two bounds, both drawn at random, and draws the
    others from the present distribution. Once a bound has been tried often enough, the average
    performance on it moves the bound (algorithm 1); the box is never left. No target data are used.

    Attributes
    ----------
    performance : callable
        performance(values, rng) runs the policy in simulation at the values, and may train it too.
    thresholds : (float, float)
        In the unit of the performance, by default a rate of success: a bound moves inwards if the
        average is at most the first, outwards if it is at least the second.
    step : float
        How far a bound moves, as a fraction of the search interval.
    buffer : int
        Calls on a bound after which it is decided.
    budget : int
        Calls in all.
    draws : int
        By which the log-likelihood of the problem's data is estimated.

    Raises
    ------
    Incompatible
        Without `performance`.
    BadArgument
        If `performance` cannot be called, the thresholds are not in ascending order, `step` is not
        in (0, 0.5], or `buffer` or `budget` is below 1.

    References
    ----------
    OpenAI, "Solving Rubik's cube with a robot hand", 2019, arXiv:1910.07113, section 5.
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
        ordered = self.thresholds[0] < self.thresholds[1]
        require(ordered, "thresholds", "the lower one first", self.thresholds, "ADR")
        rule = "a fraction of the interval in (0, 0.5]"
        require(0 < self.step <= 0.5, "step", rule, self.step, "ADR")
        counts = (self.buffer, self.budget)
        require(min(counts) >= 1, "buffer, budget", "at least 1", counts, "ADR")

    def _fit(self, problem: Problem, run: Run) -> Fit:
        """Try the policy on the bounds until the budget is spent."""
        calls = Callbacks(run)
        bounds = Bounds(problem.space, _first_values(problem), self)
        history = [bounds.ends.copy()]
        status = Status.OUT_OF_BUDGET
        message = f"The bounds after {self.budget} calls; ADR has no end of its own."
        try:
            for done in range(1, self.budget + 1):
                place, values = bounds.ask(run.rng)
                bounds.tell(place, self._call_performance(calls, values))
                history.append(bounds.ends.copy())
                text = f"{done} calls, entropy {bounds.entropy:.3g} nat a parameter"
                run.progress(done / self.budget, text)
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

    def _call_performance(self, calls: Callbacks, values: Array) -> float:
        """The performance at the values (d,), counted."""
        assert self.performance is not None
        performance = self.performance
        return calls.number(values, lambda rng: performance(values, rng))


def _first_values(problem: Problem) -> Array:
    """(d,) the model's own values inside the box, or its middle."""
    space = problem.space
    nominal = problem.simulator.nominal
    if nominal is None:
        return (space.low + space.high) / 2
    return space.clip(nominal)


class Bounds:
    """The bounds of ADR's distribution, and the performances on each since it last moved.

    Parameters
    ----------
    space : ParameterSpace
    start : (d,) array
        The point at which both bounds begin, and which neither passes.
    settings : ADR

    Attributes
    ----------
    ends : (2, d) array
        The lower and the upper bounds.
    """

    def __init__(self, space: ParameterSpace, start: Array, settings: ADR):
        self.space = space
        self.start = start
        self.settings = settings
        self.ends = np.stack([start, start])
        self._performances: dict[tuple[int, int], list[float]] = {}

    @property
    def entropy(self) -> float:
        """Mean logarithm of the widths [nats a parameter]; -inf while one is 0."""
        with np.errstate(divide="ignore"):
            return float(np.log(self.ends[1] - self.ends[0]).mean())

    def ask(self, rng: np.random.Generator) -> tuple[tuple[int, int], Array]:
        """Draw a bound and parameter values on it.

        Parameters
        ----------
        rng : numpy.random.Generator

        Returns
        -------
        place : (int, int)
            The side, 0 for lower and 1 for upper, and the parameter.
        values : (d,) array
        """
        side = int(rng.integers(2))
        i = int(rng.integers(len(self.space)))
        values = self.ends[0] + rng.random(len(self.space)) * (self.ends[1] - self.ends[0])
        values[i] = self.ends[side, i]
        return (side, i), values

    def tell(self, place: tuple[int, int], performance: float) -> None:
        """Record the performance on a bound, and move it once there are enough of them.

        Parameters
        ----------
        place : (int, int)
            The side and the parameter.
        performance : float
        """
        settings = self.settings
        side, i = place
        performances = self._performances.setdefault(place, [])
        performances.append(performance)
        if len(performances) < settings.buffer:
            return
        average = np.mean(performances)
        performances.clear()

        outwards = settings.step * self.space[i].width * (1 if side else -1)
        move = 0.0
        if average >= settings.thresholds[1]:
            move = outwards
        elif average <= settings.thresholds[0]:
            move = -outwards
        low = self.start[i] if side else self.space.low[i]
        high = self.space.high[i] if side else self.start[i]
        self.ends[side, i] = np.clip(self.ends[side, i] + move, low, high)
