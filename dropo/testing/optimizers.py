"""What every optimizer must keep to."""

import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from dropo.core.contracts.optimizer import Optimizer
from dropo.core.services.validation import Array

CENTRE = np.array([0.3, 0.6, 0.8])  # where the sphere has its minimum
FIRST = 12  # batches that are compared


class Factory(Protocol):
    """What makes an optimizer: its class, or a function of the same arguments."""

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
        return np.asarray(2 * (point - CENTRE))


class Cost(Protocol):
    """A cost over the unit box, with its gradient."""

    def __call__(self, point: Array) -> float: ...

    def gradient(self, point: Array) -> Array: ...


@contextmanager
def no_global_stream(name: str) -> Iterator[None]:
    """Asserts that a block leaves numpy's global random stream alone; its state comes back
    afterwards.
    """
    kept = np.random.get_state()  # noqa: NPY002
    np.random.seed(20210415)  # noqa: NPY002, a state that no plug-in arrives at by seeding the stream the same way twice
    before = pickle.dumps(np.random.get_state())  # noqa: NPY002
    try:
        yield
        assert pickle.dumps(np.random.get_state()) == before, (
            f"{name} touches numpy's global random stream"
        )  # noqa: NPY002
    finally:
        np.random.set_state(kept)  # noqa: NPY002


def answer(optimizer: Optimizer, cost: Cost) -> Array:
    """One batch asked, evaluated and told; the points (P, m)."""
    points = optimizer.ask()
    gradients = np.array([cost.gradient(p) for p in points]) if optimizer.needs_gradients else None
    optimizer.tell(points, np.array([cost(p) for p in points]), gradients)
    return points


def drive(
    optimizer: Optimizer, cost: Cost, *, batches: int | None = None
) -> tuple[Array, str | None]:
    """The points (n, m) that an optimizer asked for until it stopped, or its budget or the batches
    ran out, and its reason.
    """
    asked: list[Array] = []
    most = optimizer.budget if batches is None else batches
    try:
        while (
            (reason := optimizer.stop()) is None
            and sum(map(len, asked)) < optimizer.budget
            and len(asked) < most
        ):
            asked.append(answer(optimizer, cost))
    finally:
        optimizer.close()
    return np.concatenate(asked), reason


def check_optimizer(factory: Factory, *, tolerance: float = 1e-3, budget: int = 4000) -> None:
    """Raises AssertionError, saying what is wrong, unless the optimizers that the factory makes
    keep to the contract.

    tolerance: how close, in the unit box, it must come to the minimum of a sphere of three
    dimensions within the budget.
    """
    make: Callable[[int], Optimizer] = lambda seed: factory(
        3, np.random.default_rng(seed), budget=budget
    )
    name = type(make(0)).__name__
    _check_batches(make(0), name)
    _check_randomness(make, name)
    _check_independence(make, name)
    _check_close(make(0), name)
    _check_finds(make(0), name, tolerance)


def _check_batches(optimizer: Optimizer, name: str) -> None:
    asked = []
    least = (np.zeros(3), np.inf)
    for _ in range(FIRST):
        if (reason := optimizer.stop()) is not None:
            assert isinstance(reason, str) and len(reason) > 10, (
                f"{name}.stop must give None or a sentence, not {reason!r}"
            )  # noqa: PT018
            break
        again = optimizer.stop()
        assert again is None, (
            f"{name}.stop changes its mind when it is asked twice: None, then {again!r}"
        )
        points = answer(optimizer, Sphere())
        assert (points >= 0).all() and (points <= 1).all(), f"{name}.ask leaves the unit box"  # noqa: PT018
        asked.append(points)
        costs = [Sphere()(p) for p in points]
        if min(costs) < least[1]:
            least = points[int(np.argmin(costs))], min(costs)
        assert optimizer.best[1] == least[1], (
            f"{name}.best has the cost {optimizer.best[1]}, the least told was {least[1]}"
        )
        assert np.array_equal(optimizer.best[0], least[0]), (
            f"{name}.best is {optimizer.best[0]}, the least cost was told at {least[0]}"
        )
    optimizer.close()
    distinct = len(np.unique(np.concatenate(asked), axis=0))
    assert distinct > 1, f"{name} asked for the same point all the time"


def _check_randomness(make: Callable[[int], Optimizer], name: str) -> None:
    with no_global_stream(name):
        first = drive(make(1), Sphere(), batches=FIRST)[0]
    again = drive(make(1), Sphere(), batches=FIRST)[0]
    assert np.array_equal(first, again), (
        f"{name} is not deterministic: the same rng asked for other points"
    )


def _check_independence(make: Callable[[int], Optimizer], name: str) -> None:
    alone = drive(make(2), Sphere(), batches=FIRST)[0]
    one = make(2)
    other = make(3)
    asked = []
    for _ in range(FIRST):
        if one.stop() is not None:
            break
        asked.append(answer(one, Sphere()))
        if other.stop() is None:
            answer(other, Sphere())
    one.close()
    other.close()
    assert np.array_equal(alone, np.concatenate(asked)), (
        f"{name} asks for other points when a second one runs beside it"
    )


def _check_close(optimizer: Optimizer, name: str) -> None:
    before = set(threading.enumerate())
    for _ in range(2):
        if optimizer.stop() is None:
            answer(optimizer, Sphere())
    optimizer.close()
    optimizer.close()
    left = [t.name for t in set(threading.enumerate()) - before if t.is_alive()]
    assert not left, f"{name}.close leaves threads behind: {left}"


def _check_finds(optimizer: Optimizer, name: str, tolerance: float) -> None:
    drive(optimizer, Sphere())
    off = float(np.abs(optimizer.best[0] - CENTRE).max())
    assert off <= tolerance, (
        f"{name} ends {off:.2g} of the box away from the minimum of a sphere, more than "
        f"{tolerance:g}"
    )
