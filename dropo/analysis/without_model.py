"""What usually follows a state and a command, learned from the data alone: for disturbances where
there is no model yet.
"""

from dataclasses import dataclass

import numpy as np

from dropo.core.numerics.ridge_regression import fourier_features, ridge
from dropo.core.numerics.robust_statistics import deviation
from dropo.core.records.trajectories import Ints, Segments, Signal, Trajectories
from dropo.core.services.validation import Array, require
from dropo.data.outliers.disturbances import Disturbances, scan

FEATURES = 100  # of a Gaussian kernel of state and mean command
PENALTIES = np.logspace(-6, 0, 13)
FOLDS = 5  # each block of time is predicted from the others, so that no span explains itself
# robust standard deviations of a span's worst window: more than with a model, whose errors vary
# less
SURE = 12.0
CUT = 3.0  # robust standard deviations at which an error is cut before the second fit


@dataclass(frozen=True, eq=False)
class _Usual:
    """Predicts the change over a window from its start and its mean command: linear plus smooth,
    robust, and cross-fitted.

    angles: the columns that count by their sine and cosine.
    """

    angles: list[int]
    frequencies: Array
    phases: Array

    def __call__(self, windows: Segments) -> Array:
        state = windows.starts
        command = windows.actions.mean(axis=1)
        turned = state[:, self.angles]
        plain = np.delete(state, self.angles, axis=1)
        base = np.concatenate([np.sin(turned), np.cos(turned), plain, command], axis=1)
        base = (base - base.mean(axis=0)) / np.maximum(base.std(axis=0), 1e-12)
        smooth = fourier_features(base, self.frequencies, self.phases)
        design = np.concatenate([np.ones((len(base), 1)), base, np.tanh(3 * base), smooth], axis=1)
        change = windows.targets - state
        size = np.maximum(change.std(axis=0), 1e-300)
        fold = _folds(windows)
        out = np.empty_like(change)
        for k in range(FOLDS):
            out[fold == k] = (
                design[fold == k]
                @ _robust_ridge(design[fold != k], change[fold != k] / size)
                * size
            )
        return state + out


def _folds(windows: Segments) -> Ints:
    """(W,) blocks of time in turn; windows of one block are of one fold."""
    first = windows.steps[:, 0]
    return (first * 10 * FOLDS // (int(first.max()) + 1)) % FOLDS


def _robust_ridge(design: Array, targets: Array) -> Array:
    """Ridge twice: what the first one misses by far counts as cut off in the second."""
    coefficients = ridge(design, targets, PENALTIES)
    errors = targets - design @ coefficients
    limit = CUT * deviation(errors)
    return ridge(design, targets - errors + np.clip(errors, -limit, limit), PENALTIES)


def find_disturbances_without_model(
    trajectories: Trajectories, signals: tuple[Signal, ...], step: float, rng: np.random.Generator
) -> Disturbances:
    """Spans in which the trajectories do not move as they do elsewhere in like states under like
    commands.

    signals: names and units of the observation's columns, which must be whole states and no
    quaternions; step: of the control [s]. It sees less than a scan with a fitted model, and needs
    data that come by the same states often.
    """
    p = trajectories.observations.shape[1]
    q = trajectories.actions.shape[1]
    require(
        len(signals) == p,
        "signals",
        f"of {p} columns",
        len(signals),
        "find_disturbances_without_model",
    )
    angles = [i for i, signal in enumerate(signals) if signal.unit == "rad"]
    count = p + q + len(angles)
    usual = _Usual(
        angles,
        rng.standard_normal((count, FEATURES)) / np.sqrt(count),
        rng.uniform(0, 2 * np.pi, FEATURES),
    )
    return scan(usual, lambda windows: windows.targets, signals, trajectories, step, sure=SURE)
