"""Slow, obvious twins of the sampled likelihoods, row by row."""

import numpy as np
from scipy.special import gammaln
from scipy.stats import multivariate_normal


def gaussian_one_by_one(predictions, targets, epsilon):
    """(R,) log N(y; mean, Cov + diag(epsilon)), by numpy.cov and scipy's density."""
    out = []
    for r, target in enumerate(targets):
        covariance = np.atleast_2d(np.cov(predictions[:, r].T)) + np.diag(epsilon)
        out.append(multivariate_normal(predictions[:, r].mean(axis=0), covariance).logpdf(target))
    return np.array(out)


def ghurye_olkin_one_by_one(samples, targets):
    """(R,) log of the unbiased estimate in its source's form: ratio of constants c(p, n-2) / c(p,
    n-1), and two determinants.
    """
    n, _, p = samples.shape
    out = []
    for r, target in enumerate(targets):
        scatter = np.atleast_2d(np.cov(samples[:, r].T)) * (n - 1)
        u = target - samples[:, r].mean(axis=0)
        rest = scatter - np.outer(u, u) / (1 - 1 / n)
        if np.linalg.eigvalsh(rest).min() <= 0:
            out.append(-np.inf)
            continue
        constant = (
            -0.5 * p * np.log(2 * np.pi)
            + _log_c(p, n - 2)
            - _log_c(p, n - 1)
            - 0.5 * p * np.log(1 - 1 / n)
        )
        out.append(
            constant
            - 0.5 * (n - p - 2) * np.linalg.slogdet(scatter)[1]
            + 0.5 * (n - p - 3) * np.linalg.slogdet(rest)[1]
        )
    return np.array(out)


def _log_c(k, v):
    """log c(k, v), c(k, v) = 2^(-k v / 2) pi^(-k (k - 1) / 4) / prod_{i = 1}^{k} Gamma((v - i + 1)
    / 2).
    """
    return (
        -0.5 * k * v * np.log(2)
        - 0.25 * k * (k - 1) * np.log(np.pi)
        - sum(gammaln((v - i + 1) / 2) for i in range(1, k + 1))
    )
