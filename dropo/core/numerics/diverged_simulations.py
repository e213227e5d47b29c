"""Simulations that reach their end, but nowhere near anything measured: a stiff contact that adds
energy, an unstable step.
"""

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array

# ranges of a signal, or typical errors where these are larger: no prediction is farther from its
# measurement
BEYOND = 100.0
HOPELESS = 1e6  # ranges of a signal: where typical errors are larger, all has exploded
FLAT = 1e-24  # of a signal's mean square, or [its unit^2]: a variance below it is rounding


def flat(targets: Array) -> NDArray[np.bool_]:
    """(p,) which signals of the targets (R, p) do not vary; rotations do not, whose targets are
    angles of 0.
    """
    return np.asarray(
        np.var(targets, axis=0) <= FLAT * np.maximum(np.mean(targets**2, axis=0), 1.0)
    )


def ranges(targets: Array) -> Array:
    """(p,) how far the targets (R, p) of each signal are from their median at most; infinite where
    they do not vary.
    """
    return np.where(flat(targets), np.inf, np.abs(targets - np.median(targets, axis=0)).max(axis=0))


def settled(predictions: Array, targets: Array, reach: Array) -> NDArray[np.bool_]:
    """(K,) which of the predictions (K, R, p) neither failed nor exploded in any row; reach: (p,)
    the signals' `ranges`.

    A row of an exploded simulation tells nothing of the model, and drowns all others in a
    regression: its square has more digits than a float.
    """
    whole: NDArray[np.bool_] = np.asarray(np.isfinite(predictions).all(axis=(1, 2)))
    errors = np.abs(predictions[whole] - targets)
    if (errors <= BEYOND * reach).all():
        return whole
    typical = np.median(errors, axis=(0, 1))
    whole[whole] = (errors <= BEYOND * np.maximum(reach, typical)).all(axis=(1, 2)) & (
        typical <= HOPELESS * reach
    ).all()
    return whole
