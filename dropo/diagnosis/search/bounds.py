"""Numbers that a fit has moved to the end of their interval."""

from collections.abc import Sequence

import numpy as np

from dropo.core.contracts.effect import EffectInstance
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import Library

NEAR = 1e-6
"""Fraction of an interval within which a number is at its end."""


def totals_of(library: Library, theta: Array, instances: Sequence[EffectInstance]) -> Array:
    """Add to numbers what the model has of them.

    Parameters
    ----------
    library : Library
        Where the numbers stand.
    theta : (m,) array
        Declared parameters, then the magnitudes of effects.
    instances : sequence of EffectInstance
        The effects that are there.

    Returns
    -------
    (m,) array
        Of fractions, what they leave of 1.
    """
    totals = np.array(theta, dtype=float)
    for instance in instances:
        indices = library.indices_of[instance.label]
        for index, quantity in zip(indices, instance.quantities, strict=True):
            totals[index] += 1.0 if quantity.relative else quantity.base or 0.0
    return totals


def at_bounds(
    library: Library, theta: Array, fitted: Ints, instances: Sequence[EffectInstance]
) -> tuple[str, ...]:
    """Say which fitted numbers are at a bound that is not nothing.

    Parameters
    ----------
    library, theta, instances
        As of `totals_of`.
    fitted : (f,) int array
        The numbers that count.

    Returns
    -------
    tuple of str
        A sentence each.
    """
    space = library.simulator.space
    totals = totals_of(library, theta, instances)
    found = []
    for i in fitted.tolist():
        near = NEAR * (space.high[i] - space.low[i])
        inside = space.low[i] + near < theta[i] < space.high[i] - near
        if not inside and abs(totals[i]) > near:
            found.append(
                f"{space.names[i]} is at its bound, {theta[i]:.4g}: something else may act like"
                " it, or its interval is too narrow."
            )
    return tuple(found)
