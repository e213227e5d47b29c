"""Two clusters of groups: found where they are, refused where they are not."""

import numpy as np
import pytest
from scipy import integrate, stats

from dropo.core.contracts.likelihood import Groups
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import Incompatible
from dropo.estimators.random_effects import RandomEffects
from dropo.estimators.support.clusters import find_clusters
from dropo.families.mixture import Mixture
from dropo.simulators.toy import LinearSimulator, SlidingBlock, simulate

SPACE = ParameterSpace((Parameter("a", 0.0, 10.0), Parameter("b", -5.0, 5.0)))
FAMILY = Mixture(SPACE)
CENTRES = np.array([[3.0, 0.5], [6.0, 1.5]])
SCALE = np.array([0.4, 0.3])
WEIGHT = 0.3
NOISE = 0.2
"""Standard deviation of what is known of a group's parameters."""


def given_to_search(values, rng):
    """Groups with parameters (G, d), each known up to noise; the family, and one Gaussian of all of
    them.
    """
    seen = values + NOISE * rng.standard_normal(values.shape)
    mean = seen.mean(axis=0)
    variance = np.maximum(seen.var(axis=0) - NOISE**2, 1e-3)
    precision = np.tile(np.eye(2) / NOISE**2, (len(seen), 1, 1))
    score = (seen - mean) / NOISE**2
    modes = mean + (seen - mean) * variance / (variance + NOISE**2)
    label = np.arange(len(seen))
    return Groups(label, label + 1, modes, precision, score), FAMILY, mean, np.sqrt(variance)


def drawn(count, rng, centres=CENTRES):
    """Parameters (G, d), and which are of the second cluster."""
    second = rng.random(count) < WEIGHT
    return centres[second.astype(int)] + SCALE * rng.standard_normal((count, 2)), second


def test_clusters_are_found_with_their_members():
    """Centres, scales and weight within 4 of their errors; nearly all groups in their own."""
    rng = np.random.default_rng(0)
    values, second = drawn(200, rng)
    found = find_clusters(*given_to_search(values, rng))
    assert found.phi[5] > 0  # the second is the one with the larger a, as starts are sorted
    truth = np.concatenate(
        [
            (1 - WEIGHT) * CENTRES[0] + WEIGHT * CENTRES[1],
            SCALE,
            [WEIGHT],
            CENTRES[1] - CENTRES[0],
        ]
    )
    errors = np.sqrt(np.diagonal(found.covariance))
    assert np.abs((found.phi - truth) / errors).max() < 4
    wrong = truth.copy()
    wrong[:2] = CENTRES[0]  # the control: the mean of one cluster alone
    assert np.abs((found.phi - wrong) / errors).max() > 6
    assert np.mean((found.membership > 0.5) == second) > 0.98
    assert found.sufficient


def test_the_likelihood_is_the_integral_over_the_parameters():
    """Of one parameter and a few groups, against quadrature (1e-6); the gain likewise."""
    space = ParameterSpace((Parameter("a", 0.0, 10.0),))
    seen = np.array([2.9, 3.4, 3.1, 5.8, 6.3, 3.2, 2.7, 6.0])
    mean = np.array([seen.mean()])
    sd = np.array([seen.std()])
    score = (seen - mean)[:, None] / NOISE**2
    precision = np.full((len(seen), 1, 1), 1 / NOISE**2)
    label = np.arange(len(seen))
    groups = Groups(label, label, seen[:, None], precision, score)
    family = Mixture(space)
    found = find_clusters(groups, family, mean, sd)

    def value(density):
        """The log-likelihood of all groups [nats], but for a constant."""
        total = 0.0
        for y in seen:
            points = (0.0, 10.0)
            own = lambda x, y=y: density(x) * stats.norm.pdf(y, x, NOISE)
            total += np.log(integrate.quad(own, *points, points=[y], epsabs=0, limit=500)[0])
        return total

    weights = family.weights(found.phi)
    centres = family.centres(found.phi)[:, 0]
    scale = family.scale(found.phi)[0]

    def mixture(x):
        """The density of the clusters."""
        return weights @ stats.norm.pdf(x, centres, scale)

    one = value(lambda x: stats.norm.pdf(x, mean[0], sd[0]))
    assert value(mixture) - one == pytest.approx(found.gain, rel=1e-6)
    # A maximum: other weights or scales are less likely.
    for factor in (0.8, 1.25):
        other = lambda x, f=factor: weights @ stats.norm.pdf(x, centres, f * scale)
        assert value(other) < value(mixture)


