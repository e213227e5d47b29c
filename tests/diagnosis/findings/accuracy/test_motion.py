"""What a page shows of motions: residuals made independent, whatever their covariances are."""

import numpy as np
import pytest

from dropo.diagnosis.findings.accuracy.motion import _square_roots


def test_square_roots_of_covariances():
    """Root times its transpose is the covariance, of singular ones too, which have no Cholesky
    factor; sizes of signals may differ by many orders.
    """
    rng = np.random.default_rng(0)
    mixed = rng.normal(size=(3, 4, 4))
    whole = mixed @ mixed.transpose(0, 2, 1)
    np.testing.assert_allclose(_square_roots(whole), np.linalg.cholesky(whole))
    few = rng.normal(size=(3, 4, 2)) * np.array([1.0, 1e-6, 1e3, 1.0])[:, None]
    singular = few @ few.transpose(0, 2, 1) * np.array([1.0, 1.0, 1.0])[:, None, None]
    singular[:, 0, 0] *= 1 - 3e-14
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(singular)
    roots = _square_roots(singular)
    size = np.sqrt(np.diagonal(singular, axis1=1, axis2=2))
    off = roots @ roots.transpose(0, 2, 1) - singular
    assert np.abs(off / (size[:, :, None] * size[:, None, :])).max() < 1e-13
    assert np.isfinite(np.linalg.solve(roots, np.ones((3, 4, 1)))).all()
