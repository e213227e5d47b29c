"""The likelihood that integrates over draws shared by a group."""

import numpy as np
import pytest
from scipy import stats

from dropo.core.catalogue import find
from dropo.core.errors import BadArgument, Incompatible
from dropo.core.noise import Noise
from dropo.core.parameters import Parameter, ParameterSpace
from dropo.core.problem import Problem
from dropo.distributions.full_gaussian import FullGaussian
from dropo.estimators.dropo import DROPO
from dropo.likelihoods.random_effects import RandomEffects
from dropo.problems.hopper import hopper_problem
from dropo.problems.hopper_data import TRUTH, simulate
from dropo.simulators.toy import LinearSimulator
from dropo.simulators.toy import simulate as toy_trajectories

NOISE = 0.01


def linear_problem(rng, groups=12, steps=5):
    """A linear simulator with two parameters and three signals, another draw for each trajectory, and the draws (G, 2)."""
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    draws = np.array([1.0, -2.0]) + np.array([0.5, 0.2]) * rng.standard_normal((groups, 2))
    data = toy_trajectories(simulator, draws, rng.normal(size=(groups, steps, 2)), np.zeros(3), noise_variance=NOISE, rng=rng)
    return Problem("linear", simulator, data, epsilon=NOISE), draws


def local(problem, family, epsilon=NOISE):
    """The likelihood around (1, -2)."""
    centre, width = np.array([1.0, -2.0]), np.array([0.5, 0.5])
    return RandomEffects(order=1).around(problem.simulator, problem.segments, family, epsilon, centre, width, np.random.default_rng(0))


def exact(problem, mean, covariance):
    """log N of each group's stacked rows: mean J mu, covariance J S J' + noise, the slow and obvious way; (G,)."""
    segments = problem.segments
    predicted, jacobian = problem.simulator.linearise(mean, segments)
    out = []
    for g in np.unique(segments.group):
        rows = segments.group[segments.rows[0]] == g
        stacked = jacobian[rows].reshape(-1, len(mean))
        sigma = stacked @ covariance @ stacked.T + NOISE * np.eye(len(stacked))
        out.append(stats.multivariate_normal.logpdf((segments.targets[rows] - predicted[rows]).ravel(), cov=sigma))
    return np.array(out)


def test_linear_groups_have_their_closed_form():
    """For a linear simulator every group's value is that of one Gaussian over its stacked rows (1e-7)."""
    problem, _ = linear_problem(np.random.default_rng(1))
    family = FullGaussian(problem.space)
    mean, covariance = np.array([0.8, -1.9]), np.array([[0.3, 0.05], [0.05, 0.1]])
    phi = family.phi_of(mean, covariance)
    np.testing.assert_allclose(local(problem, family).rows(phi), exact(problem, mean, covariance), rtol=1e-7)
    alone = find("likelihoods", "emulated")(order=1).around(
        problem.simulator, problem.segments, family, NOISE, mean, np.array([0.5, 0.5]), np.random.default_rng(0)
    )
    assert abs(alone(phi) - exact(problem, mean, covariance).sum()) > 1  # rows taken as independent draws are another model


@pytest.mark.parametrize("name", ["truncated_gaussian", "full", "point"])
@pytest.mark.parametrize("epsilon", [NOISE, Noise(np.full(3, NOISE), "factor"), Noise(np.full(3, NOISE), "each")], ids=str)
def test_scores_are_the_slopes_of_the_value(name, epsilon):
    """Against central differences, for a linear simulator, 1e-4 of the largest."""
    problem, _ = linear_problem(np.random.default_rng(2))
    objective = local(problem, find("families", name)(problem.space), epsilon)
    phi = np.array([1.1, -2.1, *([0.4, 0.3] if name != "point" else []), *([0.2] if name == "full" else [])])
    phi = np.concatenate([phi, np.full(len(objective.unknowns) - len(phi), 1.3)])
    step = 1e-5 * np.abs(phi)
    slopes = [(objective(phi + h) - objective(phi - h)) / (2 * h.sum()) for h in np.diag(step)]
    scores = objective.expand(phi)[1].sum(axis=0)
    np.testing.assert_allclose(scores, slopes, atol=1e-4 * np.abs(slopes).max())


