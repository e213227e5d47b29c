"""What a search has fitted, in a file from which an interrupted diagnosis goes on.

A record of windows holds the numbers that they were linearized and fitted at, not what is simulated
there: this takes one simulation to have again, to the same bits, where the fit took many.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from dropo.core.contracts.simulator import Simulator
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import (
    Library,
    LinearizedWindows,
    linearize,
    shift_linearization,
)
from dropo.diagnosis.search.whitening import noise_of
from dropo.diagnosis.search.windows import Windows

T = TypeVar("T")
Sides = tuple[LinearizedWindows, LinearizedWindows]
"""The windows to fit, and those held out."""


def recorded(
    log: EvaluationLog,
    simulator: Simulator,
    key: Array,
    compute: Callable[[], T],
    pack: Callable[[T], Array],
    unpack: Callable[[Array], T],
) -> T:
    """Compute something, or make it again from its record.

    Parameters
    ----------
    log : EvaluationLog
        The records, in the order of the search.
    simulator : Simulator
        Its steps are those of the computation either way.
    key : (k,) array
        What the computation begins with: a record of another one is refused.
    compute : callable
        The result.
    pack : callable
        From the result to its record (r,).
    unpack : callable
        From the record to the same result.

    Returns
    -------
    T
    """
    begun = simulator.steps
    made: list[T] = []

    def evaluate(_: Array) -> tuple[Array, dict[str, int]]:
        made.append(compute())
        return pack(made[0])[None], {"steps": simulator.steps - begun}

    records, counts = log.evaluate(key[None], evaluate)
    result = made[0] if made else unpack(records[0])
    simulator.steps = begun + counts["steps"]
    return result


def recorded_sides(
    log: EvaluationLog,
    library: Library,
    key: Array,
    windows: tuple[Windows, Windows],
    compute: Callable[[], Sides],
    near: Sides | None = None,
) -> Sides:
    """Fit windows, or make them again from their record.

    Parameters
    ----------
    log, key, compute
        As of `recorded`.
    library : Library
        The simulator with every effect.
    windows : tuple of Windows
        The windows to fit, and those held out.
    near : tuple of LinearizedWindows, optional
        What the fit begins with: where these were linearized, the result mostly was too.

    Returns
    -------
    Sides
    """

    def pack(sides: Sides) -> Array:
        return np.concatenate([_numbers(side) for side in sides])

    def unpack(record: Array) -> Sides:
        # The two differ in how many windows they have.
        both = len(record) - len(windows[0]) - len(windows[1])
        train, test = np.split(record, [both // 2 + len(windows[0])])
        begun = (None, None) if near is None else near
        return (
            _again(library, windows[0], train, begun[0]),
            _again(library, windows[1], test, begun[1]),
        )

    return recorded(log, library.simulator, key, compute, pack, unpack)


def _numbers(side: LinearizedWindows) -> Array:
    """Where windows were linearized and where they are, the noise of both, and which are lost."""
    first, noise = side.linearized_at
    there = side.whiten.noise.numbers
    return np.concatenate([first, noise.numbers, side.theta, there, [side.shifted], side.lost])


def _again(
    library: Library, windows: Windows, numbers: Array, near: LinearizedWindows | None
) -> LinearizedWindows:
    """The windows of a record."""
    m = len(library.simulator.space)
    q = (len(numbers) - 1 - len(windows)) // 2 - m  # numbers of the noise
    first, there, theta, noise, shifted, lost = np.split(numbers, np.cumsum([m, q, m, q, 1]))
    if not shifted[0]:
        return linearize(library, windows, first, noise_of(there))
    if near is None or not _is_at(near, first, there):
        near = linearize(library, windows, first, noise_of(there))
    begun = replace(near, lost=lost.astype(bool))
    return shift_linearization(library, begun, theta, noise_of(noise))


def _is_at(windows: LinearizedWindows, theta: Array, noise: Array) -> bool:
    """Whether windows were linearized at these numbers."""
    first, there = windows.linearized_at
    return np.array_equal(first, theta) and np.array_equal(there.numbers, noise)