def test_one_cluster_is_no_two():
    """Of a single Gaussian two clusters do not gain enough, in at least 38 of 40 data sets."""
    enough = 0
    for seed in range(40):
        rng = np.random.default_rng([seed, 3])
        values = CENTRES[0] + SCALE * rng.standard_normal((60, 2))
        enough += find_clusters(*given_to_search(values, rng)).sufficient
    assert enough <= 2


def test_standard_errors_cover():
    """Over 60 data sets the RMS z of every mean is between 0.7 and 1.35: four errors of it."""
    z = []
    truth = (1 - WEIGHT) * CENTRES[0] + WEIGHT * CENTRES[1]
    for seed in range(60):
        rng = np.random.default_rng([seed, 4])
        values, _ = drawn(60, rng)
        found = find_clusters(*given_to_search(values, rng))
        z.append((found.phi[:2] - truth) / np.sqrt(np.diagonal(found.covariance)[:2]))
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert ((rms > 0.7) & (rms < 1.35)).all()
    assert (2 * rms > 1.35).all()  # the control: errors half as large


def batches(seed, centres=((1.1, 0.8), (1.9, 0.8)), groups=40):
    """Pushes of blocks of two batches."""
    rng = np.random.default_rng([seed, 11])
    second = rng.random(groups) < 0.5
    values = np.array(centres)[second.astype(int)] + [0.04, 0.03] * rng.standard_normal((groups, 2))
    simulator = SlidingBlock()
    actions = np.repeat(rng.normal(0, 3, (groups, 4, 1)), 5, axis=1)
    data = simulate(simulator, values, actions, np.zeros(2), noise_variance=1e-6, rng=rng)
    return Problem("batches", simulator, data, epsilon=1e-6), second


def test_two_batches_are_fitted_and_drawn(tmp_path):
    """The fit names both, draws none between them, and is the same when it is loaded."""
    problem, second = batches(1)
    fit = RandomEffects(family="mixture").fit(problem, rng=0)
    assert f"{int((~second).sum())} about mass 1.1 kg" in fit.message
    assert not any("clusters" in warning for warning in fit.warnings)
    mass = fit.sample(4000, 1)[:, 0]
    assert np.mean((mass > 1.35) & (mass < 1.65)) < 0.01
    own = RandomEffects().fit(problem, rng=0)
    between = own.sample(4000, 1)[:, 0]
    assert np.mean((between > 1.35) & (between < 1.65)) > 0.2  # the control
    assert any("--method random-effects --family mixture" in said for said in own.warnings)
    assert fit.log_likelihood > own.log_likelihood + 40
    np.testing.assert_allclose(fit.sd, own.sd, rtol=0.1)
    fit.save(tmp_path / "fit")
    again = Fit.load(tmp_path / "fit")
    np.testing.assert_array_equal(again.sample(50, 2), fit.sample(50, 2))


def test_one_batch_says_that_it_is_one():
    """Two clusters of one batch are warned of."""
    problem, _ = batches(2, ((1.5, 0.8), (1.5, 0.8)))
    fit = RandomEffects(family="mixture").fit(problem, rng=0)
    assert any("take family 'truncated_gaussian'" in said for said in fit.warnings)


def test_where_nothing_varies_there_are_no_clusters():
    """A parameter that all groups share exactly."""
    simulator = LinearSimulator(np.ones((1, 1, 1)))
    rng = np.random.default_rng(4)
    actions = np.ones((12, 6, 1))
    data = simulate(simulator, np.ones((12, 1)), actions, np.zeros(1), noise_variance=0, rng=rng)
    problem = Problem("same", simulator, data, epsilon=0.01)
    fit = RandomEffects(family="mixture").fit(problem, rng=0)
    assert fit.sd[0] < 1e-6
    assert any(
        "there are no clusters" in said or "two clusters gain" in said for said in fit.warnings
    )


def test_too_few_groups_are_refused():
    """Five groups are too few for two clusters of two parameters."""
    problem, _ = batches(3, groups=5)
    with pytest.raises(Incompatible, match="5 groups cannot tell two clusters of 2 parameters"):
        RandomEffects(family="mixture").fit(problem, rng=0)
