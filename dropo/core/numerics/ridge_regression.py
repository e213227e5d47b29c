"""Ridge regression on smooth features, to see whether residuals can be predicted at all."""

import numpy as np

from dropo.core.services.validation import Array


def fourier_features(rows: Array, frequencies: Array, phases: Array) -> Array:
    """Random features (n, F) of a Gaussian kernel (Rahimi and Recht 2007): rows (n, s), frequencies
    (s, F), phases (F,).
    """
    return np.asarray(np.sqrt(2) * np.cos(rows @ frequencies + phases))


def ridge(design: Array, targets: Array, penalties: Array) -> Array:
    """(F, p) coefficients of targets (n, p) on the design (n, F); for each target the one of the
    penalties (k,) that generalised cross-validation prefers (Golub, Heath and Wahba 1979).
    """
    n = len(design)
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
        criterion = error / max(1 - float(np.sum(values / (values + penalty))) / n, 1e-3) ** 2
        better = criterion < best
        best = np.where(better, criterion, best)
        out[:, better] = shrunk[:, better]
    return np.asarray(vectors @ out)
