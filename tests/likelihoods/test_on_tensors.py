"""Sampled likelihoods on torch tensors: the same numbers, gradients, noise on the start states,
long tails, refusals.
"""

import numpy as np
import pytest
from scipy.stats import multivariate_t

from dropo.core.contracts.noise import Noise
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.families.full_gaussian import FullGaussian
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.ghurye_olkin import GhuryeOlkin
from dropo.likelihoods.monte_carlo import MonteCarlo
from dropo.simulators.toy import LinearSimulator, SlidingBlock, simulate
from tests.reference.densities import gaussian_one_by_one

torch = pytest.importorskip("torch")
from dropo.simulators.differentiable import Pendulum  # noqa: E402

KINDS = [MonteCarlo(60), MonteCarlo(60, degrees=5.0), GhuryeOlkin(60)]


def samples(rows=30, p=3):
    """Predictions (60, R, p), targets (R, p), epsilon (p,) and noise."""
    rng = np.random.default_rng(0)
    predictions = 10.0 + rng.normal(size=(60, rows, p)) @ rng.normal(size=(p, p))
    return (
        predictions,
        predictions[0] + 0.1,
        rng.uniform(0.01, 0.1, p),
        rng.standard_normal(predictions.shape),
    )


def pendulum_data(rows=12):
    """Transitions of a pendulum whose draws vary."""
    rng = np.random.default_rng(1)
    simulator = Pendulum(substeps=1)
    starts = rng.normal(size=(rows, 2))
    actions = 3 * rng.normal(size=(rows, 1))
    data = Trajectories(starts, actions, starts, np.ones(rows, dtype=bool), group=np.arange(rows))
    values = np.array([0.7, 0.9, 0.2]) * (1 + 0.1 * rng.normal(size=(rows, 3)))
    after = simulator.predict(values[None], data.segments())[0]
    return simulator, Trajectories(
        starts, actions, after + 0.03 * rng.normal(size=after.shape), np.ones(rows, dtype=bool)
    ).segments()


@pytest.mark.parametrize("likelihood", KINDS, ids=["gaussian", "student", "ghurye-olkin"])
def test_densities_of_tensors(likelihood):
    """The same numbers to 1e-12, failed and singular rows included; gradients by every argument
    agree with differences.
    """
    predictions, targets, epsilon, noise = samples()
    broken = predictions.copy()
    broken[3, 5] = np.nan
    for x in (predictions, broken):
        found = likelihood.log_density(torch.tensor(x, requires_grad=True), targets, epsilon, noise)
        assert found.requires_grad
        np.testing.assert_allclose(
            found.detach().numpy(), likelihood.log_density(x, targets, epsilon, noise), rtol=1e-12
        )
    few = [
        torch.tensor(x, requires_grad=True) for x in (predictions[:12, :2], targets[:2], epsilon)
    ]
    assert torch.autograd.gradcheck(
        lambda x, y, e: likelihood.log_density(x, y, e, noise[:12, :2]), few, eps=1e-6, atol=1e-6
    )


def test_singular_tensors_are_refused_or_lost():
    """As of arrays: without epsilon an error that names the row, with it -inf or a density."""
    flat = torch.zeros((20, 4, 2), dtype=torch.float64)
    flat[:, :3] = torch.tensor(np.random.default_rng(0).normal(size=(20, 3, 2)))
    with pytest.raises(
        BadArgument, match=r"K = 20 predictions at row 3 is singular in p = 2 signals"
    ):
        MonteCarlo().log_density(flat, np.zeros((4, 2)), 0.0)
    assert torch.isfinite(MonteCarlo().log_density(flat, np.zeros((4, 2)), 1e-4)).all()


def student_one_by_one(predictions, targets, epsilon, degrees):
    """(R,) log densities of SciPy's t whose covariance is the Gaussian's."""
    out = []
    for r, target in enumerate(targets):
        covariance = np.cov(predictions[:, r].T) + np.diag(epsilon)
        distribution = multivariate_t(
            predictions[:, r].mean(axis=0), covariance * (degrees - 2) / degrees, df=degrees
        )
        out.append(distribution.logpdf(target))
    return np.array(out)


def test_student_t_has_the_same_covariance():
    """Against SciPy's t; with many degrees of freedom it is the Gaussian; a far target costs less
    than the Gaussian's.
    """
    predictions, targets, epsilon, _ = samples()
    found = MonteCarlo(degrees=4.5).log_density(predictions, targets, epsilon)
    np.testing.assert_allclose(
        found, student_one_by_one(predictions, targets, epsilon, 4.5), rtol=1e-10
    )
    gaussian = gaussian_one_by_one(predictions, targets, epsilon)
    np.testing.assert_allclose(
        MonteCarlo(degrees=1e9).log_density(predictions, targets, epsilon), gaussian, rtol=1e-6
    )
    far = targets + 30
    assert (
        MonteCarlo(degrees=4.5).log_density(predictions, far, epsilon)
        > MonteCarlo().log_density(predictions, far, epsilon)
    ).all()


