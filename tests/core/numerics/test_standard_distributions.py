"""Standard laws: polynomials orthonormal under them, Gauss rules and quantiles."""

from math import erf, exp, pi, sqrt

import numpy as np
import pytest
from scipy import integrate, stats

from dropo.core.numerics.standard_distributions import NORMAL, TRUNCATED_NORMAL, UNIFORM
from dropo.families.truncated_gaussian import SD

LAWS = {
    "normal": (NORMAL, stats.norm(), 9.0),
    "uniform": (UNIFORM, stats.uniform(-1, 2), 1.0),
    "truncated normal": (TRUNCATED_NORMAL, stats.truncnorm(-2, 2), 2.0),
}


@pytest.mark.parametrize("name", LAWS)
def test_polynomials_are_orthonormal(name):
    """Degrees 0 to 5, by adaptive integration against scipy's density; the normal's polynomials
    under another law are not.
    """
    distribution, reference, reach = LAWS[name]
    x = np.linspace(-reach, reach, 40_001)
    gram = lambda own: integrate.simpson(
        np.einsum("xi,xj,x->xij", own.orthonormal(x, 5), own.orthonormal(x, 5), reference.pdf(x)),
        x=x,
        axis=0,
    )
    np.testing.assert_allclose(gram(distribution), np.eye(6), atol=1e-8)
    other = UNIFORM if distribution is NORMAL else NORMAL
    assert np.abs(gram(other) - np.eye(6)).max() > 0.1


@pytest.mark.parametrize("name", LAWS)
def test_rule_and_quantiles_are_those_of_the_law(name):
    """The Gauss rule's first eight moments, and the quantiles, are scipy's."""
    distribution, reference, _ = LAWS[name]
    assert distribution.weights.sum() == pytest.approx(1.0, rel=1e-13)
    for k in range(1, 9):
        assert distribution.weights @ distribution.nodes**k == pytest.approx(
            reference.moment(k), rel=1e-8, abs=1e-10
        )
    base = np.linspace(0.01, 0.99, 99)
    np.testing.assert_allclose(distribution.quantile(base), reference.ppf(base), atol=1e-12)


def test_a_normal_cut_at_two_has_sd_0_8796():
    """sqrt(1 - 2 c phi(c) / (2 Phi(c) - 1)) at c = 2: the published remark's factor, and the rule's
    second moment.
    """
    by_hand = sqrt(1 - 4 * exp(-2) / sqrt(2 * pi) / erf(sqrt(2)))
    assert by_hand == pytest.approx(0.8796, abs=5e-5)
    assert pytest.approx(by_hand, rel=1e-13) == SD
    assert np.sqrt(TRUNCATED_NORMAL.weights @ TRUNCATED_NORMAL.nodes**2) == pytest.approx(
        by_hand, rel=1e-12
    )
