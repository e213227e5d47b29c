"""The contract of interactive estimators, which call back while they run.

They ask to collect data on the target or to try a policy there, and count what that costs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.random import Generator

from dropo.core.contracts.estimator import Estimator, Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.core.services.validation import Array, check_shape, require

T = TypeVar("T")


@dataclass(frozen=True)
class Answer(Generic[T]):
    """What a callback returns where it says what that cost; else its value alone will do.

    Attributes
    ----------
    value : Trajectories or float
        Data, or a number.
    transitions : int
        Control steps made on the target, beside those of the trajectories.
    steps : int
        Simulator steps, such as for training a policy, beside those of the problem's own
        simulator, which are counted anyway.
    """

    value: T
    transitions: int = 0
    steps: int = 0


Collect = Callable[[Fit, Generator], Trajectories | Answer[Trajectories]]
"""collect(fit, rng): data of the target, collected with a policy for the present fit."""
Evaluate = Callable[[Fit, Generator], float | Answer[float]]
"""evaluate(fit, rng): the return on the target of a policy trained under the present fit, higher is
better."""
Performance = Callable[[Array, Generator], float | Answer[float]]
"""performance(values, rng): the return of the policy in simulation under parameters (d,), higher is
better."""


class InteractiveEstimator(Estimator):
    """An estimator with a callback among its settings.

    Its own `__post_init__` calls `_check_callback`.
    """

    def _check_callback(self, name: str, signature: str) -> None:
        """Refuse to be made without the callback of that name, as the command line must."""
        kind = type(self).__name__
        callback = getattr(self, name)
        if callback is None:
            raise Incompatible(
                f"Method {self.name!r} calls back to {name}{signature}, which a command line "
                f"cannot give. In Python: dropo.{kind}({name}={name}).fit(dropo.load('hopper'), "
                f"rng=0), with {name} a function of yours."
            )
        require(callable(callback), name, f"a function {name}{signature}", callback, kind)


@dataclass
class Callbacks:
    """Calls the callbacks of one run.

    Each call has a generator of its own, is recorded in the run's evaluation log, and its cost is
    counted.

    Attributes
    ----------
    run : Run
        The run.
    transitions : int
        Control steps made on the target so far.
    """

    run: Run
    transitions: int = 0

    def number(self, point: Array, call: Callable[[Generator], float | Answer[float]]) -> float:
        """Ask a callback for a number.

        Parameters
        ----------
        point : (m,) array
            What it is asked about, for the evaluation log.
        call : callable
            call(rng) gives the number or an `Answer`.

        Returns
        -------
        float

        Raises
        ------
        BadArgument
            If the number is not finite.
        """

        def ask(rng: Generator) -> tuple[Array, Answer[Any]]:
            answer = _as_answer(call(rng))
            finite = bool(np.isfinite(answer.value))
            require(finite, "answer", "a finite number", answer.value, "the callback")
            return np.array([answer.value], dtype=float), answer

        return float(self._ask(point, ask)[0])

    def data(
        self, point: Array, call: Callable[[Generator], Trajectories | Answer[Trajectories]]
    ) -> Trajectories:
        """Ask a callback for data.

        Parameters
        ----------
        point : (m,) array
            What it is asked about, for the evaluation log.
        call : callable
            call(rng) gives trajectories or an `Answer`.

        Returns
        -------
        Trajectories
            In the columns of the problem's own data, without groups and times.

        Raises
        ------
        BadArgument
            If the data have other columns than the problem's.
        """
        own = self.run.problem.trajectories
        p = own.observations.shape[1]
        q = own.actions.shape[1]

        def ask(rng: Generator) -> tuple[Array, Answer[Any]]:
            answer = _as_answer(call(rng))
            data = answer.value
            check_shape("observations", data.observations, (None, p), "the callback")
            check_shape("actions", data.actions, (None, q), "the callback")
            transitions = answer.transitions + len(data)
            return _as_array(data), Answer(None, transitions, answer.steps)

        return _as_trajectories(self._ask(point, ask), p, q)

    def _ask(self, point: Array, ask: Callable[[Generator], tuple[Array, Answer[Any]]]) -> Array:
        """The array of an answer, new or recorded, with its costs added to the run's."""
        rng = self.run.rng.spawn(1)[0]
        simulator = self.run.problem.simulator

        def counted(_: Array) -> tuple[Array, dict[str, int]]:
            steps_before = simulator.steps
            failures_before = simulator.failures
            found, answer = ask(rng)
            return found, {
                "steps": simulator.steps - steps_before + answer.steps,
                "failures": simulator.failures - failures_before,
                "transitions": answer.transitions,
            }

        found, counts = self.run.evaluation_log.evaluate(np.atleast_2d(point), counted)
        self.run.steps += counts["steps"]
        self.run.failures += counts["failures"]
        self.run.evaluations += 1
        self.transitions += counts["transitions"]
        return found


def distribution(problem: Problem, method: str, family_name: str, phi: Array, **found: Any) -> Fit:
    """Make a fit of one member of a family, as a callback gets it.

    Nothing but the distribution is known of it, unless `found` says more. Its epsilon is the
    problem's own, else 0, so that policies can be trained under it as it is.

    Parameters
    ----------
    problem : Problem
        Whose parameters these are.
    method : str
        The method's name.
    family_name : str
        The family's name.
    phi : (m,) array
        The member.
    **found
        Further fields of the `Fit`.

    Returns
    -------
    Fit

    Raises
    ------
    UnknownName
        If there is no such family.
    """
    family = find("families", family_name)(problem.space)
    unknown = np.full(len(problem.space), np.nan)
    epsilon = 0.0 if problem.epsilon is None else problem.epsilon
    fields: dict[str, Any] = {
        "mean_se": unknown,
        "scale_se": unknown,
        "epsilon": np.broadcast_to(epsilon, len(problem.simulator.signals)).astype(float),
        "log_likelihood": np.nan,
        "mse": np.nan,
        "transitions": int(problem.segments.lengths.sum()),
        "status": Status.DONE,
        "message": "A distribution as it stands.",
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


_COLUMNS = ("observations", "actions", "next_observations", "terminals")


def joined(parts: list[Trajectories]) -> Trajectories:
    """Join the data of several calls.

    Parameters
    ----------
    parts : list of Trajectories
        In order; their groups and times are left out.

    Returns
    -------
    Trajectories
    """
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS]
    return Trajectories(*columns)


def _as_answer(given: Any) -> Answer[Any]:
    """What a callback returned as an `Answer`."""
    return given if isinstance(given, Answer) else Answer(given)


def _as_array(data: Trajectories) -> Array:
    """Trajectories as the array (N, p + q + p + 1) that an evaluation log keeps."""
    return np.column_stack([getattr(data, name) for name in _COLUMNS]).astype(float)


def _as_trajectories(array: Array, p: int, q: int) -> Trajectories:
    """Trajectories from the array that `_as_array` gave."""
    observations, actions, after, terminals = np.split(array, [p, p + q, 2 * p + q], axis=1)
    return Trajectories(observations, actions, after, terminals[:, 0] > 0)
