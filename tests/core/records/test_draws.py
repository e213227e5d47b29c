"""Draws as ArviZ holds them."""

import numpy as np
import pytest

from dropo.core.records.draws import Draws
from dropo.core.services.errors import BadArgument


def draws():
    rng = np.random.default_rng(3)
    chain = np.stack([rng.normal(3.0, 0.1, (400, 4)), rng.normal(-1.0, 2.0, (400, 4))], axis=2)
    return Draws(
        chain, rng.standard_normal((400, 4)), ("mass", "epsilon[0]"), rng.random((400, 4)) < 0.01
    )


def test_inference_data_has_its_groups_and_agrees_with_the_summary():
    """Chains are walkers; ArviZ' own mean, sd and R-hat are those of `Draws`, the means of others
    are not.
    """
    arviz = pytest.importorskip("arviz")
    one = draws()
    rows = np.random.default_rng(4).standard_normal((400, 4, 7))
    data = one.to_inference_data(
        log_likelihood=rows, observed=np.zeros((7, 2)), attributes={"method": "posterior"}
    )
    assert set(data.groups()) == {"posterior", "sample_stats", "log_likelihood", "observed_data"}
    assert dict(data.posterior.sizes) == {"chain": 4, "draw": 400}
    assert data.attrs["method"] == "posterior"
    np.testing.assert_array_equal(data.sample_stats["lp"].values, one.log_density.T)
    np.testing.assert_array_equal(data.sample_stats["diverging"].values, one.diverging.T)
    np.testing.assert_array_equal(data.log_likelihood["measured"].values, rows.swapaxes(0, 1))
    table = arviz.summary(data, round_to="none")
    np.testing.assert_allclose(table["mean"], one.flat().mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(table["sd"], one.flat().std(axis=0), rtol=1e-3)
    np.testing.assert_allclose(table["r_hat"], one.split_r_hat(), atol=1e-6)
    assert not np.allclose(table["mean"], one.chain[:, 0].mean(axis=0), rtol=1e-3)


def test_divergences_of_another_shape_are_refused():
    with pytest.raises(BadArgument, match="'diverging' of Draws must be of shape"):
        Draws(np.zeros((10, 4, 1)), np.zeros((10, 4)), ("a",), np.zeros((4, 10), dtype=bool))
