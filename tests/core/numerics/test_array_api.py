"""NumPy or torch by what is handed in: the functions that the rest of the package builds on."""

import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

from dropo.core.numerics.array_api import (
    checked,
    cholesky,
    constant,
    is_tensor,
    namespace,
    ndtri,
    plain,
    together,
)
from dropo.core.services.errors import BadArgument

torch = pytest.importorskip("torch")


def test_arrays_stay_arrays():
    """Without a tensor everything is NumPy's, and nothing is copied that need not be."""
    x = np.arange(3.0)
    assert constant(x, x) is x
    assert plain(x) is x
    assert not is_tensor(x)
    assert namespace(x, 1.0).exp(x) is not None
    assert [type(y) for y in together(x, 2, [1, 2])] == [np.ndarray] * 3


def test_a_torch_that_another_thread_is_importing_is_none(monkeypatch):
    """It is in `sys.modules` before it has anything in it."""
    monkeypatch.setitem(sys.modules, "torch", ModuleType("torch"))
    assert not is_tensor(np.ones(2))


def test_one_tensor_makes_all_of_them_tensors():
    """Constants become float64 tensors, read-only and reversed arrays too; the tensor keeps its
    history.
    """
    leaf = torch.ones(2, dtype=torch.float64, requires_grad=True)
    fixed = np.arange(2.0)
    fixed.setflags(write=False)
    x, y, z = together(fixed, leaf, np.arange(4)[::-2])
    assert y is leaf
    assert x.dtype == z.dtype == torch.float64
    np.testing.assert_array_equal(z, [3.0, 1.0])
    total = namespace(x, y).sum(x * y * z)
    np.testing.assert_array_equal(plain(torch.autograd.grad(total, leaf)[0]), [0.0, 1.0])
    assert plain(leaf).tolist() == [1.0, 1.0]


def test_normal_quantile():
    """Torch's quantile is SciPy's to 1e-13, far into the tails."""
    x = np.array([1e-12, 0.01, 0.5, 0.8, 1 - 1e-12])
    np.testing.assert_allclose(ndtri(torch.tensor(x)), ndtri(x), rtol=1e-13)


@pytest.mark.parametrize("make", [np.asarray, torch.as_tensor])
def test_factors_are_nan_where_there_is_none(make):
    """Of three matrices the second is not positive definite: it alone is lost."""
    rng = np.random.default_rng(0)
    root = np.tril(rng.normal(size=(3, 2, 2))) + 2 * np.eye(2)
    covariance = root @ root.swapaxes(1, 2)
    covariance[1] = [[1.0, 2.0], [2.0, 1.0]]
    found = plain(cholesky(make(covariance)))
    np.testing.assert_allclose(
        found[[0, 2]],
        root[[0, 2]] * np.sign(np.diagonal(root, axis1=1, axis2=2))[[0, 2], None],
        rtol=1e-12,
    )
    assert np.isnan(found[1]).all()


@pytest.mark.parametrize("make", [np.asarray, torch.as_tensor])
def test_checked(make):
    """Arrays and tensors of another shape, or not finite, are refused in the same words."""
    assert type(checked("x", make([1.0, 2.0]), (2,), "f")) is type(make([1.0]))
    with pytest.raises(BadArgument, match=r"The 'x' of f must be of shape \(3,\). Got \(2,\)"):
        checked("x", make([1.0, 2.0]), (3,), "f")
    with pytest.raises(BadArgument, match="The 'x' of f must be finite"):
        checked("x", make([1.0, np.nan]), (2,), "f")


def test_torch_is_not_imported():
    """The families, the sampled likelihoods and the robots' module work before anyone imports
    torch.
    """
    script = (
        "import numpy as np, sys, dropo.likelihoods.ghurye_olkin, dropo.simulators.differentiable\n"
        "from dropo.likelihoods.monte_carlo import MonteCarlo\n"
        "predictions = np.random.default_rng(0).normal(size=(9, 3, 2))\n"
        "MonteCarlo().log_density(predictions, np.zeros((3, 2)), 0.1)\n"
        "print('torch' in sys.modules)"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True
        ).stdout.strip()
        == "False"
    )
