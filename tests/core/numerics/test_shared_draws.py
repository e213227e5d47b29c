"""How scores of a spread vary where rows share draws, beside simulated rows."""

import numpy as np
import pytest

from dropo.core.numerics.linear_gaussian import scores_and_information
from dropo.core.numerics.shared_draws import pairs_of, score_covariances

UNITS = 8
ROWS = 5
SETS = 4000
NOISE = np.array([0.05, 0.2])
SPREAD = np.array([[0.5, 0.2, 0.0], [0.2, 0.3, 0.0], [0.0, 0.0, 0.0]])
LABEL = np.repeat(np.arange(UNITS), ROWS)
VARYING = np.array([0, 1])


@pytest.fixture(scope="module")
def jacobian():
    """Of rows of which some tell much more than others."""
    rng = np.random.default_rng(0)
    return rng.standard_normal((UNITS * ROWS, 2, 3)) * rng.exponential(1.0, (UNITS * ROWS, 1, 1))


@pytest.mark.parametrize("shared", [False, True])
def test_scores_vary_so(jacobian, shared):
    """The variances of simulated sums of scores, within 5 standard errors, where rows share draws
    and where they do not; of means and of variances.
    """
    rng = np.random.default_rng(1)
    found = score_covariances(jacobian, SPREAD, NOISE, LABEL, VARYING)
    root = np.linalg.cholesky(SPREAD[:2, :2])
    sums = []
    for _ in range(SETS // 10):
        z = rng.standard_normal((10, UNITS if shared else UNITS * ROWS, 2)) @ root.T
        if shared:
            z = z[:, LABEL]
        residuals = np.einsum("rpd,krd->krp", jacobian[:, :, :2], z)
        residuals += np.sqrt(NOISE) * rng.standard_normal(residuals.shape)
        sums += [
            scores_and_information(one, jacobian, SPREAD, NOISE)[0].sum(axis=0) for one in residuals
        ]
    seen = np.var(sums, axis=0)[[0, 1, 3, 4]]
    diagonal = [i for i, (a, b) in enumerate(pairs_of(2).T) if a == b]
    mean, pair = found.mean, found.pair
    if shared:
        mean = mean + found.mean_shared
        pair = pair + found.pair_shared
    expected = np.concatenate([np.diagonal(mean), np.diagonal(pair)[diagonal]])
    # Sums of squares have heavier tails than a Gaussian.
    np.testing.assert_allclose(seen, expected, rtol=5 * np.sqrt(8 / SETS))


def test_rows_alone_share_nothing(jacobian):
    """Of units of one row nothing is added, and the information is that of the variances."""
    found = score_covariances(jacobian, SPREAD, NOISE, np.arange(UNITS * ROWS), VARYING)
    np.testing.assert_allclose(found.mean_shared, 0, atol=1e-9 * found.mean.max())
    np.testing.assert_allclose(found.pair_shared, 0, atol=1e-9 * found.pair.max())
    residuals = np.zeros((UNITS * ROWS, 2))
    information = scores_and_information(residuals, jacobian, SPREAD, NOISE)[1]
    np.testing.assert_allclose(found.pair[0, 0], information[3, 3])
    np.testing.assert_allclose(found.pair[2, 2], information[4, 4])
    np.testing.assert_allclose(found.mean, information[:2, :2])