@pytest.mark.parametrize(
    "noise",
    [
        Noise(1e-3),
        Noise(np.array([1e-3, 2e-3]), "each"),
        Noise(1e-3, "factor", start=True),
        Noise(1e-3, degrees=4.0),
    ],
    ids=["known", "each", "start", "student"],
)
@pytest.mark.parametrize("family", [TruncatedGaussian, FullGaussian])
def test_bound_gradients(family, noise):
    """Through draws, simulator and density: the rows of a tensor are those of an array, the
    gradient is that of differences.
    """
    simulator, segments = pendulum_data()
    member = family(simulator.space)
    bound = MonteCarlo(20).bind(simulator, segments, member, noise, np.random.default_rng(0))
    assert bound.has_gradients
    phi = bound.unknowns.from_unit(np.full(len(bound.unknowns), 0.5))
    phi[: len(member.unknowns)] = member.phi([0.8, 1.0, 0.3], [0.1, 0.1, 0.05])
    rows = bound.rows(torch.tensor(phi, requires_grad=True))
    np.testing.assert_allclose(rows.detach().numpy(), bound.rows(phi), rtol=1e-10)
    steps = 1e-6 * np.diag(np.maximum(np.abs(phi), 1e-2))
    slopes = np.array(
        [(bound(phi + step) - bound(phi - step)) / (2 * step.sum()) for step in steps]
    )
    np.testing.assert_allclose(
        bound.gradient(phi), slopes, rtol=1e-6, atol=1e-6 * np.abs(slopes).max()
    )


def linear_data(rows=40):
    """o' = o + M(a) xi with the whole state observed, and its matrices."""
    rng = np.random.default_rng(5)
    simulator = LinearSimulator(rng.normal(size=(2, 2, 2)))
    values = rng.normal([1.0, -2.0], [0.4, 0.8], (rows, 2))
    actions = rng.normal(size=(rows, 1, 2))
    return simulator, simulate(
        simulator, values, actions, np.zeros(2), noise_variance=0.01, rng=rng
    ).segments()


def test_noise_on_the_start_states_adds_its_own_covariance():
    """Here a start moves what follows one to one: within 4.5 standard errors over base sets the
    log-likelihood is that of twice the epsilon; that of the epsilon alone (the control) is
    rejected.
    """
    simulator, segments = linear_data()
    family = TruncatedGaussian(simulator.space)
    phi = family.phi([1.0, -2.0], [0.5, 0.9])
    rngs = np.random.default_rng(0).spawn(12)
    found = np.array(
        [
            MonteCarlo(1024).bind(simulator, segments, family, Noise(0.3, start=True), rng)(phi)
            for rng in rngs
        ]
    )
    error = found.std(ddof=1) / np.sqrt(len(found))
    twice, once = (
        MonteCarlo(8192).bind(simulator, segments, family, epsilon, np.random.default_rng(1))(phi)
        for epsilon in (0.6, 0.3)
    )
    assert abs(found.mean() - twice) < 4.5 * error
    assert abs(found.mean() - once) > 4.5 * error


class Hidden(SlidingBlock):
    """Starts from more numbers than it shows."""

    start_size = 3


def test_refusals():
    """Long tails where there is no Gaussian, noise on starts that are not observed, gradients that
    are not there.
    """
    simulator, segments = linear_data()
    family = TruncatedGaussian(simulator.space)
    rng = np.random.default_rng(0)
    with pytest.raises(
        Incompatible,
        match=r"GhuryeOlkin knows no noise with long tails. Leave out degrees = 5, or use"
        " 'monte-carlo'",
    ):
        GhuryeOlkin().bind(simulator, segments, family, Noise(0.1, degrees=5.0), rng)
    with pytest.raises(
        Incompatible,
        match=r"Hidden starts from 3 numbers and gives 2 signals.* or Noise\(start=False\)",
    ):
        MonteCarlo().bind(
            Hidden(), segments, TruncatedGaussian(Hidden().space), Noise(0.1, start=True), rng
        )
    bound = MonteCarlo().bind(simulator, segments, family, 0.1, rng)
    assert not bound.has_gradients
    with pytest.raises(
        Incompatible,
        match=r"LinearSimulator gives no gradients. Use likelihood 'emulated'.*'cma-es'",
    ):
        bound.gradient(family.phi([1.0, -2.0], [0.5, 0.9]))
    with pytest.raises(
        BadArgument, match=r"'degrees' of MonteCarlo must be above 2, to have a covariance. Got 2.0"
    ):
        MonteCarlo(degrees=2.0)
