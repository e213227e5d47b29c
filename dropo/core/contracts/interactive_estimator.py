"""The contract of online methods: they call back, to collect data on the target or to have a policy
tried, and count what that costs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.random import Generator

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.fit import Fit, Status
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, check_shape, require

T = TypeVar("T")


@dataclass(frozen=True)
class Answer(Generic[T]):
    """What a callback brings, where it says what that cost; without costs to tell, the value alone
    will do.

    value: trajectories or a number; transitions: control steps made on the target, beside those of
    the trajectories;
    steps: simulator steps, for training a policy say, beside those of the problem's own simulator,
    which are counted anyway.
    """

    value: T
    transitions: int = 0
    steps: int = 0


Collect = Callable[[Fit, Generator], Trajectories | Answer[Trajectories]]
"""Data of the target, collected with a policy for the present fit: collect(fit, rng)."""
Evaluate = Callable[[Fit, Generator], float | Answer[float]]
"""The return on the target of a policy trained under the present fit, higher is better:
evaluate(fit, rng).
"""
Performance = Callable[[Array, Generator], float | Answer[float]]
"""How well the policy does in simulation under parameter values (d,), higher is better:
performance(values, rng).
"""


class InteractiveEstimator(Estimator):
    """An estimator with a callback among its settings; its own `__post_init__` calls
    `_check_callback`.
    """

    def _check_callback(self, name: str, signature: str) -> None:
        """Refuses to be made without the callback of that name, as the command line must."""
        made = type(self).__name__
        if getattr(self, name) is None:
            raise Incompatible(
                f"Method {self.name!r} calls back to {name}{signature}, which a command "
                "line cannot give."
                f" In Python: dropo.{made}({name}={name}).fit(dropo.load('hopper'), "
                f"rng=0), with {name} a function of yours."
            )
        require(
            callable(getattr(self, name)),
            name,
            f"a function {name}{signature}",
            getattr(self, name),
            made,
        )


@dataclass
class Callbacks:
    """The callbacks of one run.

    Each has a generator of its own, is recorded in the run's evaluation log, and its cost is
    counted.

    transitions: control steps made on the target so far.
    """

    run: Run
    transitions: int = 0

    def number(self, point: Array, call: Callable[[Generator], float | Answer[float]]) -> float:
        """What the callback says about a point (m,), a finite number."""

        def ask(rng: Generator) -> tuple[Array, Answer[Any]]:
            answer = _answer(call(rng))
            require(
                bool(np.isfinite(answer.value)),
                "answer",
                "a finite number",
                answer.value,
                "the callback",
            )
            return np.array([answer.value], dtype=float), answer

        return float(self._ask(point, ask)[0])

    def data(
        self, point: Array, call: Callable[[Generator], Trajectories | Answer[Trajectories]]
    ) -> Trajectories:
        """What the callback collects at a point (m,), in the columns of the problem's own data;
        groups and times are not kept.
        """
        own = self.run.problem.trajectories
        p = own.observations.shape[1]
        q = own.actions.shape[1]

        def ask(rng: Generator) -> tuple[Array, Answer[Any]]:
            answer = _answer(call(rng))
            check_shape("observations", answer.value.observations, (None, p), "the callback")
            check_shape("actions", answer.value.actions, (None, q), "the callback")
            return _as_array(answer.value), Answer(
                None, answer.transitions + len(answer.value), answer.steps
            )

        return _as_trajectories(self._ask(point, ask), p, q)

    def _ask(self, point: Array, ask: Callable[[Generator], tuple[Array, Answer[Any]]]) -> Array:
        rng = self.run.rng.spawn(1)[0]
        simulator = self.run.problem.simulator

        def counted(_: Array) -> tuple[Array, dict[str, int]]:
            before = simulator.steps, simulator.failures
            found, answer = ask(rng)
            steps = simulator.steps - before[0] + answer.steps
            return found, {
                "steps": steps,
                "failures": simulator.failures - before[1],
                "transitions": answer.transitions,
            }

        found, counts = self.run.evaluation_log.evaluate(np.atleast_2d(point), counted)
        self.run.steps += counts["steps"]
        self.run.failures += counts["failures"]
        self.run.evaluations += 1
        self.transitions += counts["transitions"]
        return found


def distribution(problem: Problem, method: str, family_name: str, phi: Array, **found: Any) -> Fit:
    """The Fit of the family's member phi (m,), of which nothing is known but itself, as a callback
    gets it; found: what is known beside.

    Its epsilon is the problem's own, else 0, so that policies may be trained under it as it is.
    """
    family = find("families", family_name)(problem.space)
    unknown = np.full(len(problem.space), np.nan)
    noise = np.broadcast_to(
        0.0 if problem.epsilon is None else problem.epsilon, len(problem.simulator.signals)
    ).astype(float)
    fields: dict[str, Any] = {
        "mean_se": unknown,
        "scale_se": unknown,
        "epsilon": noise,
        "log_likelihood": np.nan,
        "mse": np.nan,
        "transitions": int(problem.segments.lengths.sum()),
        "status": Status.DONE,
        "message": "A law as it stands.",
        **found,
    }
    return Fit(
        method=method,
        problem=problem.name,
        space=problem.space,
        family=family_name,
        phi=phi,
        mean=family.mean(phi),
        scale=family.scale(phi),
        sd=family.sd(phi),
        correlation=family.correlation(phi),
        simulator_steps=0,
        failed_simulations=0,
        objective_evaluations=0,
        **fields,
    )


def joined(parts: list[Trajectories]) -> Trajectories:
    """All of them, one behind the other."""
    return Trajectories(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS)
    )


_COLUMNS = ("observations", "actions", "next_observations", "terminals")


def _answer(given: Any) -> Answer[Any]:
    return given if isinstance(given, Answer) else Answer(given)


def _as_array(data: Trajectories) -> Array:
    """(N, p + q + p + 1), as an evaluation log keeps it."""
    return np.column_stack([getattr(data, name) for name in _COLUMNS]).astype(float)


def _as_trajectories(array: Array, p: int, q: int) -> Trajectories:
    observations, actions, after, terminals = np.split(array, [p, p + q, 2 * p + q], axis=1)
    return Trajectories(observations, actions, after, terminals[:, 0] > 0)
