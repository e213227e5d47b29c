"""Whether anything smooth in state and command still predicts the residuals of windows that nothing
was fitted to.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array
from dropo.diagnosis.search.linearization import LinearizedWindows
from dropo.evaluation.residual_tests import ResidualTestSettings, predictability, random_features

REGRESSION = ResidualTestSettings(smallest_penalty=1e-3, largest_penalty=1e3)


@dataclass(frozen=True)
class OmnibusSettings:
    """What the regression sees, and when structure is left.

    Attributes
    ----------
    regression : ResidualTestSettings
        Of the ridge regression.
    commands : int
        How many commands a residual may follow: the present one and those before it.
    minimum_z : float
        Standard errors by block above which structure is left ...
    minimum_fraction : float
        ... if it is also more than this fraction of the noise's variance: where predictions are
        right to rounding, the noise is at its lower bound.
    """

    regression: ResidualTestSettings = REGRESSION
    commands: int = 3
    minimum_z: float = 3.0
    minimum_fraction: float = 1e-3


SETTINGS = OmnibusSettings()


@dataclass(frozen=True)
class Omnibus:
    """The fall of the squared residuals by a regression that has not seen them.

    Attributes
    ----------
    z : float
        Normal score of the fall of all signals.
    signals : tuple of float
        Normal score of each signal's.
    fraction : float
        The fall as a fraction of the noise's variance.
    present : bool
        Whether structure is left.
    """

    z: float
    signals: tuple[float, ...]
    fraction: float
    present: bool


def omnibus(
    train: LinearizedWindows,
    test: LinearizedWindows,
    rng: np.random.Generator,
    settings: OmnibusSettings = SETTINGS,
    *,
    measured: NDArray[np.bool_] | None = None,
) -> Omnibus:
    """Test whether state and command predict what is left in windows held out.

    The errors of a signal that was estimated from others follow from the motion by themselves.

    Parameters
    ----------
    train : LinearizedWindows
        Windows that the regression is fitted to.
    test : LinearizedWindows
        Windows held out, which it predicts.
    rng : numpy.random.Generator
        Draws the random features.
    settings : OmnibusSettings
        Of the regression.
    measured : (p,) bool array, optional
        Which signals are tested; all if None.

    Returns
    -------
    Omnibus
        The test's numbers; 0 for a signal that is not tested.
    """
    rows = [_state_and_command(linearized, settings.commands) for linearized in (train, test)]
    mean = rows[0].mean(axis=0)
    sd = rows[0].std(axis=0)
    moves = sd > 1e-9 * np.maximum(np.abs(mean), 1e-12)
    both = np.concatenate(rows)
    cut = settings.regression.cut
    scaled = np.clip((both[:, moves] - mean[moves]) / sd[moves], -cut, cut)
    smooth = random_features(scaled, rng, settings.regression)
    design = np.concatenate([np.ones((len(both), 1)), scaled, smooth], axis=1)
    residuals = np.concatenate([_whitened(train), _whitened(test)])
    tested = np.ones(residuals.shape[1], dtype=bool) if measured is None else measured
    residuals = residuals[:, tested]
    unseen = np.arange(len(both)) >= len(rows[0])
    blocks = [
        np.repeat(linearized.windows.block, linearized.windows.length)
        for linearized in (train, test)
    ]
    found = predictability(
        design, residuals, [(~unseen, unseen)], np.concatenate(blocks), settings.regression
    )
    fraction = found.fall / (len(rows[1]) * residuals.shape[1])
    present = found.z > settings.minimum_z and fraction > settings.minimum_fraction
    by_signal = np.zeros(len(tested))
    by_signal[tested] = found.by_signal
    return Omnibus(found.z, tuple(by_signal.tolist()), fraction, present)


def _whitened(linearized: LinearizedWindows) -> Array:
    """(W L, p) whitened residuals, windows across an impact held down."""
    n = linearized.residuals.shape[1]
    whole = linearized.flat(linearized.residuals).reshape(len(linearized.windows), -1)[:, :n]
    return whole.reshape(-1, len(linearized.whiten.sigma))


def _state_and_command(linearized: LinearizedWindows, commands: int) -> Array:
    """(W L, s) the window's start, the step, and the commands up to it."""
    segments = linearized.windows.segments
    data = segments.trajectories
    length = linearized.windows.length
    origins = np.array([span[0] for span in data.spans])
    first = origins[data.trajectory[segments.steps]]
    given = [data.actions[np.maximum(segments.steps - k, first)] for k in range(commands)]
    starts = np.repeat(segments.starts[:, None], length, axis=1)
    step = np.broadcast_to(np.arange(length)[None, :, None], (len(segments), length, 1))
    return np.concatenate([starts, step, *given], axis=2).reshape(len(segments) * length, -1)
