"""Pyro's samplers keep to the contract, leave torch and Pyro as they were, and report failures."""

import numpy as np
import pytest

from dropo.core.contracts.estimator import Run
from dropo.core.contracts.problem import Problem
from dropo.core.records.draws import Draws
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.services.errors import BadArgument, Incompatible, InvalidInput
from dropo.core.services.files.evaluation_log import EvaluationLog
from dropo.optimizers.samplers.pyro_nuts import PyroNuts
from dropo.optimizers.samplers.pyro_svi import PyroSvi, _rising
from dropo.optimizers.support.real_line import RealLine
from dropo.simulators.toy import LinearSimulator, simulate
from dropo.testing import check_sampler
from dropo.testing.samplers import SPACE, gaussian

torch = pytest.importorskip("torch")
pyro = pytest.importorskip("pyro")

SHORT = {
    "nuts": PyroNuts(draws=30, warmup=20, chains=2),
    "svi": PyroSvi(draws=40, steps=20, particles=2),
}


class Density:
    """A density of points and its gradient from one function."""

    def __init__(self, value_score_information):
        self.value_score_information = value_score_information

    def __call__(self, points):
        return self.value_score_information(points)[0]


def sample(sampler, density=gaussian, space=SPACE, seed=0, **settings):
    return sampler.sample(density, space, rng=np.random.default_rng(seed), **settings)


def test_nuts_keeps_to_the_contract():
    check_sampler(PyroNuts(draws=120, warmup=40, chains=2))


def test_svi_keeps_to_the_contract():
    """Both distributions of the check are Gaussian on the real line, where the guide is exact."""
    check_sampler(PyroSvi(draws=500, steps=250, particles=2, learning_rate=0.3))


@pytest.mark.parametrize("sampler", SHORT.values(), ids=SHORT)
def test_torch_and_pyro_are_left_as_they_were(sampler):
    pyro.get_param_store().clear()
    pyro.param("mine", torch.ones(2))
    before = torch.get_rng_state().clone()
    sample(sampler)
    assert torch.equal(torch.get_rng_state(), before)
    assert list(pyro.get_param_store().keys()) == ["mine"]
    torch.rand(1)
    assert not torch.equal(torch.get_rng_state(), before)  # the control: drawing moves it
    pyro.get_param_store().clear()


@pytest.mark.parametrize("sampler", SHORT.values(), ids=SHORT)
def test_a_density_without_gradients_is_refused(sampler):
    with pytest.raises(
        Incompatible, match="Use likelihood 'emulated' or 'linear', or sampler 'emcee'"
    ):
        sample(sampler, lambda points: np.zeros(len(points)))


@pytest.mark.parametrize("sampler", SHORT.values(), ids=SHORT)
def test_killed_sampling_resumes(sampler, tmp_path):
    """Values and gradients are recorded: killed halfway and taken up again, the same draws, and no
    point evaluated twice.
    """
    simulator = LinearSimulator(np.ones((1, 1, 1)))
    problem = Problem(
        "none", simulator, simulate(simulator, np.array([[1.0]]), np.ones((1, 3, 1)), np.zeros(1))
    )
    count = 0

    def counted(points):
        nonlocal count
        count += len(points)
        if count > dies_after:
            raise RuntimeError("killed")
        return gaussian.value_score_information(points)

    def go(evaluation_log):
        nonlocal count
        count = 0
        run = Run(problem, np.random.default_rng(7), evaluation_log)
        return sampler.sample(
            Density(counted),
            SPACE,
            rng=run.rng,
            evaluate=run.evaluate,
            start=[0.45, 0.6],
            spread=0.05,
        )

    dies_after = np.inf
    straight = go(EvaluationLog())
    whole = count
    path = tmp_path / "journal"
    dies_after = whole // 2
    with pytest.raises(RuntimeError, match="killed"):
        go(EvaluationLog(path))
    recorded = sum(len(entry["points"]) for entry in EvaluationLog(path)._known)
    dies_after = np.inf
    resumed = go(EvaluationLog(path))
    assert recorded > whole // 3
    assert count == whole - recorded
    assert np.array_equal(resumed.chain, straight.chain)


