"""NumPy or torch, by what is passed in: the same code, with gradients where a tensor is passed.

A function of arrays asks `namespace` for its functions (the array API standard, through
array-api-compat), and wraps its own constants in `constant`. torch is never imported here: where no
tensor is passed, it need not be installed.
"""

import sys
from typing import Any

import array_api_compat
import numpy as np
from scipy import special

from dropo.core.services.validation import Array, check_shape, float_array, require

_NUMPY = array_api_compat.array_namespace(np.empty(0))


def is_tensor(x: Any) -> bool:
    """Return whether this is a torch tensor; torch is not imported for the answer.

    Parameters
    ----------
    x : Any
        An array, a number or a tensor.

    Returns
    -------
    bool
        False wherever torch has not been imported, or is being imported by another thread.
    """
    tensor = getattr(sys.modules.get("torch"), "Tensor", None)
    return tensor is not None and isinstance(x, tensor)


def namespace(*arrays: Any) -> Any:
    """Find the array API namespace of arrays.

    Parameters
    ----------
    *arrays
        Arrays and tensors.

    Returns
    -------
    module
        torch's if one of them is a tensor, else NumPy's; `einsum` is in both.
    """
    for x in arrays:
        if is_tensor(x):
            return array_api_compat.array_namespace(x)
    return _NUMPY


def constant(x: Any, like: Any) -> Any:
    """Make an array of the kind of another one, without a copy where none is needed.

    Parameters
    ----------
    x : array_like
        The numbers.
    like : array
        Array or tensor.

    Returns
    -------
    array
        float64, in the namespace of `like` and on its device.
    """
    if not is_tensor(like):
        return np.asarray(x, dtype=float)
    torch = sys.modules["torch"]
    if not is_tensor(x):
        x = np.require(x, dtype=float, requirements=["C", "W"])  # what torch can share
    return torch.as_tensor(x, dtype=torch.float64, device=like.device)


def checked(name: str, values: Any, shape: tuple[int | None, ...], caller: str) -> Any:
    """Check an argument that may be a tensor.

    Parameters
    ----------
    name : str
        The argument's name, for messages.
    values : array_like
        The argument.
    shape : tuple of int or None
        The shape that it must have; None stands for any length.
    caller : str
        Whose argument it is, for messages.

    Returns
    -------
    array
        As of `float_array`; a tensor stays one, in float64 with its history.

    Raises
    ------
    BadArgument
        If it has another shape or is not finite.
    """
    if not is_tensor(values):
        return float_array(name, values, shape, caller)
    check_shape(name, values, shape, caller)
    require(bool(values.isfinite().all()), name, "finite", values.tolist(), caller)
    return values.double()


def together(*arrays: Any) -> list[Any]:
    """Put arrays into one namespace.

    Parameters
    ----------
    *arrays
        Arrays and tensors.

    Returns
    -------
    list of array
        float64 tensors if one of them is a tensor, else NumPy arrays.
    """
    like = next((x for x in arrays if is_tensor(x)), None)
    return [constant(x, like) for x in arrays]


def plain(x: Any) -> Array:
    """Return the values of an array as a NumPy one, without the history that gradients need.

    Parameters
    ----------
    x : array_like
        An array or a tensor, on any device.

    Returns
    -------
    array
        float64, of the same shape.
    """
    return np.asarray(x.detach().cpu().numpy() if is_tensor(x) else x, dtype=float)


def ndtri(x: Any) -> Any:
    """Evaluate the standard normal quantile.

    Parameters
    ----------
    x : array
        Probabilities, array or tensor.

    Returns
    -------
    array
        Of the same kind and shape; -inf at 0, inf at 1.
    """
    return sys.modules["torch"].special.ndtri(x) if is_tensor(x) else special.ndtri(x)


def cholesky(covariance: Any) -> Any:
    """Factorise symmetric matrices.

    Parameters
    ----------
    covariance : (R, p, p) array
        Array or tensor.

    Returns
    -------
    (R, p, p) array
        Lower Cholesky factors; NaN where a matrix is not positive definite.
    """
    if is_tensor(covariance):
        torch = sys.modules["torch"]
        factor, bad = torch.linalg.cholesky_ex(covariance)
        return torch.where(bad[:, None, None] > 0, torch.nan, factor)
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return np.array([_cholesky_or_nan(row) for row in covariance])


def _cholesky_or_nan(covariance: Array) -> Array:
    """The lower factor (p, p) of one matrix, or NaN."""
    try:
        return np.linalg.cholesky(covariance).astype(float, copy=False)
    except np.linalg.LinAlgError:
        return np.full_like(covariance, np.nan)
