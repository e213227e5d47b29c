"""Whether anything smooth still predicts residuals, as it cannot where the model is right.

One test for the model check of a fit and for what remains after a diagnosis: a ridge regression of
the residuals on features of state and command, evaluated on rows that it has not seen. The callers
differ in their rows and features alone: a fit has one set of rows, predicted block by block from
the others; a diagnosis has windows to fit and windows held out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dropo.core.numerics.ridge_regression import fourier_features, ridge
from dropo.core.numerics.tails import normal_of_tail, student_tail
from dropo.core.records.trajectories import Ints
from dropo.core.services.validation import Array

Mask = NDArray[np.bool_]
Fold = tuple[Mask, Mask]
"""(n,) the rows that a regression is fitted to, and (n,) those that it predicts."""


@dataclass(frozen=True)
class ResidualTestSettings:
    """How the regression is made.

    Attributes
    ----------
    smallest_penalty : float
        Lower end of the logarithmic grid of ridge penalties from which generalised cross-validation
        chooses.
    largest_penalty : float
        Upper end of that grid.
    penalties : int
        The grid has so many penalties.
    fourier_features : int
        Random features of a Gaussian kernel [1]_.
    cut : float
        Standard deviations at which a feature is cut.
    fewest_blocks : int
        Blocks of rows below which there is no test.

    References
    ----------
    .. [1] Rahimi and Recht, Advances in Neural Information Processing Systems 20, 2007.
    """

    smallest_penalty: float = 1e-4
    largest_penalty: float = 1e2
    penalties: int = 13
    fourier_features: int = 150
    cut: float = 5.0
    fewest_blocks: int = 3

    @property
    def grid(self) -> Array:
        """The penalties."""
        ends = np.log10(self.smallest_penalty), np.log10(self.largest_penalty)
        return np.logspace(*ends, self.penalties)


SETTINGS = ResidualTestSettings()


@dataclass(frozen=True, eq=False)
class ResidualTest:
    """How much of the squared residuals a regression that has not seen them explains.

    Attributes
    ----------
    z : float
        Normal score of the fall of all signals together, over blocks; 0 where blocks are too few.
    by_signal : (p,) array
        The same of each signal.
    fall : float
        Sum of the fall over all rows that were predicted and all signals.
    """

    z: float
    by_signal: Array
    fall: float


def predictability(
    design: Array,
    residuals: Array,
    folds: Sequence[Fold],
    block: Ints,
    settings: ResidualTestSettings = SETTINGS,
) -> ResidualTest:
    """Test whether features predict residuals that the regression has not seen.

    Parameters
    ----------
    design : (n, F) array
        Features.
    residuals : (n, p) array
        Residuals, whitened or not.
    folds : sequence of (n,) bool array pairs
        Which rows each regression is fitted to and predicts; no row is predicted twice. Folds with
        nothing to fit or to predict are left out.
    block : (n,) array
        Labels of the blocks that count as independent; only those of predicted rows matter.
    settings : ResidualTestSettings
        How the regression is made.

    Returns
    -------
    ResidualTest
        Positive scores where residuals are predicted.
    """
    fall = np.zeros_like(residuals)
    predicted = np.zeros(len(residuals), dtype=bool)
    for fitted, unseen in folds:
        if not fitted.any() or not unseen.any():
            continue
        coefficients = ridge(design[fitted], residuals[fitted], settings.grid)
        left = residuals[unseen] - design[unseen] @ coefficients
        fall[unseen] = residuals[unseen] ** 2 - left**2
        predicted |= unseen
    nothing = ResidualTest(0.0, np.zeros(residuals.shape[1]), float(fall.sum()))
    if not predicted.any():
        return nothing
    label = np.unique(block[predicted], return_inverse=True)[1]
    sums = np.zeros((int(label.max()) + 1, residuals.shape[1]))
    np.add.at(sums, label, fall[predicted])
    if len(sums) < settings.fewest_blocks:
        return nothing
    whole = float(normal_score(sums.sum(axis=1)[:, None])[0])
    return ResidualTest(whole, normal_score(sums), float(fall.sum()))


def normal_score(sums: Array) -> Array:
    """Return the normal scores of t-tests that block sums have mean 0.

    Parameters
    ----------
    sums : (B, k) array
        Sums of B blocks in k columns.

    Returns
    -------
    (k,) array
        Standard normal under the hypothesis; 0 where a column does not vary.
    """
    count = len(sums)
    error = sums.std(axis=0, ddof=1) * np.sqrt(count)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(error > 0, sums.sum(axis=0) / error, 0.0)
    return score_of_t(t, count - 1)


def score_of_t(t: Array, degrees: Array | float) -> Array:
    """Return the standard normal numbers that are as unlikely as t statistics.

    Parameters
    ----------
    t : (k,) array
        Student t statistics.
    degrees : (k,) array or float
        Their degrees of freedom.

    Returns
    -------
    (k,) array
        With the signs of `t`.
    """
    tail = np.maximum(student_tail(np.abs(t), degrees), 1e-300)
    return np.asarray(np.sign(t) * normal_of_tail(tail))


def random_features(
    rows: Array, rng: np.random.Generator, settings: ResidualTestSettings = SETTINGS
) -> Array:
    """Return random Fourier features (n, F) of a Gaussian kernel of width sqrt(number of columns).

    Parameters
    ----------
    rows : (n, s) array
        Standardised columns; without columns there are no features.
    rng : numpy.random.Generator
        Draws frequencies and phases.
    settings : ResidualTestSettings
        How many features there are.

    Returns
    -------
    numpy.ndarray
        (n, F) of size about 1.
    """
    columns = rows.shape[1]
    if columns == 0:
        return np.zeros((len(rows), 0))
    count = settings.fourier_features
    frequencies = rng.standard_normal((columns, count)) / np.sqrt(columns)
    phases = rng.uniform(0, 2 * np.pi, count)
    return fourier_features(rows, frequencies, phases)
