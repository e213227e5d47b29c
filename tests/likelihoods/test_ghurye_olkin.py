"""The unbiased density: its source's form, its mean, its noise, and its refusals."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from dropo.core.services.errors import BadArgument
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.ghurye_olkin import GhuryeOlkin
from dropo.likelihoods.monte_carlo import MonteCarlo
from dropo.testing import check_likelihood
from dropo.testing.likelihoods import Line, line_data
from tests.reference.densities import ghurye_olkin_one_by_one


def test_keeps_to_the_contract():
    """The checks that plug-in authors call are silent."""
    check_likelihood(GhuryeOlkin())


@pytest.mark.parametrize(("draws", "p"), [(6, 1), (9, 4), (30, 3)])
def test_agrees_with_the_form_of_its_source(draws, p):
    """The simplified constants and the rank-one determinant give the published ratio, zeros
    included.
    """
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(draws, 60, p)) @ rng.normal(size=(p, p))
    targets = samples[0] * rng.uniform(0, 4, (60, 1))
    slow = ghurye_olkin_one_by_one(samples, targets)
    assert 0 < np.isinf(slow).sum() < 50
    np.testing.assert_allclose(GhuryeOlkin().log_density(samples, targets, 0.0), slow, rtol=1e-8)


def z_of_mean_density(likelihood, epsilon):
    """Standard errors between the mean density over 40,000 sets of K = 12 normal predictions and
    N(y; mean, cov + epsilon).
    """
    rng = np.random.default_rng(7)
    rows = 40_000
    p = 2
    root = np.array([[1.0, 0.0], [0.7, 0.6]])
    predictions = rng.standard_normal((12, rows, p)) @ root.T
    target = np.array([1.2, 0.4])
    noise = rng.standard_normal((12, rows, p))
    density = np.exp(
        likelihood.log_density(predictions, np.broadcast_to(target, (rows, p)), epsilon, noise)
    )
    truth = multivariate_normal(np.zeros(p), root @ root.T + np.diag(epsilon)).pdf(target)
    return (density.mean() - truth) / (density.std() / np.sqrt(rows))


@pytest.mark.parametrize("epsilon", [[0.0, 0.0], [0.3, 0.1]])
def test_unbiased_where_the_plug_in_density_is_not(epsilon):
    """The mean density is the true one within 4.5 standard errors; the plug-in Gaussian's mean (the
    control) is not.
    """
    assert abs(z_of_mean_density(GhuryeOlkin(), np.array(epsilon))) < 4.5
    assert abs(z_of_mean_density(MonteCarlo(), np.array(epsilon))) > 4.5


def test_noise_is_drawn_for_each_row_and_fixed():
    """Bound, it has independent base points and a noise number for each draw, row and signal, the
    same at every call.
    """
    simulator = Line()
    segments = line_data(np.random.default_rng(0)).segments()
    family = TruncatedGaussian(simulator.space)
    bound = GhuryeOlkin(30).bind(simulator, segments, family, 0.05, np.random.default_rng(1))
    assert bound.fixed.noise.shape == (30, len(segments), 2)
    phi = family.phi([2.0, 2.0], [0.3, 0.3])
    assert bound(phi) == bound(phi)
    np.testing.assert_array_equal(
        bound.fixed.base, family.base(30, np.random.default_rng(1).spawn(2)[0], independent=True)
    )


def test_noise_of_rows_averages_out():
    """The noise covariance that a point's samples show has its chance error in each row apart: over
    400 rows it averages out.

    The mean of the rows' log densities varies between noise sets sqrt(400) less than one row's;
    noise shared by all rows would not be averaged at all.
    """
    rows = 400
    sets = 30
    rng = np.random.default_rng(0)
    predictions = np.zeros((40, rows, 1))
    targets = np.zeros((rows, 1))
    own = np.array(
        [
            GhuryeOlkin()
            .log_density(predictions, targets, 1.0, rng.standard_normal((40, rows, 1)))
            .mean()
            for _ in range(sets)
        ]
    )
    shared = [np.broadcast_to(rng.standard_normal((40, 1, 1)), (40, rows, 1)) for _ in range(sets)]
    together = np.array(
        [GhuryeOlkin().log_density(predictions, targets, 1.0, noise).mean() for noise in shared]
    )
    assert own.std() < 0.2 * together.std()


def test_far_targets_are_minus_infinity():
    """Where the positive part vanishes, beyond about sqrt(K) standard deviations, the row alone is
    -inf.
    """
    predictions = np.random.default_rng(0).normal(size=(25, 2, 1))
    near, far = GhuryeOlkin().log_density(predictions, np.array([[0.0], [6.0]]), 0.0)
    assert np.isfinite(near)
    assert far == -np.inf


def test_refusals():
    """Too few draws are refused when bound and when called; samples must carry the noise that
    epsilon says.
    """
    simulator = Line()
    segments = line_data(np.random.default_rng(0)).segments()
    words = r"'draws' of GhuryeOlkin must be above p \+ 3 = 5, for p = 2 signals. Got 5"
    with pytest.raises(BadArgument, match=words):
        GhuryeOlkin(draws=5).bind(simulator, segments, None, 0.1, np.random.default_rng(0))
    with pytest.raises(BadArgument, match=words):
        GhuryeOlkin().log_density(np.zeros((5, 3, 2)), np.zeros((3, 2)), 0.0)
    with pytest.raises(
        BadArgument,
        match=r"'noise' of GhuryeOlkin.log_density must be given where epsilon is not 0",
    ):
        GhuryeOlkin().log_density(np.zeros((9, 3, 2)), np.zeros((3, 2)), 0.1)
    with pytest.raises(BadArgument, match=r"at row 0 is singular .* Give epsilon > 0"):
        GhuryeOlkin().log_density(np.zeros((9, 3, 2)), np.zeros((3, 2)), 0.0)
