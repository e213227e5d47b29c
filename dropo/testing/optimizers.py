"""Checks that every optimizer must pass."""

import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from dropo.core.contracts.optimizer import CallbackOptimizer, Optimizer
from dropo.core.services.errors import InvalidInput
from dropo.core.services.validation import Array

CENTRE = np.array([0.3, 0.6, 0.8])
"""Where the sphere has its minimum."""
BATCHES = 12
"""Number of batches that are compared between two runs."""


class Factory(Protocol):
    """Makes an optimizer: its class, or a function of the same arguments."""

    def __call__(
        self,
        dimension: int,
        rng: np.random.Generator,
        *,
        start: Array | None = None,
        step: float = 0.25,
        budget: int = 5000,
    ) -> Optimizer: ...


class Sphere:
    """cost(u) = |u - CENTRE|^2, with its gradient."""

    def __call__(self, point: Array) -> float:
        return float(np.sum((point - CENTRE) ** 2))

    def gradient(self, point: Array) -> Array:
        """Compute the gradient of the squared distance to the centre.

        Parameters
        ----------
        point : (m,) array
            Where.

        Returns
        -------
        (m,) array
        """
        return np.asarray(2 * (point - CENTRE))


class Cost(Protocol):
    """A cost over the unit box, with its gradient."""

    def __call__(self, point: Array) -> float: ...

    def gradient(self, point: Array) -> Array:
        """Compute the gradient of the cost.

        Parameters
        ----------
        point : (m,) array
            Where.

        Returns
        -------
        (m,) array
        """


@contextmanager
def no_global_stream(name: str) -> Iterator[None]:
    """Assert that a block leaves numpy's global random stream alone, and restore its state.

    Parameters
    ----------
    name : str
        What runs in the block, for the message.

    Raises
    ------
    AssertionError
        If the block draws from the stream or seeds it.

    Yields
    ------
    None
    """
    original = np.random.get_state()  # noqa: NPY002
    # a state that no plug-in arrives at by seeding the stream the same way twice
    np.random.seed(20210415)  # noqa: NPY002
    before = pickle.dumps(np.random.get_state())  # noqa: NPY002
    try:
        yield
        after = pickle.dumps(np.random.get_state())  # noqa: NPY002
        assert after == before, f"{name} touches numpy's global random stream"
    finally:
        np.random.set_state(original)  # noqa: NPY002


def answer(optimizer: Optimizer, cost: Cost) -> Array:
    """Asks an optimizer for one batch, evaluates it and tells the optimizer its costs.

    Parameters
    ----------
    optimizer : Optimizer
        Any optimizer that has not stopped.
    cost : Cost
        The cost to be minimised.

    Returns
    -------
    (P, m) array
        The points of the batch.
    """
    points = optimizer.ask()
    gradients = np.array([cost.gradient(p) for p in points]) if optimizer.needs_gradients else None
    optimizer.tell(points, np.array([cost(p) for p in points]), gradients)
    return points


def drive(
    optimizer: Optimizer, cost: Cost, *, batches: int | None = None
) -> tuple[Array, str | None]:
    """Run an optimizer until it stops or its budget or the number of batches is used up.

    Parameters
    ----------
    optimizer : Optimizer
        A new optimizer; it is closed at the end.
    cost : Cost
        The cost to be minimised.
    batches : int, optional
        Maximum number of batches, by default the budget.

    Returns
    -------
    points : (n, m) array
        The points that the optimizer asked for.
    reason : str or None
        Why it stopped; None if it did not stop by itself.
    """
    asked: list[Array] = []
    max_batches = optimizer.budget if batches is None else batches
    evaluations = 0
    try:
        reason = optimizer.stop()
        while reason is None and evaluations < optimizer.budget and len(asked) < max_batches:
            asked.append(answer(optimizer, cost))
            evaluations += len(asked[-1])
            reason = optimizer.stop()
    finally:
        optimizer.close()
    return np.concatenate(asked), reason


