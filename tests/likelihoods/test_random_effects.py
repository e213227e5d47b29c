"""The likelihood that integrates over draws shared by a group."""

import numpy as np
import pytest
from scipy import stats

from dropo.core.contracts.noise import Noise
from dropo.core.contracts.problem import Problem
from dropo.core.numerics import kept_rows
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.registry import find
from dropo.estimators.dropo import DROPO
from dropo.families.full_gaussian import FullGaussian
from dropo.likelihoods.random_effects import RandomEffects
from dropo.simulators.toy import LinearSimulator, SlidingBlock
from dropo.simulators.toy import simulate as toy_trajectories
from dropo.testing.likelihoods import check_likelihood

NOISE = 0.01
NOISES = [
    NOISE,
    *(Noise(np.full(3, NOISE), kind) for kind in ("factor", "each")),
    Noise(np.full(3, NOISE), "each", start=True),
]


def linear_problem(rng, groups=12, steps=5):
    """A linear simulator with two parameters and three signals, another draw for each trajectory,
    and the draws (G, 2).
    """
    simulator = LinearSimulator(rng.normal(size=(2, 3, 2)))
    draws = np.array([1.0, -2.0]) + np.array([0.5, 0.2]) * rng.standard_normal((groups, 2))
    data = toy_trajectories(
        simulator,
        draws,
        rng.normal(size=(groups, steps, 2)),
        np.zeros(3),
        noise_variance=NOISE,
        rng=rng,
    )
    return Problem("linear", simulator, data, epsilon=NOISE), draws


def local(problem, family, epsilon=NOISE):
    """The likelihood around (1, -2)."""
    centre = np.array([1.0, -2.0])
    width = np.array([0.5, 0.5])
    return RandomEffects(order=1).linearize_at(
        problem.simulator,
        problem.segments,
        family,
        epsilon,
        centre,
        width,
        np.random.default_rng(0),
    )


def exact(problem, mean, covariance):
    """log N of each group's stacked rows: mean J mu, covariance J S J' + noise, the slow and
    obvious way; (G,).
    """
    segments = problem.segments
    predicted, jacobian = problem.simulator.linearize(mean, segments)
    out = []
    for g in np.unique(segments.group):
        rows = segments.group[segments.rows[0]] == g
        stacked = jacobian[rows].reshape(-1, len(mean))
        sigma = stacked @ covariance @ stacked.T + NOISE * np.eye(len(stacked))
        out.append(
            stats.multivariate_normal.logpdf(
                (segments.targets[rows] - predicted[rows]).ravel(), cov=sigma
            )
        )
    return np.array(out)


def test_models_of_their_own_change_nothing_for_a_linear_simulator():
    """Its modes are right at once, and the likelihood is the same to rounding."""
    problem, _ = linear_problem(np.random.default_rng(0))
    objective = local(problem, FullGaussian(problem.space))
    phi = FullGaussian(problem.space).phi_of([1.0, -2.0], np.diag([0.2, 0.05]))
    assert (objective.mode_errors(phi) < 1e-6).all()
    which = np.arange(12) % 2 == 0
    own = objective.with_own_models(phi, which, np.random.default_rng(1))
    np.testing.assert_allclose(own.rows(phi), objective.rows(phi), rtol=1e-9)
    np.testing.assert_allclose(own.groups(phi).mean, objective.groups(phi).mean, rtol=1e-8)
    np.testing.assert_array_equal(own.own.centre[~which], objective.own.centre[~which])