def test_information_is_the_covariance_of_the_score():
    """Over 300 data sets at the truth, the scores have the covariance that `expand` says, within 5 standard errors."""
    rng = np.random.default_rng(3)
    problem, _ = linear_problem(rng, groups=6)
    family = FullGaussian(problem.space)
    mean, covariance = np.array([1.0, -2.0]), np.diag([0.5, 0.2]) ** 2
    phi = family.phi_of(mean, covariance)
    scores = []
    for _ in range(300):
        draws = mean + np.array([0.5, 0.2]) * rng.standard_normal((6, 2))
        actions = problem.trajectories.actions.reshape(6, 5, 2)
        data = toy_trajectories(problem.simulator, draws, actions, np.zeros(3), noise_variance=NOISE, rng=rng)
        objective = local(Problem("again", problem.simulator, data, epsilon=NOISE), family)
        scores.append(objective.expand(phi)[1].sum(axis=0))
    information = objective.expand(phi)[2]
    size = np.sqrt(np.diagonal(information))
    z = (np.mean(np.array(scores)[:, :, None] * np.array(scores)[:, None, :], axis=0) - information) / np.outer(size, size)
    error = np.sqrt(3 / 300)  # a product of two standard scores has variance of at most about 3
    assert np.abs(z).max() < 5 * error
    assert np.abs(z + np.eye(len(z))).max() > 5 * error  # an information twice as large is refused


def test_a_torso_that_varies_is_recovered_to_a_gram():
    """Table 6.2, clean: mean and spread of the hundred drawn torso masses within 1 g; independent draws are 20 g off or more."""
    masses = lambda rng, blocks: np.array(list(TRUTH.values())) + np.array([0.5, 0, 0, 0]) * rng.standard_normal((blocks, 4))
    data, drawn = simulate(500, 2, rng=7, masses=masses, block=10)
    problem = hopper_problem("table 6.2", data, 1e-8)
    shared, independent = (DROPO(likelihood=name).fit(problem, rng=0) for name in ("random-effects", "emulated"))
    assert abs(shared.mean[0] - drawn[:, 0].mean()) < 1e-3
    assert abs(shared.sd[0] - drawn[:, 0].std()) < 1e-3
    assert (shared.scale[1:] < 1e-3).all()
    assert abs(independent.mean[0] - drawn[:, 0].mean()) > 0.02


def test_groups_come_back_with_their_own_parameters():
    """Each group's mode lies within 4.5 of its posterior standard deviations of its draw; those of permuted groups do not."""
    problem, draws = linear_problem(np.random.default_rng(4))
    family = FullGaussian(problem.space)
    phi = family.phi_of([1.0, -2.0], np.diag([0.5, 0.2]) ** 2)
    modes, posterior = local(problem, family).group_estimates(phi)
    sd = np.sqrt(np.einsum("gdd->gd", posterior))
    assert np.abs((modes - draws) / sd).max() < 4.5
    assert np.abs((modes[::-1] - draws) / sd).max() > 4.5


@pytest.mark.parametrize("name", ["emulated", "random-effects"])
def test_no_noise_is_refused(name):
    """With epsilon 0 the covariance is singular: refused with the way out, before the search."""
    problem, _ = linear_problem(np.random.default_rng(6))
    with pytest.raises(BadArgument, match=r"must be positive for every signal.*Give epsilon > 0 .*, or 'learn'\."):
        DROPO(likelihood=name, epsilon=0.0).fit(problem)


def test_a_log_normal_law_is_refused():
    """Random effects are Gaussian: the refusal says what to use."""
    problem, _ = linear_problem(np.random.default_rng(5))
    family = find("families", "log_normal")(ParameterSpace((Parameter("a", 1.0, 2.0), Parameter("b", 1.0, 2.0))))
    with pytest.raises(Incompatible, match=r"LogNormal is no Gaussian, as random effects are. Use 'truncated_gaussian' or 'full'."):
        local(problem, family)
