"""The profile likelihood: parabolas where the model is linear, and their ends where the chi-square
says.
"""

import numpy as np
import pytest

from dropo.core.contracts.problem import Problem
from dropo.core.services.errors import BadArgument, UnknownName
from dropo.estimators.dropo import DROPO
from dropo.evaluation.profile import profile
from dropo.simulators.toy import LinearSimulator, simulate


@pytest.fixture(scope="module")
def line():
    """A linear problem with two correlated parameters, its point fit, and the exact covariance of
    the estimate.
    """
    rng = np.random.default_rng(0)
    simulator = LinearSimulator(np.array([[[1.0, 0.0]], [[0.6, 0.8]]]))
    actions = rng.normal(size=(100, 1, 2))
    data = simulate(
        simulator,
        np.tile([1.0, -2.0], (100, 1)),
        actions,
        np.zeros(1),
        noise_variance=0.01,
        rng=rng,
    )
    problem = Problem("line", simulator, data, epsilon=0.01)
    design = np.einsum("nq,qpd->npd", actions[:, 0], simulator.matrices).reshape(-1, 2)
    return problem, DROPO(family="point").fit(problem), 0.01 * np.linalg.inv(design.T @ design)


def test_one_parameter(line):
    """max - (a - mean)^2 / (2 variance) to 1e-4 nat, the other parameter at its best; the
    interval's ends to 1 % of its width.
    """
    problem, fit, covariance = line
    found = profile(problem, fit, ("x0",))
    (grid,) = found.grid
    np.testing.assert_allclose(
        found.values - found.best, -((grid - fit.mean[0]) ** 2) / (2 * covariance[0, 0]), atol=1e-4
    )
    half = 1.959964 * np.sqrt(covariance[0, 0])
    np.testing.assert_allclose(
        found.interval(), [fit.mean[0] - half, fit.mean[0] + half], atol=0.02 * half
    )
    held = (
        -((grid - fit.mean[0]) ** 2) / 2 * np.linalg.inv(covariance)[0, 0]
    )  # the other parameter held: another curve
    assert np.abs(found.values - found.best - held).max() > 0.1


def test_two_parameters(line):
    """The quadratic form of the joint covariance, and the share of the grid inside the chi-square
    ellipse.
    """
    problem, fit, covariance = line
    found = profile(problem, fit, ("x0", "x1"), points=15)
    a, b = np.meshgrid(*found.grid, indexing="ij")
    away = np.stack([a - fit.mean[0], b - fit.mean[1]], axis=-1)
    form = np.einsum("ijk,kl,ijl->ij", away, np.linalg.inv(covariance), away)
    np.testing.assert_allclose(found.values - found.best, -form / 2, atol=1e-3)
    np.testing.assert_array_equal(found.region(), form <= 5.991465)
    with pytest.raises(BadArgument, match=r"'parameters' of Profile\.interval"):
        found.interval()


def test_refusals(line):
    problem, fit, _ = line
    with pytest.raises(UnknownName, match="No parameter called 'x7'"):
        profile(problem, fit, ("x7",))
    with pytest.raises(BadArgument, match="'parameters' of profile must be one or two names"):
        profile(problem, fit, ())
    with pytest.raises(BadArgument, match="'points' of profile must be at least 5"):
        profile(problem, fit, ("x0",), points=2)