def test_modes_far_out_are_found_by_models_of_their_own():
    """A block twice as heavy as the population's: its mode is off in the population's emulator,
    and right after a few models of its own.
    """
    masses = np.array([[1.4, 0.8], [1.6, 0.8], [3.2, 0.8]])
    rng = np.random.default_rng(2)
    actions = rng.normal(0, 3, (3, 20, 1))
    data = toy_trajectories(
        SlidingBlock(), masses, actions, np.zeros(2), noise_variance=1e-8, rng=rng
    )
    problem = Problem("blocks", SlidingBlock(), data, epsilon=1e-8)
    family = FullGaussian(problem.space)
    phi = family.phi_of([1.5, 0.8], np.diag([1.0, 0.01]))
    width = np.array([0.2, 0.1])
    objective = RandomEffects().linearize_at(
        problem.simulator, problem.segments, family, 1e-8, phi[:2], width, rng
    )
    assert np.isinf(objective.mode_errors(phi)[2])
    for _ in range(6):
        objective = objective.with_own_models(phi, objective.mode_errors(phi) > 0.1, rng)
    assert (objective.mode_errors(phi) < 0.1).all()
    np.testing.assert_allclose(objective.groups(phi).mean[:, 0], masses[:, 0], rtol=2e-3)


def test_linear_groups_have_their_closed_form():
    """For a linear simulator every group's value is that of one Gaussian over its stacked rows
    (1e-7).
    """
    problem, _ = linear_problem(np.random.default_rng(1))
    family = FullGaussian(problem.space)
    mean = np.array([0.8, -1.9])
    covariance = np.array([[0.3, 0.05], [0.05, 0.1]])
    phi = family.phi_of(mean, covariance)
    np.testing.assert_allclose(
        local(problem, family).rows(phi), exact(problem, mean, covariance), rtol=1e-7
    )
    alone = find("likelihoods", "emulated")(order=1).linearize_at(
        problem.simulator,
        problem.segments,
        family,
        NOISE,
        mean,
        np.array([0.5, 0.5]),
        np.random.default_rng(0),
    )
    assert (
        abs(alone(phi) - exact(problem, mean, covariance).sum()) > 1
    )  # rows taken as independent draws are another model


def member(objective, name):
    """An ordinary phi of the family of that name."""
    own = np.array(
        [1.1, -2.1, *([0.4, 0.3] if name != "point" else []), *([0.2] if name == "full" else [])]
    )
    return np.concatenate([own, np.linspace(1.3, 0.8, len(objective.unknowns) - len(own))])


@pytest.mark.parametrize("name", ["truncated_gaussian", "full", "point"])
@pytest.mark.parametrize("epsilon", NOISES, ids=["known", "factor", "each", "start"])
def test_scores_are_the_slopes_of_the_value(name, epsilon):
    """Against central differences, for a linear simulator, 1e-4 of the largest."""
    problem, _ = linear_problem(np.random.default_rng(2))
    objective = local(problem, find("families", name)(problem.space), epsilon)
    phi = member(objective, name)
    step = 1e-5 * np.abs(phi)
    slopes = [(objective(phi + h) - objective(phi - h)) / (2 * h.sum()) for h in np.diag(step)]
    scores = objective.value_score_information(phi)[1].sum(axis=0)
    np.testing.assert_allclose(scores, slopes, atol=1e-4 * np.abs(slopes).max())


@pytest.mark.parametrize("name", ["truncated_gaussian", "full"])
@pytest.mark.parametrize("epsilon", NOISES, ids=["known", "factor", "each", "start"])
def test_tensors_give_the_same_with_their_gradient(name, epsilon):
    """Rows of a torch phi are NumPy's to 1e-10, and autograd gives the sums of the scores to 1e-7
    of the largest.
    """
    torch = pytest.importorskip("torch")
    problem, _ = linear_problem(np.random.default_rng(2))
    objective = local(problem, find("families", name)(problem.space), epsilon)
    phi = torch.tensor(member(objective, name), dtype=torch.float64, requires_grad=True)
    rows = objective.rows(phi)
    np.testing.assert_allclose(
        rows.detach().numpy(), objective.rows(phi.detach().numpy()), rtol=1e-10, atol=1e-10
    )
    objective(phi).backward()
    scores = objective.value_score_information(phi.detach().numpy())[1].sum(axis=0)
    np.testing.assert_allclose(phi.grad.numpy(), scores, atol=1e-7 * np.abs(scores).max())
    np.testing.assert_allclose(objective.gradient(phi.detach().numpy()), scores)


