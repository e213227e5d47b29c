"""Whether anything smooth in state and command still predicts the residuals of windows that nothing
was fitted to.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, t

from dropo.core.numerics.ridge_regression import fourier_features, ridge
from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import LinearizedWindows

FEATURES = 150  # random Fourier features (Rahimi and Recht 2007)
RIDGES = np.logspace(-3, 3, 13)
BEFORE = 3  # commands that a residual may follow: the present one and those before it
PRESENT = 3.0  # standard errors by block from which something is there
# of the noise's variance: where predictions are right to rounding, the noise is held at its least
NEGLIGIBLE = 1e-3


@dataclass(frozen=True)
class Omnibus:
    """z: of the fall of the squared residuals of all signals by a regression that has not seen
    them; signals: each one's; share: the fall as a share of the noise's variance.
    """

    z: float
    signals: tuple[float, ...]
    share: float

    @property
    def present(self) -> bool:
        """Whether structure is left."""
        return self.z > PRESENT and self.share > NEGLIGIBLE


def omnibus(train: LinearizedWindows, test: LinearizedWindows, rng: np.random.Generator) -> Omnibus:
    """Ridge regression, its penalty by generalised cross-validation, from the windows to fit to
    those held out.
    """
    base = [_state_and_command(seen) for seen in (train, test)]
    mean = base[0].mean(axis=0)
    sd = base[0].std(axis=0)
    moves = sd > 1e-9 * np.maximum(np.abs(mean), 1e-12)
    frequencies = rng.standard_normal((int(moves.sum()), FEATURES)) / np.sqrt(max(1, moves.sum()))
    phases = rng.uniform(0, 2 * np.pi, FEATURES)
    smooth = [
        _features(rows[:, moves], mean[moves], sd[moves], frequencies, phases) for rows in base
    ]
    rest = [_rows(seen) for seen in (train, test)]
    left = rest[1] - smooth[1] @ ridge(smooth[0], rest[0], RIDGES)
    fall = (
        (rest[1] ** 2 - left**2).reshape(len(test.windows), test.windows.length, -1).sum(axis=1)
    )  # (W, p)
    label = np.unique(test.windows.block, return_inverse=True)[1]
    blocks = np.stack([np.bincount(label, column) for column in fall.T], axis=1)
    return Omnibus(
        _z(blocks.sum(axis=1)),
        tuple(_z(column) for column in blocks.T),
        float(fall.mean()) / test.windows.length,
    )


def _z(blocks: Array) -> float:
    """Standard errors of the sum, as many as a normal variable would need to be as unlikely."""
    error = blocks.std(ddof=1) * np.sqrt(len(blocks)) if len(blocks) > 1 else 0.0
    return (
        float(norm.isf(max(t.sf(blocks.sum() / error, len(blocks) - 1), 1e-300)))
        if error > 0
        else 0.0
    )


def _rows(seen: LinearizedWindows) -> Array:
    """(W L, p) whitened residuals, windows across an impact held down."""
    n = seen.residuals.shape[1]
    p = len(seen.whiten.sigma)
    whole = seen.flat(seen.residuals).reshape(len(seen.windows), -1)[:, :n]
    return whole.reshape(-1, p)


def _state_and_command(seen: LinearizedWindows) -> Array:
    """(W L, s) the window's start, the step, and the commands up to it."""
    segments = seen.windows.segments
    actions = segments.trajectories.actions
    length = seen.windows.length
    first = np.array([span[0] for span in segments.trajectories.spans])[
        segments.trajectories.trajectory[segments.steps]
    ]
    commands = [
        actions[np.maximum(segments.steps - k, first)] for k in range(BEFORE)
    ]  # (W, L, q) each
    starts = np.repeat(segments.starts[:, None], length, axis=1)
    step = np.broadcast_to(np.arange(length)[None, :, None], (len(segments), length, 1))
    return np.concatenate([starts, step, *commands], axis=2).reshape(len(segments) * length, -1)


def _features(rows: Array, mean: Array, sd: Array, frequencies: Array, phases: Array) -> Array:
    scaled = np.clip((rows - mean) / sd, -5, 5)
    return np.concatenate(
        [np.ones((len(rows), 1)), scaled, fourier_features(scaled, frequencies, phases)], axis=1
    )
