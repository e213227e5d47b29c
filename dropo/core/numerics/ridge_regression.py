"""Ridge regression on smooth features, to see whether residuals can be predicted at all."""

import numpy as np

from dropo.core.services.validation import Array


def fourier_features(rows: Array, frequencies: Array, phases: Array) -> Array:
    """Compute random features of a Gaussian kernel.

    Parameters
    ----------
    rows : (n, s) array
        The inputs.
    frequencies : (s, F) array
        Random frequencies.
    phases : (F,) array
        Random phases [rad].

    Returns
    -------
    (n, F) array

    References
    ----------
    Rahimi and Recht, Random features for large-scale kernel machines, NeurIPS (2007).
    """
    return np.asarray(np.sqrt(2) * np.cos(rows @ frequencies + phases))


def ridge(design: Array, targets: Array, penalties: Array) -> Array:
    """Regress targets on a design, each with the penalty of best generalised cross-validation.

    Parameters
    ----------
    design : (n, F) array
        The features.
    targets : (n, p) array
        The targets.
    penalties : (k,) array
        The penalties to choose from.

    Returns
    -------
    (F, p) array
        Coefficients.

    References
    ----------
    Golub, Heath and Wahba, Technometrics 21 (1979), 215.
    """
    n = len(design)
    # In the eigenbasis of the features' second moments, every penalty is a division.
    values, vectors = np.linalg.eigh(design.T @ design / n)
    values = np.maximum(values, 0.0)
    moments = vectors.T @ (design.T @ targets) / n  # (F, p)
    best = np.full(targets.shape[1], np.inf)
    out = np.zeros_like(moments)
    for penalty in penalties:
        shrunk = moments / (values + penalty)[:, None]
        error = (
            np.mean(targets**2, axis=0)
            - 2 * np.sum(shrunk * moments, axis=0)
            + np.sum(values[:, None] * shrunk**2, axis=0)
        )
        free = 1 - float(np.sum(values / (values + penalty))) / n
        criterion = error / max(free, 1e-3) ** 2
        better = criterion < best
        best = np.where(better, criterion, best)
        out[:, better] = shrunk[:, better]
    return np.asarray(vectors @ out)