def test_noise_of_the_start_states_goes_through_the_motion():
    """Of a simulator that adds to the start, the start's noise doubles the variance (1e-6); without
    it the value is another.
    """
    problem, _ = linear_problem(np.random.default_rng(1))
    family = FullGaussian(problem.space)
    phi = family.phi_of([0.8, -1.9], [[0.3, 0.05], [0.05, 0.1]])
    started, doubled, plain = (
        local(problem, family, e)(phi) for e in (Noise(NOISE, start=True), 2 * NOISE, NOISE)
    )
    assert started == pytest.approx(doubled, abs=1e-6)
    assert abs(plain - doubled) > 1


def test_a_value_depends_on_phi_alone():
    """Modes are found anew: for a curved simulator too, what was asked before leaves no trace."""
    rng = np.random.default_rng(8)
    block = SlidingBlock()
    draws = np.array([1.5, 1.0]) + 0.2 * rng.standard_normal((8, 2))
    data = toy_trajectories(
        block, draws, rng.normal(2, 1, (8, 5, 1)), np.zeros(2), noise_variance=1e-4, rng=rng
    )
    family = FullGaussian(block.space)
    problem = Problem("block", block, data, epsilon=1e-4)
    objective = RandomEffects().linearize_at(
        block, problem.segments, family, 1e-4, np.array([1.5, 1.0]), np.full(2, 0.3), rng
    )
    phi, other = (family.phi_of(mean, np.diag([0.04, 0.03])) for mean in ([1.5, 1.0], [1.2, 1.4]))
    first = objective.rows(phi)
    elsewhere = objective.rows(other)
    assert not np.array_equal(first, elsewhere)
    assert np.array_equal(objective.rows(phi), first)


def test_information_is_the_covariance_of_the_score():
    """Over 300 data sets at the truth, the scores have the covariance that `expand` says, within 5
    standard errors.
    """
    rng = np.random.default_rng(3)
    problem, _ = linear_problem(rng, groups=6)
    family = FullGaussian(problem.space)
    mean = np.array([1.0, -2.0])
    covariance = np.diag([0.5, 0.2]) ** 2
    phi = np.append(family.phi_of(mean, covariance), np.ones(3))
    scores = []
    for _ in range(300):
        draws = mean + np.array([0.5, 0.2]) * rng.standard_normal((6, 2))
        actions = problem.trajectories.actions.reshape(6, 5, 2)
        data = toy_trajectories(
            problem.simulator, draws, actions, np.zeros(3), noise_variance=NOISE, rng=rng
        )
        objective = local(
            Problem("again", problem.simulator, data, epsilon=NOISE),
            family,
            Noise(np.full(3, NOISE), "each"),
        )
        scores.append(objective.value_score_information(phi)[1].sum(axis=0))
    information = objective.value_score_information(phi)[2]
    size = np.sqrt(np.diagonal(information))
    z = (
        np.mean(np.array(scores)[:, :, None] * np.array(scores)[:, None, :], axis=0) - information
    ) / np.outer(size, size)
    error = np.sqrt(3 / 300)  # a product of two standard scores has variance of at most about 3
    assert np.abs(z).max() < 5 * error
    assert np.abs(z + np.eye(len(z))).max() > 5 * error  # an information twice as large is refused


@pytest.mark.parametrize("where", ["mean", "at no spread"])
def test_information_is_exact_where_spread_and_noise_mix(where):
    """In one signal, one parameter, n rows a group: J'Sigma^-1 J and half its square, with noise
    and spread crossed (1e-6).
    """
    rng = np.random.default_rng(9)
    n = 3
    groups = 4
    simulator = LinearSimulator(np.ones((1, 1, 1)))
    data = toy_trajectories(
        simulator,
        rng.normal(size=(groups, 1)),
        np.ones((groups, n, 1)),
        np.zeros(1),
        noise_variance=NOISE,
        rng=rng,
    )
    family = FullGaussian(simulator.space)
    scale = {"mean": 0.3, "at no spread": 1e-4}[where]
    segments = data.segments()
    objective = RandomEffects(1).linearize_at(
        simulator, segments, family, Noise([NOISE], "each"), np.zeros(1), np.ones(1), rng
    )
    sigma = NOISE * np.eye(n) + scale**2
    pieces = [2 * scale * np.linalg.solve(sigma, np.ones((n, n))), NOISE * np.linalg.inv(sigma)]
    expected = groups * 0.5 * np.array([[np.trace(a @ b) for a in pieces] for b in pieces])
    found = objective.value_score_information(np.array([0.0, scale, 1.0]))[2]
    np.testing.assert_allclose(found[1:, 1:], expected, rtol=1e-6)
    assert found[0, 0] == pytest.approx(groups * np.linalg.solve(sigma, np.ones(n)).sum(), rel=1e-6)