def test_gradients_over_the_real_line():
    """By central differences to 1e-6, with the Jacobian: the integral over w of the density is that
    over the box.
    """
    unit = lambda u: np.column_stack([np.sin(3 * u).sum(axis=1), 3 * np.cos(3 * u)])
    line = RealLine(unit, np.array([0.3, 0.999]), np.array([0.2, 0.05]))
    w = torch.tensor([[0.3, -0.7], [1.5, 0.2]], dtype=torch.float64, requires_grad=True)
    line.log_density(w).sum().backward()
    value = lambda at: line.log_density(torch.as_tensor(at)).numpy()
    at = w.detach().numpy()
    for i in range(2):
        step = 1e-5 * np.eye(2)[i]
        np.testing.assert_allclose(
            w.grad[:, i], (value(at + step) - value(at - step)) / 2e-5, rtol=1e-6
        )
    grid = np.linspace(-60, 60, 40001)[:, None]
    one = RealLine(
        lambda u: np.column_stack([np.log(u[:, 0] + 0.5), 1 / (u[:, 0] + 0.5)]),
        np.array([0.3]),
        np.array([0.2]),
    )
    mass = np.exp(one.log_density(torch.as_tensor(grid)).numpy())
    fraction = mass[one.unit(grid)[:, 0] < 0.5].sum() / mass.sum()
    assert fraction == pytest.approx(0.375, abs=1e-3)  # of u + 1/2 on [0, 1]


def test_divergences_are_counted_and_reported():
    """A step in the density cannot be followed: some steps diverge, and the draws say how many."""
    box = ParameterSpace((Parameter("a", 0.0, 1.0),))
    cliff = Density(lambda u: (np.where(u[:, 0] > 0.5, -3000.0, 0.0), np.zeros(u.shape)))
    found = sample(PyroNuts(draws=100, warmup=50, chains=1), cliff, box, start=[0.3])
    assert found.diverging.shape == (100, 1)
    assert found.diverging.any()
    assert f"{found.diverging.sum()} of 100 steps diverged" in found.notes[0]
    smooth = sample(PyroNuts(draws=100, warmup=50, chains=1))
    assert not smooth.diverging.any()
    assert smooth.notes == ()


def test_svi_says_where_it_has_not_arrived_or_does_not_fit():
    noise = np.random.default_rng(1).standard_normal(400)
    assert "the ELBO still rises, by 2" in _rising(noise + 0.04 * np.arange(400), 0.01)[0]
    assert _rising(noise, 0.01) == []
    far = sample(
        PyroSvi(draws=200, steps=200, learning_rate=0.002), start=[0.02, 0.98], spread=0.01
    )
    assert any("the guide does not fit the posterior" in note for note in far.notes)
    near = sample(PyroSvi(draws=400, steps=600), start=[0.45, 0.6], spread=0.05)
    assert isinstance(near, Draws)
    assert near.notes == ()


def test_svi_refuses_a_guide_that_leaves_the_support():
    half = Density(
        lambda points: (np.where(points[:, 0] < 1.0, 0.0, np.nan), np.zeros(points.shape))
    )
    with pytest.raises(InvalidInput, match="Use sampler 'pyro-nuts'"):
        sample(SHORT["svi"], half, start=[0.45, 0.5], spread=0.3)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: PyroNuts(draws=3), "'draws' of PyroNuts must be at least 4"),
        (lambda: PyroNuts(chains=0), "'chains' of PyroNuts"),
        (lambda: PyroNuts(warmup=0), "'warmup' of PyroNuts"),
        (lambda: PyroNuts(target_acceptance=1.0), "'target_acceptance' of PyroNuts"),
        (lambda: PyroSvi(draws=3), "'draws' of PyroSvi"),
        (lambda: PyroSvi(steps=1), "'steps' of PyroSvi"),
        (lambda: PyroSvi(learning_rate=0.0), "'learning_rate' of PyroSvi"),
        (lambda: PyroSvi(particles=0), "'particles' of PyroSvi"),
    ],
)
def test_unusable_settings_are_refused(make, match):
    with pytest.raises(BadArgument, match=match):
        make()
