"""The built-in families on torch tensors: the same numbers as on NumPy arrays, and gradients that
differences confirm.
"""

import numpy as np
import pytest

from dropo.core.numerics.array_api import plain
from dropo.core.numerics.standard_distributions import NORMAL, TRUNCATED_NORMAL, UNIFORM
from dropo.core.records.parameters import Parameter, ParameterSpace
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, Incompatible
from dropo.core.services.registry import find
from dropo.families.full_gaussian import FullGaussian
from dropo.families.truncated_gaussian import TruncatedGaussian
from dropo.likelihoods.monte_carlo import MonteCarlo
from dropo.simulators.differentiable import Pendulum
from tests.models.triangle import Triangle

torch = pytest.importorskip("torch")
SPACE = ParameterSpace(
    (
        Parameter("mass", 1.0, 3.0),
        Parameter("friction", 0.2, 0.8, lower=0.18),
        Parameter("length", 0.5, 5.0, upper=5.0),
    )
)
FAMILIES = ["truncated_gaussian", "full", "uniform", "log_normal", "point"]


def member(name):
    """A family, and a member wide enough for draws to be made again."""
    family = find("families", name)(SPACE)
    unit = np.full(len(family.unknowns), 0.6)
    unit[3:6] = 0.99
    return family, family.unknowns.from_unit(unit)


def functions(family):
    """What a family computes from phi."""
    base = family.base(64, np.random.default_rng(0))
    return {
        "draw": lambda phi: family.draw(phi, base),
        "map": lambda phi: family.map(phi, base[0]),
        "mean": family.mean,
        "sd": family.sd,
        "scale": family.scale,
        "correlation": family.correlation,
    }


def jacobian(function, phi):
    """d function / d phi (..., m) by central differences of NumPy numbers."""
    steps = 1e-6 * np.diag(np.maximum(np.abs(phi), 0.1))
    return np.stack(
        [(function(phi + step) - function(phi - step)) / (2 * step.sum()) for step in steps],
        axis=-1,
    )


@pytest.mark.parametrize("what", ["draw", "map", "mean", "sd", "scale", "correlation"])
@pytest.mark.parametrize("name", FAMILIES)
def test_the_same_numbers_and_exact_gradients(name, what):
    """Tensors agree with arrays to 1e-14; reverse-mode Jacobians agree with differences to 1e-6 of
    the largest slope.
    """
    family, phi = member(name)
    function = functions(family)[what]
    found = function(torch.tensor(phi, requires_grad=True))
    assert found.dtype == torch.float64
    np.testing.assert_allclose(found.detach().numpy(), function(phi), rtol=1e-14, atol=1e-15)
    slopes = torch.autograd.functional.jacobian(function, torch.tensor(phi))
    expected = jacobian(function, phi)
    np.testing.assert_allclose(
        slopes.numpy(), expected, rtol=1e-6, atol=1e-7 * max(1.0, np.abs(expected).max())
    )


@pytest.mark.parametrize("name", [name for name in FAMILIES if name != "point"])
def test_draws_were_made_again(name):
    """The test above covers redrawn entries: some of the first attempts are not physically
    possible.
    """
    family, phi = member(name)
    values = family.map(phi, family.base(64, np.random.default_rng(0))[0])
    assert ((values < SPACE.lower) | (values > SPACE.upper)).any()


def test_a_draw_on_the_bound_has_no_slope():
    """All 21 attempts of the second draw are infeasible: it is held, and only the first one moves
    with phi.
    """
    family = TruncatedGaussian(ParameterSpace((Parameter("mass", 1.0, 3.0, lower=1.0),)))
    base = np.full((21, 2, 1), 0.1)
    base[:, 0] = 0.7
    phi = torch.tensor([1.0, 0.5], dtype=torch.float64)
    slopes = torch.autograd.functional.jacobian(lambda phi: family.draw(phi, base), phi)[:, 0]
    np.testing.assert_allclose(
        slopes[0], [1.0, TRUNCATED_NORMAL.quantile(np.array(0.7))], rtol=1e-14
    )
    np.testing.assert_array_equal(slopes[1], 0.0)


@pytest.mark.parametrize("distribution", [NORMAL, UNIFORM, TRUNCATED_NORMAL])
def test_polynomials_and_quantiles_of_tensors(distribution):
    """The orthonormal polynomials and the quantiles take tensors as they take arrays."""
    base = np.random.default_rng(1).random((5, 3))
    x = distribution.quantile(base)
    np.testing.assert_allclose(distribution.quantile(torch.tensor(base)), x, rtol=1e-13, atol=1e-14)
    found = distribution.orthonormal(torch.tensor(x, requires_grad=True), 6)
    np.testing.assert_allclose(
        found.detach().numpy(), distribution.orthonormal(x, 6), rtol=1e-13, atol=1e-14
    )
    assert found.requires_grad


def test_refusals():
    """A tensor phi is checked as an array is."""
    family = FullGaussian(SPACE)
    base = family.base(4, np.random.default_rng(0))
    with pytest.raises(
        BadArgument, match=r"'phi' of FullGaussian must be of shape \(9,\). Got \(8,\)"
    ):
        family.draw(torch.ones(8, dtype=torch.float64), base)
    with pytest.raises(BadArgument, match="'phi' of FullGaussian must be finite"):
        family.draw(torch.full((9,), torch.nan, dtype=torch.float64), base)


class Detached(Triangle):
    """Computes without torch, and gives an array."""

    def _draw(self, phi, base):
        return super()._draw(plain(phi), base)


@pytest.mark.parametrize("kind", [Triangle, Detached])
def test_a_family_that_does_not_work_on_tensors_says_so(kind):
    """It draws arrays; of a tensor it gives no gradients, and the message says what to do. A
    likelihood's gradient asks for them.
    """
    simulator = Pendulum(substeps=1)
    family = kind(simulator.space)
    phi = family.unknowns.from_unit(np.full(len(family.unknowns), 0.5))
    base = family.base(16, np.random.default_rng(0))
    assert np.isfinite(family.draw(phi, base)).all()
    leaf = torch.tensor(phi, requires_grad=True)
    words = f"{kind.__name__} gives no gradients, since its `_draw` does not work on torch tensors"
    for draw in (lambda: family.draw(leaf, base), lambda: family.map(leaf, base[0])):
        with pytest.raises(Incompatible, match=words):
            draw()
    states = np.zeros((4, 2))
    data = Trajectories(states, np.ones((4, 1)), states, np.ones(4, dtype=bool))
    rng = np.random.default_rng(0)
    bound = MonteCarlo(draws=16).bind(simulator, data.segments(), family, 1e-3, rng)
    with pytest.raises(Incompatible, match=words):
        bound.gradient(phi)