def check_optimizer(factory: Factory, *, tolerance: float = 1e-3, budget: int = 4000) -> None:
    """Check that the optimizers which a factory makes keep to the contract of `Optimizer`.

    Parameters
    ----------
    factory : Factory
        The optimizer's class, or a function of the same arguments.
    tolerance : float
        How close, in the unit box, it must come to the minimum of a sphere of three dimensions.
    budget : int
        Number of evaluations within which it must do so.

    Raises
    ------
    AssertionError
        If a rule is broken; the message says which.
    """

    def make(seed: int) -> Optimizer:
        return factory(3, np.random.default_rng(seed), budget=budget)

    name = type(make(0)).__name__
    try:
        _check_batches(make(0), name)
        _check_randomness(make, name)
        _check_independence(make, name)
        _check_close(make(0), name)
        _check_finds(make(0), name, tolerance)
    except InvalidInput as error:
        raise AssertionError(str(error)) from error


def _check_batches(optimizer: Optimizer, name: str) -> None:
    """Points lie in the box and differ, `stop` is consistent, and `best` is the best point."""
    asked = []
    best_point = np.zeros(3)
    lowest = np.inf
    for _ in range(BATCHES):
        reason = optimizer.stop()
        if reason is not None:
            _check_reason(optimizer, reason, name)
            break
        again = optimizer.stop()
        assert again is None, (
            f"{name}.stop changes its mind when it is asked twice: None, then {again!r}"
        )
        points = answer(optimizer, Sphere())
        inside = bool(((points >= 0) & (points <= 1)).all())
        assert inside, f"{name}.ask leaves the unit box"
        asked.append(points)
        costs = [Sphere()(point) for point in points]
        if min(costs) < lowest:
            best_point = points[int(np.argmin(costs))]
            lowest = min(costs)
        assert optimizer.best[1] == lowest, (
            f"{name}.best has the cost {optimizer.best[1]}, the lowest cost given was {lowest}"
        )
        assert np.array_equal(optimizer.best[0], best_point), (
            f"{name}.best is {optimizer.best[0]}, the lowest cost was given at {best_point}"
        )
    optimizer.close()
    assert asked, f"{name} stops before it has asked for a point: {reason}"
    distinct = len(np.unique(np.concatenate(asked), axis=0))
    assert distinct > 1, f"{name} asked for the same point all the time"


def _check_reason(optimizer: Optimizer, reason: object, name: str) -> None:
    """What an optimizer gives when it has stopped is a sentence."""
    rule = f"{name}.stop must give None or a sentence"
    if isinstance(optimizer, CallbackOptimizer):
        rule = f"{name}._minimise must return a sentence that says why it stopped"
    is_sentence = isinstance(reason, str) and len(reason) > 10
    assert is_sentence, f"{rule}, not {reason!r}"


def _check_randomness(make: Callable[[int], Optimizer], name: str) -> None:
    """The same rng gives the same points, and the global stream is not touched."""
    with no_global_stream(name):
        first = drive(make(1), Sphere(), batches=BATCHES)[0]
    again = drive(make(1), Sphere(), batches=BATCHES)[0]
    assert np.array_equal(first, again), (
        f"{name} is not deterministic: the same rng asked for other points"
    )


def _check_independence(make: Callable[[int], Optimizer], name: str) -> None:
    """Two optimizers at the same time do not disturb each other."""
    expected = drive(make(2), Sphere(), batches=BATCHES)[0]
    one = make(2)
    other = make(3)
    asked = []
    for _ in range(BATCHES):
        if one.stop() is not None:
            break
        asked.append(answer(one, Sphere()))
        if other.stop() is None:
            answer(other, Sphere())
    one.close()
    other.close()
    assert np.array_equal(expected, np.concatenate(asked)), (
        f"{name} asks for other points when a second one runs beside it"
    )


def _check_close(optimizer: Optimizer, name: str) -> None:
    """Closing twice is allowed, and leaves no thread behind."""
    before = set(threading.enumerate())
    for _ in range(2):
        if optimizer.stop() is None:
            answer(optimizer, Sphere())
    optimizer.close()
    optimizer.close()
    left = [t.name for t in set(threading.enumerate()) - before if t.is_alive()]
    assert not left, f"{name}.close leaves threads behind: {left}"


def _check_finds(optimizer: Optimizer, name: str, tolerance: float) -> None:
    """The minimum of a sphere is found."""
    _, reason = drive(optimizer, Sphere())
    if reason is not None:
        _check_reason(optimizer, reason, name)
    error = float(np.abs(optimizer.best[0] - CENTRE).max())
    assert error <= tolerance, (
        f"{name} ends {error:.2g} of the box away from the minimum of a sphere, more than "
        f"{tolerance:g}"
    )