def test_groups_come_back_with_their_own_parameters():
    """Each group's mode lies within 4.5 of its posterior standard deviations of its draw; those of
    permuted groups do not.
    """
    problem, draws = linear_problem(np.random.default_rng(4))
    family = FullGaussian(problem.space)
    phi = family.phi_of([1.0, -2.0], np.diag([0.5, 0.2]) ** 2)
    groups = local(problem, family).groups(phi)
    modes = groups.mean
    precision = groups.precision + np.linalg.inv(np.diag([0.5, 0.2]) ** 2)
    sd = np.sqrt(np.einsum("gdd->gd", np.linalg.inv(precision)))
    assert np.abs((modes - draws) / sd).max() < 4.5
    assert np.abs((modes[::-1] - draws) / sd).max() > 4.5


@pytest.mark.parametrize("name", ["emulated", "random-effects"])
def test_no_noise_is_refused(name):
    """With epsilon 0 the covariance is singular: refused with the way out, before the search."""
    problem, _ = linear_problem(np.random.default_rng(6))
    with pytest.raises(
        BadArgument, match=r"must be positive for every signal.*Give epsilon > 0 .*, or 'learn'\."
    ):
        DROPO(likelihood=name, epsilon=0.0).fit(problem)


def test_a_log_normal_law_is_refused():
    """Random effects are Gaussian: the refusal says what to use."""
    problem, _ = linear_problem(np.random.default_rng(5))
    family = find("families", "log_normal")(
        ParameterSpace((Parameter("a", 1.0, 2.0), Parameter("b", 1.0, 2.0)))
    )
    with pytest.raises(
        Incompatible,
        match="LogNormal is no Gaussian, as random effects are. Use 'truncated_gaussian' or"
        r" 'full'\.",
    ):
        local(problem, family)


def test_two_peaks_are_refused():
    """A mixture is found by the method, not by the likelihood."""
    problem, _ = linear_problem(np.random.default_rng(5))
    space = ParameterSpace((Parameter("a", 1.0, 2.0), Parameter("b", 1.0, 2.0)))
    with pytest.raises(Incompatible, match=r"Mixture is no Gaussian.* has weight, gap.a, gap.b"):
        local(problem, find("families", "mixture")(space))


def test_a_student_t_is_refused():
    """The integral over the draws is Gaussian: the refusal names the way out."""
    problem, _ = linear_problem(np.random.default_rng(5))
    with pytest.raises(
        Incompatible, match=r"knows no Student t.*Leave degrees out, or use 'emulated'\."
    ):
        local(problem, FullGaussian(problem.space), Noise(NOISE, degrees=4.0))


def test_the_contract_is_kept():
    """What every likelihood must keep to."""
    check_likelihood(RandomEffects())


def test_blocks_of_rows_change_nothing(monkeypatch):
    """With a limit of a few rows a block the values are the same (1e-12)."""
    problem, _ = linear_problem(np.random.default_rng(1))
    family = FullGaussian(problem.space)
    phi = member(local(problem, family), "full")
    whole = local(problem, family)
    monkeypatch.setattr(kept_rows, "ROW_BYTES", 1000)
    cut = local(problem, family)
    assert len(cut.blocks) > len(whole.blocks) == 1
    np.testing.assert_allclose(cut.rows(phi), whole.rows(phi), rtol=1e-12)
