"""Simulations that reach their end, but far from anything measured.

Such are those of a stiff contact that adds energy, or of an unstable step.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array

# A variance below this fraction of a signal's mean square, or of its unit squared, is rounding.
FLAT = 1e-24


@dataclass(frozen=True)
class ExplosionSettings:
    """When a simulation has exploded.

    Attributes
    ----------
    largest_error : float
        No prediction may be off by more than so many ranges of its signal, or typical errors where
        these are larger.
    largest_typical_error : float
        Where the typical error of a signal is more than so many of its ranges, all simulations
        have exploded.
    """

    largest_error: float = 100.0
    largest_typical_error: float = 1e6


def flat(targets: Array) -> NDArray[np.bool_]:
    """Find the signals that do not vary, such as rotations, whose targets are angles of 0.

    Parameters
    ----------
    targets : (R, p) array
        Measured rows.

    Returns
    -------
    (p,) array of bool
    """
    size = np.maximum(np.mean(targets**2, axis=0), 1.0)
    return np.asarray(np.var(targets, axis=0) <= FLAT * size)


def ranges(targets: Array) -> Array:
    """Measure how far signals are from their median at most.

    Parameters
    ----------
    targets : (R, p) array
        Measured rows.

    Returns
    -------
    (p,) array
        In the signals' units; infinite for signals that do not vary.
    """
    farthest = np.abs(targets - np.median(targets, axis=0)).max(axis=0)
    return np.where(flat(targets), np.inf, farthest)


def settled(
    predictions: Array,
    targets: Array,
    signal_ranges: Array,
    settings: ExplosionSettings | None = None,
) -> NDArray[np.bool_]:
    """Find the simulations that neither failed nor exploded in any row.

    A row of an exploded simulation says nothing of the model, and drowns all others in a
    regression: its square has more digits than a float.

    Parameters
    ----------
    predictions : (K, R, p) array
        Predictions of K simulations; NaN where one failed.
    targets : (R, p) array
        Measured rows.
    signal_ranges : (p,) array
        The signals' `ranges`.
    settings : ExplosionSettings, optional
        When a simulation has exploded.

    Returns
    -------
    (K,) array of bool
    """
    settings = settings or ExplosionSettings()
    whole: NDArray[np.bool_] = np.asarray(np.isfinite(predictions).all(axis=(1, 2)))
    errors = np.abs(predictions[whole] - targets)
    if (errors <= settings.largest_error * signal_ranges).all():
        return whole
    typical = np.median(errors, axis=(0, 1))
    limit = settings.largest_error * np.maximum(signal_ranges, typical)
    plausible = (typical <= settings.largest_typical_error * signal_ranges).all()
    whole[whole] = (errors <= limit).all(axis=(1, 2)) & plausible
    return whole
