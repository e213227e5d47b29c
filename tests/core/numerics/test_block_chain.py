"""Normal equations of a chain of states with common numbers."""

import numpy as np

from dropo.core.numerics.block_chain import BlockChain


def dense(
    links: tuple[np.ndarray, ...], rows: tuple[np.ndarray, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """The same least squares as one matrix and its right side, whitened."""
    by_state, by_common, ahead, weights = links
    n, s = len(ahead) + 1, ahead.shape[1]
    b = by_common.shape[2]
    matrix = []
    right = []
    for t in range(n - 1):
        for i in range(s):
            row = np.zeros(n * s + b)
            row[(t + 1) * s + i] = 1.0
            row[t * s : (t + 1) * s] -= by_state[t, i]
            row[n * s :] -= by_common[t, i]
            matrix.append(np.sqrt(weights[t, i]) * row)
            right.append(np.sqrt(weights[t, i]) * ahead[t, i])
    measured, common, residual, sizes = rows
    for t in range(n):
        for i in range(measured.shape[1]):
            row = np.zeros(n * s + b)
            row[t * s : (t + 1) * s] = measured[t, i]
            row[n * s :] = common[t, i]
            matrix.append(np.sqrt(sizes[t, i]) * row)
            right.append(np.sqrt(sizes[t, i]) * residual[t, i])
    return np.array(matrix), np.array(right)


def test_solution_and_deviations() -> None:
    """Both are those of the dense least squares."""
    rng = np.random.default_rng(0)
    n, s, b, m = 6, 3, 2, 4
    links = (
        rng.normal(size=(n - 1, s, s)),
        rng.normal(size=(n - 1, s, b)),
        rng.normal(size=(n - 1, s)),
        rng.uniform(0.5, 2, (n - 1, s)),
    )
    rows = (
        rng.normal(size=(n, m, s)),
        rng.normal(size=(n, m, b)),
        rng.normal(size=(n, m)),
        rng.uniform(0.0, 2, (n, m)),
    )
    chain = BlockChain.zeros(n, s, b)
    chain.add_links(*links)
    chain.add_rows(*rows)
    matrix, right = dense(links, rows)
    states, common = chain.solve()
    expected = np.linalg.lstsq(matrix, right, rcond=None)[0]
    np.testing.assert_allclose(np.append(states.ravel(), common), expected, atol=1e-10)
    alone = matrix[:, : n * s]
    sd = np.sqrt(np.diagonal(np.linalg.inv(alone.T @ alone))).reshape(n, s)
    np.testing.assert_allclose(chain.deviations(np.array([0, 4])), sd[[0, 4]], atol=1e-10)
